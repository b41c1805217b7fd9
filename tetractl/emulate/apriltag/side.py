"""The emulated camera of type `apriltag`: its settings and faults, and pictures of the bodies."""

import random
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats, Poses
from tetractl.emulate.apriltag.mjpeg import (
    EmulatedNetworkCamera,
    cut_before_its_end,
    cut_short,
    oversized,
)
from tetractl.emulate.apriltag.renderer import Optics, Renderer
from tetractl.emulate.faults import Fault, Share, Undo, Visible, fault, setting, settings
from tetractl.emulate.loop import Loop
from tetractl.emulate.sides import Body, Facts, Stage
from tetractl.experiment.base import Model, Name, NonNegative, Positive
from tetractl.lab.cameras.apriltag.section import AprilTagSection
from tetractl.lab.cameras.pictures.picture_section import MjpegSource

KEEP_NS = 5_000_000  # between poses that are kept for exposures
KEPT = 200


class AprilTagSettings(Model):
    """What the emulated camera is like; `latency` is what the spec says."""

    width: int = Field(default=640, ge=64, le=8192)
    """Columns of a picture [px]."""
    height: int = Field(default=480, ge=64, le=8192)
    """Rows of a picture [px]."""
    rate: float = Field(default=30.0, ge=1, le=500)
    """Pictures a second [Hz]."""
    blur_px: NonNegative = 0.7
    """Gaussian blur of the lens [px]."""
    noise: NonNegative = 2.0
    """Standard deviation of each pixel [grey levels]."""
    exposure: Positive = 0.004
    """How long a picture is exposed [s]."""
    drips: bool = False
    """Whether it answers byte by byte, without an end."""


def _freeze(fault: Any, device: Any) -> Undo:
    device.camera.frozen.set()
    return device.camera.frozen.clear


def _cover(fault: Any, device: Any) -> Undo:
    tag = device.tag(fault.robot)
    device.renderer.hidden.add(tag)
    return lambda: device.renderer.hidden.discard(tag)


def _first_again(fault: Any) -> Callable[[bytes], bytes]:
    sent: dict[str, bytes] = {}
    return lambda part: sent.setdefault("first", part)


def _spoil(fault: Any, device: Any) -> Undo:
    chance = random.Random(device.seed)
    ways = {"cut": cut_short, "cut_ended": cut_before_its_end, "oversized": oversized}

    def spoiled(part: bytes) -> bytes:
        return ways[fault.how](part) if chance.random() < fault.share else part

    return setting(device.camera, mangle=spoiled)


FAULTS = (
    fault("no_frames", "No pictures are exposed.", _freeze, Visible.SENT),
    fault(
        "repeat",
        "One picture is sent again and again, at the camera's rate.",
        settings(lambda d, f: d.camera, mangle=_first_again),
        Visible.SENT,
    ),
    fault("untracked", "A robot's tag is covered.", _cover, Visible.EXPOSED, robot=Name),
    fault(
        "bad_pictures",
        "A share of the pictures is cut short, cut short before an end marker, or of a header that "
        "claims 32767 x 32767.",
        _spoil,
        Visible.SENT,
        share=Share,
        how=(Literal["cut", "cut_ended", "oversized"], "cut"),
    ),
)


class EmulatedAprilTag:
    """A network camera above robots with tags."""

    Settings: ClassVar[type[Model]] = AprilTagSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: AprilTagSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, AprilTagSection), "the table of kinds goes by the type"
        if not isinstance(section.source, MjpegSource):
            raise SpecError(
                f"a source of type {section.source.type} cannot be emulated",
                "use {type: mjpeg, url: 'http://127.0.0.1:8080/'}",
            )
        self.seed = stage.options.seed
        self._stage, self._bodies, self._section = stage, bodies, section
        metres = stage.setup.metres
        optics = replace(
            Optics.facing(section.floor, metres, settings.width, settings.height),
            blur_px=settings.blur_px,
            noise=settings.noise,
            exposure_s=settings.exposure,
            latency_s=section.latency,
        )
        robots = section.ordered(stage.setup.names)
        self.renderer = Renderer(robots, section.floor, metres, optics, self.seed)
        self._rate_hz, self._drips = settings.rate, settings.drips
        port = stage.options.command_port
        self._port = urlsplit(section.source.url).port or 80 if port is None else port
        self._past: deque[tuple[int, Floats]] = deque(maxlen=KEPT)
        self._watched = self._opened = False
        self._exposures = 0

    def open(self, loop: Loop) -> Facts:
        """Serve the stream; a thread draws."""
        clock = MonotonicClock()
        self._start_ns = time.monotonic_ns() - clock.now()
        self._remember()
        self.camera = EmulatedNetworkCamera(
            self.renderer, self._poses_at, clock, self._rate_hz, port=self._port, drips=self._drips
        )
        self.camera.__enter__()
        self._opened = True
        self._expose()
        return {"camera": self.camera.url, "url": self.camera.url}

    def close(self) -> Facts:
        """End the stream."""
        if self._opened:
            self.camera.__exit__()
            self._opened = False
        return {"pictures": self._exposures}

    def hide(self, hidden: bool) -> None:
        """Draw no robot, or all again."""
        self.renderer.hidden.clear()
        if hidden:
            self.renderer.hidden.update(robot.tag for robot in self.renderer.robots)

    def tag(self, name: str) -> int:
        """Return the number of a robot's tag."""
        (robot,) = self._section.ordered([name])
        return robot.tag

    def _remember(self) -> None:
        """Keep where the robots are now, for exposures that are drawn later."""
        now = self._stage.timeline.now_ns
        places = [(b.x / self._stage.mm, b.y / self._stage.mm, b.heading) for b in self._bodies]
        self._past.append((now, np.array(places)))
        self._stage.timeline.at(now + KEEP_NS, self._remember)

    def _poses_at(self, t_ns: int) -> Poses:
        """Return where the robots were, between the two times kept around it."""
        past, when = list(self._past), self._start_ns + t_ns
        i = min(max(bisect_left([t for t, _ in past], when), 1), len(past) - 1)
        if i == 0:
            return Poses.of(past[0][1])
        (t0, before), (t1, after) = past[i - 1], past[i]
        part = min(max((when - t0) / (t1 - t0), 0.0), 1.0)
        return Poses.of(before + part * (after - before))

    def _expose(self) -> None:
        """Note an exposure at the camera's rate, and the first client."""
        now = self._stage.timeline.now_ns
        self._exposures += 1
        self._stage.exposed(self._exposures, self._exposures)
        self._stage.sent(self._exposures)
        if self.camera.watched and not self._watched:
            self._watched = True
            self._stage.client(self.camera.url)
        self._stage.timeline.at(now + round(SECOND / self._rate_hz), self._expose)
