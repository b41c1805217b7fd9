"""Shared by the emulated cameras with an MJPEG stream: making pictures, and faults of pictures."""

import random
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats, Grey
from tetractl.emulate.faults import Fault, Share, Undo, Visible, fault, setting, settings
from tetractl.emulate.loop import Loop
from tetractl.emulate.network_camera import (
    EmulatedNetworkCamera,
    cut_before_its_end,
    cut_short,
    oversized,
)
from tetractl.emulate.sides import Facts, Stage
from tetractl.experiment.base import Model, NonNegative, Positive
from tetractl.lab.cameras.pictures.picture_section import MjpegSource, PictureSection

KEEP_NS = 5_000_000  # interval of the scenes that are kept for drawing exposures
KEPT = 200


class StreamSettings(Model):
    """Properties of an emulated camera; `latency` [s] is the spec's by default."""

    width: int = Field(default=640, ge=64, le=8192)
    """Columns of a picture [px]."""
    height: int = Field(default=480, ge=64, le=8192)
    """Rows of a picture [px]."""
    rate: float = Field(default=30.0, ge=1, le=500)
    """Rate of pictures [Hz]."""
    noise: NonNegative = 2.0
    """Standard deviation of each pixel [grey levels]."""
    exposure: Positive = 0.004
    """Exposure time of a picture [s]."""
    drips: bool = False
    """Whether the camera answers byte by byte, without end."""


def _freeze(fault: Any, device: Any) -> Undo:
    device.camera.frozen.set()
    return device.camera.frozen.clear


def _first_again(fault: Any) -> Callable[[bytes], bytes]:
    sent: dict[str, bytes] = {}
    return lambda part: sent.setdefault("first", part)


def _spoil(fault: Any, device: Any) -> Undo:
    chance = random.Random(device.seed)
    ways = {"cut": cut_short, "cut_ended": cut_before_its_end, "oversized": oversized}

    def spoiled(part: bytes) -> bytes:
        return ways[fault.how](part) if chance.random() < fault.share else part

    return setting(device.camera, mangle=spoiled)


STREAM_FAULTS = (
    fault("no_frames", "No pictures are exposed.", _freeze, Visible.SENT),
    fault(
        "repeat",
        "One picture is sent again and again, at the camera's rate.",
        settings(lambda d, f: d.camera, mangle=_first_again),
        Visible.SENT,
    ),
    fault(
        "half_rate",
        "Every second picture is left out.",
        settings(lambda d, f: d.camera, every=2),
        Visible.SENT,
    ),
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


class StreamedCamera(ABC):
    """A camera's side that serves pictures as MJPEG; a thread draws them.

    A subclass returns the present scene, and draws the scene of an exposure.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def __init__(self, stage: Stage, settings: StreamSettings) -> None:
        section = stage.lab.camera
        assert isinstance(section, PictureSection), "the table of kinds goes by the type"
        if not isinstance(section.source, MjpegSource):
            raise SpecError(
                f"a source of type {section.source.type} cannot be emulated",
                "use {type: mjpeg, url: 'http://127.0.0.1:8080/'}",
            )
        self.seed = stage.options.seed
        self._stage, self._settings, self._latency = stage, settings, section.latency
        port = stage.options.command_port
        self._port = urlsplit(section.source.url).port or 80 if port is None else port
        self._past: deque[tuple[int, Floats]] = deque(maxlen=KEPT)
        self._watched = self._opened = False
        self._exposures = 0

    @abstractmethod
    def _scene(self) -> Floats:
        """Return the present scene as numbers that can be interpolated."""

    @abstractmethod
    def _draw(self, exposed_ns: int) -> Grey:
        """Return the picture of an exposure, by `_scene_at`; called in the camera's thread."""

    def open(self, loop: Loop) -> Facts:
        """Serve the stream."""
        clock, settings = MonotonicClock(), self._settings
        self._start_ns = loop.now() - clock.now()
        self._remember()
        self.camera = EmulatedNetworkCamera(
            self._draw,
            clock,
            settings.rate,
            settings.exposure,
            self._latency,
            port=self._port,
            drips=settings.drips,
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

    def _joined(self) -> None:
        """Called when a client begins to watch; does nothing unless overridden."""
        return

    def _scene_at(self, t_ns: int) -> Floats:
        """Return the scene at a time of the camera, interpolated between the two kept around that
        time.
        """
        past, when = list(self._past), self._start_ns + t_ns
        i = min(max(bisect_left([t for t, _ in past], when), 1), len(past) - 1)
        if i == 0:
            return past[0][1]
        (t0, before), (t1, after) = past[i - 1], past[i]
        part = min(max((when - t0) / (t1 - t0), 0.0), 1.0)
        # a cell may have divided since
        return before + part * (after[..., : before.shape[-1]] - before)

    def _remember(self) -> None:
        """Keep the present scene for exposures that are drawn later."""
        now = self._stage.timeline.now_ns
        self._past.append((now, self._scene()))
        self._stage.timeline.at(now + KEEP_NS, self._remember)

    def _expose(self) -> None:
        """Report an exposure at the camera's rate, and the first client."""
        now = self._stage.timeline.now_ns
        self._exposures += 1
        self._stage.exposed(self._exposures, self._exposures)
        self._stage.sent(self._exposures)
        if self.camera.watched and not self._watched:
            self._joined()
            self._stage.client(self.camera.url)
        self._watched = self.camera.watched
        self._stage.timeline.at(now + round(SECOND / self._settings.rate), self._expose)
