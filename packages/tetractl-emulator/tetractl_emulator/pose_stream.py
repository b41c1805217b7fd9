"""Base class for emulating other cameras that send the poses of all robots in one frame.

To emulate your own camera, derive from `PoseStream` and implement `packed`.
"""

import random
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from pydantic import Field

from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack.natnet import RigidBody, UpAxis, planar_pose
from tetractl.spec.base import Model, NonNegative
from tetractl.spec.lab_section import LabSection
from tetractl.spec.section_abilities import Addressed
from tetractl_emulator.fault_rows import length_scale
from tetractl_emulator.faults import Fault
from tetractl_emulator.loop import Loop
from tetractl_emulator.optitrack.pose_camera import PoseCamera, noise_of_day
from tetractl_emulator.optitrack.scripted import FAULTS
from tetractl_emulator.optitrack.tracked_body import Asset, PoseNoise, TrackedBody, View
from tetractl_emulator.port import PseudoPort
from tetractl_emulator.sides import Body, Facts, Stage

SERVER_FAULTS = (
    *("counter_back", "edit_mode", "bad_datagrams", "other_version", "outdated", "twin_id"),
    *("lifted", "tipped", "nan", "bad_quaternion", "clock_jump", "clock_rate"),
)
"""Names of the faults that only a motion-capture server can have."""

NEEDS_ADDRESS = "the section of a camera with an emulated PoseStream has `address` and `latency`"
DEFAULT_RATE_HZ = 100.0
"""Frame rate of a camera whose section states no rate [Hz]."""
SAMPLED_LATENCY_S = 0.01
"""Latency of the cameras for which `noise_of_day` samples latencies [s]."""


class PoseSettings(Model):
    """Properties of a camera that differ from the spec."""

    rate: float | None = Field(default=None, ge=1, le=500)
    """Frames per second [Hz]; by default those of the section's `sight`, or else 100."""
    latency: float | None = Field(default=None, ge=0, le=1)
    """Mean time from exposure to transmission [s]; by default the section's."""
    noise_mm: NonNegative = 0.0
    """Standard deviation of a position along each axis [mm]."""
    noise_rad: NonNegative = 0.0
    """Standard deviation of a heading [rad]."""


@dataclass(frozen=True, slots=True)
class Shot:
    """A frame of the emulated camera before it is packed.

    Attributes:
        number: Number of the frame.
        exposed_ns: When it was exposed [ns].
        bodies: The rigid bodies. Positions are in metres, z is up, and the origin is the spec's.
            The id of a body is its robot's index in the setup.
    """

    number: int
    exposed_ns: int
    bodies: tuple[RigidBody, ...]

    @property
    def poses(self) -> dict[int, Pose | None]:
        """The pose x, y [m], heading [rad] of each robot, by its index. None if it is untracked."""
        return {body.id: planar_pose(body, UpAxis.Z) for body in self.bodies}


class PoseStream(PoseCamera):
    """An emulated camera that sends packed frames to the program at the section's `address`.

    The camera starts to send when the program has written something, or at once if the program only
    listens.

    Args:
        stage: The data and functions that the emulated devices share.
        settings: Properties of the camera that differ from the spec.
        bodies: The robots.
    """

    Settings: ClassVar[type[Model]] = PoseSettings
    numbered = False
    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        kind for kind in FAULTS if kind.__name__ not in SERVER_FAULTS
    )

    @classmethod
    def world_of_day(
        cls, random_generator: random.Random, lab: LabSection, setup: Setup
    ) -> dict[str, Any]:
        """Sample the camera of a randomised test run; see `tetractl_emulator.sides`.

        The values are those of `noise_of_day`, with the section's latency added.
        """
        section = lab.camera
        assert isinstance(section, Addressed), NEEDS_ADDRESS
        sampled = noise_of_day(random_generator, length_scale(lab, setup))
        extra_latency_s = section.latency - SAMPLED_LATENCY_S
        return sampled | {"latency": max(0.0, round(sampled["latency"] + extra_latency_s, 4))}

    def __init__(self, stage: Stage, settings: PoseSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, Addressed), NEEDS_ADDRESS
        self.section = section
        random_generator = random.Random(stage.options.seed)
        noise = PoseNoise(settings.noise_mm, settings.noise_rad, random_generator)
        tracked = [
            TrackedBody(body, Asset(i, body.name), noise, stage.acting)
            for i, body in enumerate(bodies)
        ]
        rate_hz = settings.rate or section.sight.rate_hz or DEFAULT_RATE_HZ
        latency_s = section.latency if settings.latency is None else settings.latency
        super().__init__(stage, tracked, rate_hz, latency_s, View(UpAxis.Z))
        self.names = [body.name for body in bodies]
        self.join = stage.wires.ports
        self.frames = 0
        self._loop: Loop | None = None

    @cached_property
    def port(self) -> PseudoPort:
        """The port at the section's address. `open` plugs it in. A subclass can replace it."""
        return self._stage.wires.port(self.section.address)

    @abstractmethod
    def packed(self, shot: Shot) -> bytes:
        """Pack a frame into the bytes that the camera sends."""

    def open(self, loop: Loop) -> Facts:
        """Plug the port in, and expose the first frame.

        Returns:
            One entry: "camera" maps to the name of the port.
        """
        self.port.plug()
        self._loop = loop
        loop.watch(self.port.fd, self._note_client)
        self.begin()
        return {"camera": self.port.name}

    def close(self) -> Facts:
        """Unplug the port.

        Returns:
            One entry: "frames" maps to the number of frames sent.
        """
        if self._loop is not None:
            self._loop.forget(self.port.fd)
        self.port.unplug()
        return {"frames": self.frames}

    def _note_client(self) -> None:
        """Report a client if a program has written to the port. The bytes are ignored."""
        if self.port.read():
            self._stage.client(self.port.name)

    def _shot(self, number: int, exposed_ns: int, bodies: tuple[RigidBody, ...]) -> Shot:
        """Create the frame of an exposure."""
        return Shot(number, exposed_ns, bodies)

    def _stream(self, frame: Shot, now_ns: int) -> None:
        """Pack a frame and send it."""
        self.port.write(self.packed(frame))
        self.frames += 1
