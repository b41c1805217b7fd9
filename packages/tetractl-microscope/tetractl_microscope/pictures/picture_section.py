"""The sources of images in a spec, for all cameras that search images for robots or cells.

OpenCV is imported only if a camera is opened.
"""

from pkgutil import resolve_name
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import Clock, MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.spec.base import Model, NonNegative, Positive
from tetractl.spec.lab_section import CameraSection
from tetractl.spec.registry_fields import KindSection
from tetractl_microscope.pictures.feed import Feed
from tetractl_microscope.registries import PICTURE_SOURCES

IMAGE_SIDE_MAX_PX = 8192  # maximum width and height of an image [px]
Pixels = Annotated[int, Field(ge=64, le=IMAGE_SIDE_MAX_PX)]


class PictureSource(Model):
    """A source of images in a spec: the base class of all sources, such as a camera or a film.

    Each type of source is a class in the registry of picture sources.
    """

    type: Any  # the source's name, a Literal in each subclass
    feed: ClassVar[str]
    """The `Feed` that delivers the images of this source, as "module:class".

    `open` imports the class and calls it with (source, clock, timeout_s).
    """

    @property
    def shown(self) -> str:
        """A short description of the source for display, such as its address."""
        return str(self.type)

    def open(self, clock: Clock, timeout_s: float) -> Feed:
        """Open the source of images.

        Args:
            clock: The clock that gives the time at which an image is received.
            timeout_s: Maximum time to wait for an answer of the source [s].

        Raises:
            AbortError: If the source cannot be opened.
        """
        return resolve_name(self.feed)(self, clock, timeout_s)

    def checked(self) -> None:
        """Check that the source delivers valid images, for `tetractl kinds --check`.

        Reads five images. Their times must rise, and their pixels must have 8 bits. A source that
        cannot be opened is not checked further.
        """
        from tetractl_testing.expect import expect, expect_true

        clock = MonotonicClock()
        try:
            feed = self.open(clock, 5.0)
        except AbortError as error:
            expect(f"the camera was not opened, so its images were not checked ({error.message})")
            return
        try:
            pictures = [feed.read() for _ in range(5)]
        finally:
            feed.interrupt()
            feed.close()
        received_ns = [reading.received_ns for reading in pictures]
        times_rise = received_ns == sorted(set(received_ns)) and received_ns[-1] <= clock.now()
        expect_true(
            "read: times increase, and are times of the given clock", times_rise, str(received_ns)
        )
        are_images = [
            isinstance(reading.content, bytes) or reading.content.dtype == np.uint8
            for reading in pictures
        ]
        expect_true("read: images are JPEG bytes, or arrays of 8-bit pixels", are_images)
        shapes = [
            np.shape(reading.content)
            for reading in pictures
            if not isinstance(reading.content, bytes)
        ]
        are_shapes_valid = [
            len(shape) == 2 or (len(shape) == 3 and shape[2] == 3) for shape in shapes
        ]
        expect_true(
            "read: arrays have the shape (height, width) or (height, width, 3)", are_shapes_valid
        )


class DeviceSource(PictureSource):
    """A source of images: a camera connected to this computer, opened by OpenCV."""

    feed: ClassVar[str] = "tetractl_microscope.pictures.source:DeviceFeed"
    type: Literal["device"]
    index: int = Field(default=0, ge=0, le=63)
    """Number of the camera: 0 for /dev/video0."""
    width: Pixels = 1280
    """Columns of an image [px]."""
    height: Pixels = 720
    """Rows of an image [px]."""
    rate: Positive = 30.0
    """Rate of images that is requested from the camera [Hz]."""
    format: Literal["MJPG", "YUYV"] = "MJPG"
    """Pixel format on the cable; most USB cameras reach their full rate only in `MJPG`."""
    exposure: Positive | None = None
    """Exposure time in the camera's own unit; in Video4Linux, 0.1 ms.

    By default, the camera chooses it, and lowers its rate in dim light.
    """
    gain: NonNegative | None = None
    """Gain in the camera's own unit; by default the camera chooses it."""

    @property
    def shown(self) -> str:
        """The number of the camera, for display."""
        return f"camera {self.index}"


class FileSource(PictureSource):
    """A source of images: a video file that imageio reads, such as MP4, AVI or TIFF, played once.

    It shows what a camera would find in this video. Nothing can be steered.
    """

    feed: ClassVar[str] = "tetractl_microscope.pictures.source:FileFeed"
    type: Literal["file"]
    path: str = Field(min_length=1, max_length=500)
    """Path of the video file, absolute or relative to the working directory."""
    rate: Positive | None = None
    """Rate of images [Hz]. By default, the rate that the file states. A TIFF file states none."""

    @property
    def shown(self) -> str:
        """The path of the video file, for display."""
        return self.path


class MjpegSource(PictureSource):
    """A source of images: a network camera that sends JPEG images over HTTP without end (MJPEG)."""

    feed: ClassVar[str] = "tetractl_microscope.pictures.source:MjpegFeed"
    type: Literal["mjpeg"]
    url: str = Field(pattern=r"^http://[^\s/?#@]+(/[^\s]*)?$", max_length=500)
    """Address of the stream, such as http://192.168.1.30:8080/stream."""

    @property
    def shown(self) -> str:
        """The address of the stream, for display."""
        return self.url


class MicroManagerSource(PictureSource):
    """A source of images: a microscope's camera, read through Micro-Manager.

    It was not tested with a real camera.
    """

    feed: ClassVar[str] = "tetractl_microscope.pictures.micro_manager:MicroManagerFeed"
    type: Literal["micromanager"]
    config: str = Field(min_length=1, max_length=500)
    """The configuration file that Micro-Manager's wizard wrote. Its device adapters are taken from
    the folder where Micro-Manager is installed. The environment variable MICROMANAGER_PATH names
    another folder. A field with a slash or backslash is refused. The configuration only needs the
    camera.
    """

    @property
    def shown(self) -> str:
        """The path of the configuration file, for display."""
        return self.config


class PictureSection(CameraSection):
    """A camera in a spec that finds robots or cells in the images of its `source`."""

    source: Annotated[PictureSource, KindSection(PICTURE_SOURCES, PictureSource)]
    """The source of the images."""
    latency: NonNegative = 0.05
    """Time from the exposure to the arrival of an image [s]. Sources do not report this time."""
    connect: Positive = 5.0
    """Maximum time to wait for the source to open, and then for the first image [s]."""

    def bounds(self) -> dict[str, str]:
        """Return the source of the images for display: {"camera": text}."""
        return {"camera": self.source_name}

    @property
    def source_name(self) -> str:
        """A short description of the source for display, such as its address."""
        return self.source.shown
