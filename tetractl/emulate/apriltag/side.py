"""The emulated camera of type `apriltag`: its settings, its faults, and its pictures of the
robots.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from tetractl.core.poses import Floats, Grey, Poses
from tetractl.emulate.apriltag.renderer import Optics, Renderer
from tetractl.emulate.faults import Fault, Undo, Visible, fault
from tetractl.emulate.sides import Body, Stage
from tetractl.emulate.stream_side import STREAM_FAULTS, StreamedCamera, StreamSettings
from tetractl.experiment.base import Model, Name, NonNegative
from tetractl.lab.cameras.apriltag.section import AprilTagSection


class AprilTagSettings(StreamSettings):
    """Properties of the emulated camera; `latency` [s] is the spec's by default."""

    blur_px: NonNegative = 0.7
    """Gaussian blur of the lens [px]."""


def _cover(fault: Any, device: Any) -> Undo:
    tag = device.tag(fault.robot)
    device.renderer.hidden.add(tag)
    return lambda: device.renderer.hidden.discard(tag)


class EmulatedAprilTag(StreamedCamera):
    """A network camera above robots with tags."""

    Settings: ClassVar[type[Model]] = AprilTagSettings
    faults: ClassVar[Sequence[type[Fault]]] = (
        *STREAM_FAULTS,
        fault("untracked", "A robot's tag is covered.", _cover, Visible.EXPOSED, robot=Name),
    )

    def __init__(self, stage: Stage, settings: AprilTagSettings, bodies: Sequence[Body]) -> None:
        super().__init__(stage, settings)
        section = stage.lab.camera
        assert isinstance(section, AprilTagSection), "the table of kinds goes by the type"
        self._bodies, self._section = bodies, section
        metres = stage.setup.metres
        optics = replace(
            Optics.facing(section.floor, metres, settings.width, settings.height),
            blur_px=settings.blur_px,
            noise=settings.noise,
            exposure_s=settings.exposure,
        )
        robots = section.ordered(stage.setup.names)
        self.renderer = Renderer(robots, section.floor, metres, optics, self.seed)

    def hide(self, hidden: bool) -> None:
        """Leave all robots out of the pictures, or draw them again."""
        self.renderer.hidden.clear()
        if hidden:
            self.renderer.hidden.update(robot.tag for robot in self.renderer.robots)

    def tag(self, name: str) -> int:
        """Return the number of a robot's tag."""
        (robot,) = self._section.ordered([name])
        return robot.tag

    def _scene(self) -> Floats:
        mm = self._stage.mm
        return np.array([(b.x / mm, b.y / mm, b.heading) for b in self._bodies])

    def _draw(self, exposed_ns: int) -> Grey:
        return self.renderer.picture(lambda t: Poses.of(self._scene_at(t)), exposed_ns)
