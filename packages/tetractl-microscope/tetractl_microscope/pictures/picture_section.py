"""The part of a spec shared by all cameras that search images: the source of the images.

OpenCV is imported only if the camera is built.
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

PIXELS_MAX = 8192  # longest side of a picture [px]
Pixels = Annotated[int, Field(ge=64, le=PIXELS_MAX)]


class PictureSource(Model):
    """A source of images; each kind is a class in the registry of picture sources."""

    type: Any  # the source's name, a Literal in each subclass
    feed: ClassVar[str]
    """The class of the open source, a `Feed`, as "module:class".

    It is called with (source, clock, timeout_s), and imported only when the source is opened.
    """

    @property
    def shown(self) -> str:
        """The source for display, such as its address."""
        return str(self.type)

    def open(self, clock: Clock, timeout_s: float) -> Feed:
        """Open the source, waiting up to `timeout_s` [s] for an answer.

        Raises:
            AbortError: If that fails.
        """
        return resolve_name(self.feed)(self, clock, timeout_s)

    def checked(self) -> None:
        """Read five images, for `tetractl kinds --check`.

        A source that cannot be opened is not checked further.
        """
        from tetractl_testing.expect import expect, expect_true

        clock = MonotonicClock()
        try:
            feed = self.open(clock, 5.0)
        except AbortError as error:
            expect(f"the camera was not opened, so its images were not checked ({error.message})")
            return
        try:
            readings = [feed.read() for _ in range(5)]
        finally:
            feed.interrupt()
            feed.close()
        times = [reading.received_ns for reading in readings]
        rise = times == sorted(set(times)) and times[-1] <= clock.now()
        expect_true("read: times rise, on the clock given", rise, str(times))
        jpeg = [
            isinstance(reading.content, bytes) or reading.content.dtype == np.uint8
            for reading in readings
        ]
        expect_true("read: JPEG bytes, or pixels of 8 bits", jpeg)
        shapes = [
            np.shape(reading.content)
            for reading in readings
            if not isinstance(reading.content, bytes)
        ]
        right = [len(shape) == 2 or (len(shape) == 3 and shape[2] == 3) for shape in shapes]
        expect_true("read: pixels (height, width) or (height, width, 3)", right)


class DeviceSource(PictureSource):
    """A camera connected to this computer, opened by OpenCV."""

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
        """The camera's number."""
        return f"camera {self.index}"


class FileSource(PictureSource):
    """A film that imageio reads, such as MP4, AVI or TIFF, played once.

    It shows what the camera would see in this film; nothing can be steered.
    """

    feed: ClassVar[str] = "tetractl_microscope.pictures.source:FileFeed"
    type: Literal["file"]
    path: str = Field(min_length=1, max_length=500)
    """Path of the film, absolute or relative to the working directory."""
    rate: Positive | None = None
    """Rate of images [Hz]; by default the rate that the film states. A TIFF states none."""

    @property
    def shown(self) -> str:
        """The path."""
        return self.path


class MjpegSource(PictureSource):
    """A network camera: JPEG pictures in one endless HTTP answer (multipart/x-mixed-replace)."""

    feed: ClassVar[str] = "tetractl_microscope.pictures.source:MjpegFeed"
    type: Literal["mjpeg"]
    url: str = Field(pattern=r"^http://[^\s/?#@]+(/[^\s]*)?$", max_length=500)
    """Address of the stream, such as http://192.168.1.30:8080/stream."""

    @property
    def shown(self) -> str:
        """The address."""
        return self.url


class MicroManagerSource(PictureSource):
    """A microscope's camera through Micro-Manager; not tested with a real camera."""

    feed: ClassVar[str] = "tetractl_microscope.pictures.micro_manager:MicroManagerFeed"
    type: Literal["micromanager"]
    config: str = Field(min_length=1, max_length=500)
    """The configuration file that Micro-Manager's wizard wrote. Its device adapters are taken from
    the folder where Micro-Manager is installed; the environment variable MICROMANAGER_PATH names
    another folder. A field with a slash or backslash is refused. The camera alone is enough.
    """

    @property
    def shown(self) -> str:
        """The configuration file."""
        return self.config


class PictureSection(CameraSection):
    """A camera that searches the images of its `source`."""

    source: Annotated[PictureSource, KindSection(PICTURE_SOURCES, PictureSource)]
    """Source of the images."""
    latency: NonNegative = 0.05
    """Time from exposure to arrival of an image [s]; sources do not report it."""
    connect: Positive = 5.0
    """Maximum time to wait for the source to open, and then for the first image [s]."""

    def bounds(self) -> dict[str, str]:
        """Describe the source of the images for display."""
        return {"camera": self.source_name}

    @property
    def source_name(self) -> str:
        """Name of the source for display, such as its address."""
        return self.source.shown
