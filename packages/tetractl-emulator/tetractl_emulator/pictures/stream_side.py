"""Base class of emulated cameras that send images, such as a webcam or a microscope.

A `StreamedCamera` stores the scene at short intervals, because an image is drawn after its
exposure. It draws an image when the stream asks for one, and sends a stream of JPEG files, over
HTTP or in memory. A subclass describes the scene and draws it. All such cameras share the settings
and faults in this module.
"""

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field
from tetractl_microscope.pictures.picture_section import DeviceSource, MjpegSource, PictureSection

from tetractl.core.errors import SpecError
from tetractl.core.poses import Floats, GreyImage
from tetractl.spec.base import Model, NonNegative, Positive
from tetractl_emulator.fault_rows import (
    NO_REASON,
    SEEN_REASONS,
    FaultRow,
    fraction_between,
    one_of,
    value_between,
    whole_number,
)
from tetractl_emulator.faults import Fault, Share, Visible, fault_kind
from tetractl_emulator.loop import Loop
from tetractl_emulator.pictures.memory_camera import MemoryCamera
from tetractl_emulator.pictures.network_camera import (
    EmulatedNetworkCamera,
    PictureStream,
)
from tetractl_emulator.sides import Body, Facts, Stage
from tetractl_emulator.virtual_lab import LabClock

SPARE_PX = 64
"""Margin by which a field of noise is larger than an image [px]."""


class StreamSettings(Model):
    """Properties of an emulated camera; its latency [s] is the spec's."""

    width: int = Field(default=640, ge=64, le=8192)
    """Columns of an image [px]."""
    height: int = Field(default=480, ge=64, le=8192)
    """Rows of an image [px]."""
    rate: float = Field(default=30.0, ge=1, le=500)
    """Rate of images [Hz]."""
    noise: NonNegative = 2.0
    """Standard deviation of each pixel [grey levels]."""
    exposure: Positive = 0.004
    """Exposure time of an image [s]."""
    drips: bool = False
    """Whether the camera sends an endless answer byte by byte."""


STREAM_FAULTS = (
    fault_kind(
        "no_frames",
        "The camera takes no images.",
        Visible.SENT,
        rows=[FaultRow("no pictures", SEEN_REASONS)],
    ),
    fault_kind(
        "repeat",
        "The camera sends the same image repeatedly, at its usual rate.",
        Visible.SENT,
        rows=[FaultRow("picture frozen", SEEN_REASONS)],
    ),
    fault_kind(
        "half_rate",
        "The camera sends only every second image, or every n-th.",
        Visible.SENT,
        fields={"every": (Annotated[int, Field(ge=2, le=1000)], 2)},
        rows=[FaultRow("pictures slow", SEEN_REASONS, {"every": whole_number(2, 60)})],
    ),
    fault_kind(
        "late_pictures",
        "Images arrive late by this time [s].",
        fields={"by": Positive},
        rows=[FaultRow("pictures late", SEEN_REASONS, {"by": value_between(0.01, 1)})],
    ),
    fault_kind(
        "bad_pictures",
        "This fraction of the images is faulty: cut short (with or without an end marker), "
        "with a header that states 32767 x 32767 pixels, lost, or sent twice.",
        Visible.SENT,
        fields={
            "share": Share,
            "how": (Literal["cut", "cut_ended", "oversized", "lost", "doubled"], "cut"),
        },
        rows=[
            FaultRow(
                "pictures lost", SEEN_REASONS, {"share": fraction_between(0.02, 1.3), "how": "lost"}
            ),
            FaultRow(
                "pictures doubled",
                NO_REASON,
                {"share": fraction_between(0.02, 1.3), "how": "doubled"},
                weight=0.5,
            ),
            FaultRow(
                "pictures damaged",
                SEEN_REASONS,
                {
                    "share": fraction_between(0.02, 1.3),
                    "how": one_of("cut", "cut_ended", "oversized"),
                },
            ),
        ],
    ),
)


class SceneHistory:
    """The newest 200 scenes of a camera, as arrays that can be interpolated in time."""

    def __init__(self) -> None:
        self._scenes: deque[tuple[int, Floats]] = deque(maxlen=200)

    def add(self, time_ns: int, scene: Floats) -> None:
        """Add the scene at a time [ns]. The time must be later than all previous times."""
        self._scenes.append((time_ns, scene))

    def at(self, when_ns: int) -> Floats:
        """Interpolate linearly between the stored scenes, and return the scene at a time [ns].

        The first stored scene also counts for all earlier times, and the last stored scene for all
        later times. At least one scene must have been added.
        """
        scenes = list(self._scenes)
        times_ns = [time_ns for time_ns, _ in scenes]
        later_index = max(bisect_left(times_ns, when_ns), 1)
        i = min(later_index, len(scenes) - 1)
        if i == 0:
            return scenes[0][1]
        earlier_ns, earlier_scene = scenes[i - 1]
        later_ns, later_scene = scenes[i]
        fraction = min(max((when_ns - earlier_ns) / (later_ns - earlier_ns), 0.0), 1.0)
        # a cell may have divided between the two scenes
        return earlier_scene + fraction * (
            later_scene[..., : earlier_scene.shape[-1]] - earlier_scene
        )


class ShownBodies:
    """Records when the arrived images last showed each body to our program.

    It is used only in memory, where it is known which images have arrived. When an image arrives,
    the records of all earlier images are deleted.

    Args:
        count: Number of bodies.

    Attributes:
        newest_ns: For each body, the exposure time of the newest arrived image that shows the body
            [ns]. 0 if no such image has arrived.
    """

    def __init__(self, count: int) -> None:
        self.newest_ns = [0] * count
        self._visible: dict[int, Sequence[bool]] = {}  # by exposure

    def expose(self, exposed_ns: int, visible: Sequence[bool]) -> None:
        """Record which bodies are visible in an image.

        Args:
            exposed_ns: When the image is exposed, on the camera's clock [ns].
            visible: Whether each body is visible.
        """
        self._visible[exposed_ns] = visible

    def come(self, exposed_ns: int, start_ns: int) -> None:
        """Record that an image has arrived.

        Args:
            exposed_ns: When the image was exposed, on the camera's clock [ns].
            start_ns: Time at which the camera's clock started [ns].
        """
        for i, visible in enumerate(self._visible[exposed_ns]):
            if visible:
                self.newest_ns[i] = start_ns + exposed_ns
        self._visible = {
            t_ns: visible for t_ns, visible in self._visible.items() if t_ns >= exposed_ns
        }


class StreamedCamera(ABC):
    """Base class of emulated cameras that serve images as MJPEG.

    A subclass returns the present scene as an array, and draws the scene at an exposure. A separate
    thread draws the images.

    Args:
        stage: The data and functions that the emulated devices share.
        settings: Settings of the stream.
        bodies: The robots.

    Raises:
        SpecError: If the section's source of images cannot be emulated.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def __init__(self, stage: Stage, settings: StreamSettings, bodies: Sequence[Body]) -> None:
        section = stage.lab.camera
        assert isinstance(section, PictureSection), "the camera searches pictures"
        source = section.source
        is_over_http = stage.wires.http
        emulated_sources = MjpegSource if is_over_http else (MjpegSource, DeviceSource)
        if not isinstance(source, emulated_sources):
            raise SpecError(
                f"a camera source of type {source.type} cannot be emulated",
                "set the source to {type: mjpeg, url: 'http://127.0.0.1:8080/'}",
            )
        chosen_port = stage.options.command_port
        stated_port = urlsplit(source.url).port or 80 if isinstance(source, MjpegSource) else 0
        self._stage = stage
        self._bodies = bodies
        self._port = stated_port if chosen_port is None else chosen_port
        self._drips = settings.drips
        self.pictures = PictureStream(
            self._draw_exposure,
            settings.rate,
            settings.exposure,
            section.latency,
            stage.acting,
            self.seed,
        )
        self._history = SceneHistory()
        self._shown_bodies: ShownBodies | None = None  # None over HTTP, where arrivals are unknown
        self._has_client = False
        self._exposures = 0
        self._releases = ExitStack()

    @property
    def seed(self) -> int:
        """The seed of all random numbers in the emulation."""
        return self._stage.options.seed

    @property
    def shown_ns(self) -> Sequence[int]:
        """For each body, the exposure time of the newest image that showed it to our program [ns].

        The result is empty over HTTP, where the arrivals of images are unknown.
        """
        return () if self._shown_bodies is None else self._shown_bodies.newest_ns

    @abstractmethod
    def _scene(self) -> Floats:
        """Return the present scene as an array that can be interpolated in time."""

    def _visible_now(self) -> Sequence[bool]:
        """Check for each body whether it is visible: neither carried nor covered.

        The entries are in the order of the actuator's bodies.
        """
        covered_names = {fault.subject for fault in self._stage.acting.of_kind("untracked")}
        are_carried = self._stage.acting.robots_are_carried
        return [not are_carried and body.name not in covered_names for body in self._bodies]

    @abstractmethod
    def _draw(self, exposed_ns: int) -> GreyImage:
        """Draw the image of an exposure, using `_scene_at`. Called in the camera's thread."""

    def open(self, loop: Loop) -> Facts:
        """Start to serve the stream.

        Returns:
            Two entries, "camera" and "url": the URL of the stream.
        """
        wires = self._stage.wires
        clock = wires.clock()
        self._start_ns = loop.now() - clock.now()
        self._store_scene()
        self.camera: Any
        if wires.http:
            self.camera = EmulatedNetworkCamera(self.pictures, clock, self._port, self._drips)
        else:
            assert isinstance(clock, LabClock), "wires in memory are those of a LabClock"
            self._shown_bodies = ShownBodies(len(self._visible_now()))
            on_arrival = partial(self._shown_bodies.come, start_ns=self._start_ns)
            self.camera = MemoryCamera(self.pictures, clock, self._port, on_arrival)
        self._releases.enter_context(self.camera)
        self._report_exposure()
        return {"camera": self.camera.url, "url": self.camera.url}

    def close(self) -> Facts:
        """Stop the stream.

        Returns:
            One entry: "pictures" maps to the number of exposures.
        """
        self._releases.close()
        return {"pictures": self._exposures}

    @property
    def join(self) -> Any:
        """The function that connects our program's camera to this camera in memory."""
        return self.camera.join

    def _joined(self) -> None:
        """React to a client that starts to read. By default, nothing happens."""
        return

    def _draw_exposure(self, exposed_ns: int) -> GreyImage:
        """Draw the image of an exposure at a time [ns]. In memory, also record what it shows."""
        if self._shown_bodies is not None:
            self._shown_bodies.expose(exposed_ns, self._visible_now())
        return self._draw(exposed_ns)

    def _scene_at(self, t_ns: int) -> Floats:
        """Interpolate the scene at a time [ns] on the camera's clock."""
        return self._history.at(self._start_ns + t_ns)

    def _store_scene(self) -> None:
        """Store the present scene for exposures that are drawn later, every 5 ms."""
        now_ns = self._stage.timeline.now_ns
        self._history.add(now_ns, self._scene())
        # exposures are drawn between two of these scenes
        self._stage.timeline.at(now_ns + 5_000_000, self._store_scene)

    def _report_exposure(self) -> None:
        """Report an exposure, and a client that starts to read, and schedule the next exposure."""
        now_ns = self._stage.timeline.now_ns
        self._exposures += 1
        self._stage.exposed(self._exposures, 0)  # our camera counts the images that arrive
        self._stage.sent(self._exposures)
        if self.camera.watched and not self._has_client:
            self._joined()
            self._stage.client(self.camera.url)
        self._has_client = self.camera.watched
        self._stage.timeline.at(now_ns + self.pictures.middle_ns(1), self._report_exposure)
