"""Settings and faults that all emulated cameras share that serve pictures as an MJPEG stream."""

import random
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field
from tetractl_microscope.pictures.picture_section import DeviceSource, MjpegSource, PictureSection

from tetractl.core.clock import SECOND
from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats, Grey
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative, Positive
from tetractl.experiment.lab_section import LabSection
from tetractl_emulator.faults import Fault, Share, Undo, Visible, adding, fault_kind, settings
from tetractl_emulator.loop import Loop
from tetractl_emulator.pictures.memory_camera import MemoryCamera
from tetractl_emulator.pictures.network_camera import EmulatedNetworkCamera, part
from tetractl_emulator.rehearsal.participants import Rehearsal
from tetractl_emulator.rehearsal.picture_faults import stream_rows
from tetractl_emulator.sides import Facts, Stage

SPARE_PX = 64  # margin by which a field of noise is larger than a picture [px]


def cut_short(sent_part: bytes) -> bytes:
    """Return the first half of a part, as if the connection had lost the rest."""
    return sent_part[: len(sent_part) // 2]


def cut_before_its_end(sent_part: bytes) -> bytes:
    """Return a part whose JPEG lacks the second half of its data, but has its end marker."""
    jpeg = sent_part.partition(b"\r\n\r\n")[2]
    return part(jpeg[: len(jpeg) // 2] + b"\xff\xd9")


def oversized(sent_part: bytes) -> bytes:
    """Return a part whose JPEG, if it has one, claims to have 32767 x 32767 pixels."""
    size_at = sent_part.find(b"\xff\xc0") + 5
    if size_at < 5:
        return sent_part
    return sent_part[:size_at] + b"\x7f\xff\x7f\xff" + sent_part[size_at + 4 :]


class StreamSettings(Model):
    """Properties of an emulated camera; its latency [s] is the spec's."""

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
    """Whether the camera sends an endless answer byte by byte."""


def _freeze(fault: Any, device: Any) -> Undo:
    def freeze(more: int) -> None:
        device.freezes += more
        if device.freezes:
            device.camera.frozen.set()
        else:  # of several faults at once, the last to end lets it go on
            device.camera.frozen.clear()

    freeze(1)
    return lambda: freeze(-1)


WAYS: dict[str, Callable[[bytes], bytes]] = {
    "cut": cut_short,
    "cut_ended": cut_before_its_end,
    "oversized": oversized,
    "lost": lambda part: b"",
    "doubled": lambda part: part + part,
}


def _spoil(fault: Any, device: Any) -> Undo:
    chance = random.Random(device.seed)
    way = WAYS[fault.how]
    return _sending(device, lambda part: way(part) if chance.random() < fault.share else part)


def _sending(device: Any, change: Callable[[bytes], bytes]) -> Undo:
    """Let a function change what is sent."""
    return adding(device.camera.changes, change)


def _repeat(fault: Any, device: Any) -> Undo:
    sent: dict[str, bytes] = {}
    return _sending(device, lambda part: sent.setdefault("first", part))


def _late(fault: Any, device: Any) -> Undo:
    def later(by_ns: int) -> None:
        device.camera.latency_ns += by_ns

    by_ns = round(fault.by * SECOND)
    later(by_ns)
    return lambda: later(-by_ns)


STREAM_FAULTS = (
    fault_kind("no_frames", "No pictures are exposed.", _freeze, Visible.SENT),
    fault_kind(
        "repeat",
        "The same picture is sent repeatedly, at the camera's rate.",
        _repeat,
        Visible.SENT,
    ),
    fault_kind(
        "half_rate",
        "Only every second picture, or every n-th, is sent.",
        settings(lambda f, d: d.camera, every=attrgetter("every")),
        Visible.SENT,
        fields={"every": (Annotated[int, Field(ge=2, le=1000)], 2)},
    ),
    fault_kind(
        "late_pictures", "Pictures come later by this time [s].", _late, fields={"by": Positive}
    ),
    fault_kind(
        "bad_pictures",
        "A fraction of the pictures is cut short, with or without an end marker, has a header that "
        "states 32767 x 32767 pixels, is lost or is sent twice.",
        _spoil,
        Visible.SENT,
        fields={
            "share": Share,
            "how": (Literal["cut", "cut_ended", "oversized", "lost", "doubled"], "cut"),
        },
    ),
)


class StreamedCamera(ABC):
    """Base class of emulated cameras that serve pictures as MJPEG; a thread draws the pictures.

    A subclass returns the present scene as numbers, and draws the scene at an exposure.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def __init__(self, stage: Stage, settings: StreamSettings) -> None:
        section = stage.lab.camera
        assert isinstance(section, PictureSection), "the camera searches pictures"
        source = section.source
        in_memory = not stage.wires.http
        served = (MjpegSource, DeviceSource) if in_memory else MjpegSource
        if not isinstance(source, served):
            raise SpecError(
                f"a source of type {source.type} cannot be emulated",
                "use {type: mjpeg, url: 'http://127.0.0.1:8080/'}",
            )
        self.seed = stage.options.seed
        self._stage = stage
        self._settings = settings
        self._latency = section.latency
        port = stage.options.command_port
        named = urlsplit(source.url).port or 80 if isinstance(source, MjpegSource) else 0
        self._port = named if port is None else port
        self._past: deque[tuple[int, Floats]] = deque(maxlen=200)
        self._watched = self._opened = False
        self.freezes = 0  # number of present faults that stop exposures
        self.shown_ns: list[int] = []  # unknown over HTTP
        self._visible: dict[int, Sequence[bool]] = {}  # by the time of exposure [ns]
        self._exposures = 0

    @classmethod
    def rehearsal(cls, lab: LabSection, setup: Setup) -> Rehearsal:
        """Return what rehearsals draw of the pictures."""
        return Rehearsal([*stream_rows()])

    @abstractmethod
    def _scene(self) -> Floats:
        """Return the present scene as numbers that can be interpolated in time."""

    @abstractmethod
    def _visible_now(self) -> Sequence[bool]:
        """Return which bodies are not covered or left out."""

    @abstractmethod
    def _draw(self, exposed_ns: int) -> Grey:
        """Return the picture of an exposure, from `_scene_at`; called in the camera's thread."""

    def open(self, loop: Loop) -> Facts:
        """Start to serve the stream; return its address."""
        wires = self._stage.wires
        settings = self._settings
        clock = wires.clock()
        self._start_ns = loop.now() - clock.now()
        self._remember()
        self.camera: Any = (EmulatedNetworkCamera if wires.http else MemoryCamera)(
            self._taken,
            clock,
            settings.rate,
            settings.exposure,
            self._latency,
            port=self._port,
            drips=settings.drips,
        )
        if not wires.http:
            self.shown_ns = [0] * len(self._visible_now())
            self.camera.on_shown = self._show
        self.camera.__enter__()
        self._opened = True
        self._expose()
        return {"camera": self.camera.url, "url": self.camera.url}

    def close(self) -> Facts:
        """End the stream; return the number of pictures, to be recorded."""
        if self._opened:
            self.camera.__exit__()
            self._opened = False
        return {"pictures": self._exposures}

    @property
    def join(self) -> Any:
        """The function that gives our camera the pictures of this one, in memory."""
        return self.camera.join

    def _joined(self) -> None:
        """Do nothing, unless overridden; called when a client begins to watch."""
        return

    def _taken(self, exposed_ns: int) -> Grey:
        """Return the picture of an exposure; remember what it shows."""
        self._visible[exposed_ns] = self._visible_now()
        return self._draw(exposed_ns)

    def _show(self, exposed_ns: int) -> None:
        """Note which bodies a picture has shown to our side."""
        for i, visible in enumerate(self._visible[exposed_ns]):
            if visible:
                self.shown_ns[i] = self._start_ns + exposed_ns
        self._visible = {
            t_ns: visible for t_ns, visible in self._visible.items() if t_ns >= exposed_ns
        }

    def _scene_at(self, t_ns: int) -> Floats:
        """Return the scene at a time [ns] on the camera's clock, interpolated between the stored
        scenes before and after that time.
        """
        past = list(self._past)
        when = self._start_ns + t_ns
        times_ns = [time_ns for time_ns, _ in past]
        later = max(bisect_left(times_ns, when), 1)
        i = min(later, len(past) - 1)
        if i == 0:
            return past[0][1]
        before_ns, before = past[i - 1]
        after_ns, after = past[i]
        part = min(max((when - before_ns) / (after_ns - before_ns), 0.0), 1.0)
        # a cell may have divided between the two scenes
        return before + part * (after[..., : before.shape[-1]] - before)

    def _remember(self) -> None:
        """Store the present scene for exposures that are drawn later."""
        now = self._stage.timeline.now_ns
        self._past.append((now, self._scene()))
        # exposures are drawn between two of these scenes
        self._stage.timeline.at(now + 5_000_000, self._remember)

    def _expose(self) -> None:
        """Report an exposure, and a client that begins to watch; schedule the next exposure."""
        now = self._stage.timeline.now_ns
        self._exposures += 1
        self._stage.exposed(self._exposures, 0)  # our camera counts what comes
        self._stage.sent(self._exposures)
        if self.camera.watched and not self._watched:
            self._joined()
            self._stage.client(self.camera.url)
        self._watched = self.camera.watched
        self._stage.timeline.at(now + round(SECOND / self._settings.rate), self._expose)
