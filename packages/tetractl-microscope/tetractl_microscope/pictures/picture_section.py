"""The part of a spec shared by all cameras that search pictures: the source of the pictures.

OpenCV is imported only if the camera is built.
"""

from typing import Annotated, Literal

from pydantic import Field

from tetractl.experiment.base import Model, NonNegative, Positive
from tetractl.experiment.lab_section import CameraSection

PIXELS_MAX = 8192  # longest side of a picture [px]
Pixels = Annotated[int, Field(ge=64, le=PIXELS_MAX)]


class DeviceSource(Model):
    """A camera connected to this computer, opened by OpenCV."""

    type: Literal["device"]
    index: int = Field(default=0, ge=0, le=63)
    """Number of the camera: 0 for /dev/video0."""
    width: Pixels = 1280
    """Columns of a picture [px]."""
    height: Pixels = 720
    """Rows of a picture [px]."""
    rate: Positive = 30.0
    """Rate of pictures [Hz]."""
    format: Literal["MJPG", "YUYV"] = "MJPG"
    """Pixel format on the cable; most USB cameras reach their full rate only in `MJPG`."""


class FileSource(Model):
    """A video file, played once at its own rate."""

    type: Literal["file"]
    path: str = Field(min_length=1, max_length=500)
    """Path of the video file, absolute or relative to the working directory."""


class MjpegSource(Model):
    """A network camera: JPEG pictures in one endless HTTP answer (multipart/x-mixed-replace)."""

    type: Literal["mjpeg"]
    url: str = Field(pattern=r"^http://[^\s/?#@]+(/[^\s]*)?$", max_length=500)
    """Address of the stream, such as http://192.168.1.30:8080/stream."""


class MicroManagerSource(Model):
    """A microscope's camera through Micro-Manager; not tested with a real camera."""

    type: Literal["micromanager"]
    config: str = Field(min_length=1, max_length=500)
    """The configuration file that Micro-Manager's wizard wrote. Its device adapters are taken from
    the folder where Micro-Manager is installed; the environment variable MICROMANAGER_PATH names
    another. A field with a slash or backslash is refused; the camera alone is enough.
    """


Source = Annotated[
    DeviceSource | FileSource | MjpegSource | MicroManagerSource, Field(discriminator="type")
]


class PictureSection(CameraSection):
    """A camera that searches the pictures of its `source`."""

    source: Source
    """Source of the pictures."""
    latency: NonNegative = 0.05
    """Time from exposure to arrival of a picture [s]; sources do not report it."""
    connect: Positive = 5.0
    """Longest wait for the source to open, and then for the first picture [s]."""

    def bounds(self) -> dict[str, str]:
        """Return the source of the pictures as {name: text}, for display."""
        return {"camera": self.source_name}

    @property
    def source_name(self) -> str:
        """Name of the source for display, such as its address."""
        match self.source:
            case DeviceSource(index=index):
                return f"camera {index}"
            case FileSource(path=name) | MjpegSource(url=name) | MicroManagerSource(config=name):
                return name
