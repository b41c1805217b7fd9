"""Reads images from a camera at this computer, a video file, or a network camera."""

import http.client
import io
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
from cv2.utils import logging
from PIL.JpegImagePlugin import JpegImageFile

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.core.poses import GreyImage
from tetractl.core.protocols import EMULATED_NAME
from tetractl_microscope.pictures.feed import Feed, Picture, SourceEndedError
from tetractl_microscope.pictures.multipart import Multipart
from tetractl_microscope.pictures.picture_section import (
    IMAGE_SIDE_MAX_PX,
    DeviceSource,
    FileSource,
    MjpegSource,
)

JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
INSTALL_FILMS = "pip install './packages/tetractl-microscope[films]'"
NO_CODE = b"\xff\x00" * 8  # 64 set bits: not a Huffman code, and more than a decoder reads ahead


def decode_to_grey(picture: Picture, size: tuple[int, ...] | None = None) -> GreyImage | None:
    """Decode an image of a source to grey levels.

    Args:
        picture: The image: pixels, or a JPEG file.
        size: Height and width that a JPEG file must have [px]. None for any size up to PIXELS_MAX.

    Returns:
        The grey levels, shape (height, width). None if the JPEG file is damaged or has another
        size.

    Raises:
        cv2.error: If OpenCV cannot convert the pixels.
    """
    content = picture.content
    if isinstance(content, np.ndarray):
        grey = cv2.cvtColor(content, cv2.COLOR_BGR2GRAY) if content.ndim == 3 else content
        return grey.astype(np.uint8, copy=False)
    # the end marker may stand before the last bytes, since some cameras pad the file
    end_index = content.rfind(JPEG_END, max(0, len(content) - 64))
    if not content.startswith(JPEG_START) or end_index < 0:
        return None
    # if a JPEG is cut short, a decoder fills the rest with grey up to the end marker; without the
    # marker the decoder waits for the missing codes, and Pillow raises
    try:
        jpeg = JpegImageFile(io.BytesIO(content[:end_index] + NO_CODE))
        has_size = max(jpeg.size) <= IMAGE_SIDE_MAX_PX if size is None else jpeg.size == size[::-1]
        if not has_size:
            return None
        jpeg.draft("L", jpeg.size)
        return np.asarray(jpeg) if jpeg.mode == "L" else None
    except Exception:  # Pillow's exceptions for hostile bytes are not documented
        return None


class DeviceFeed(Feed):
    """Images of a camera at this computer, read with OpenCV. Not tested with a real camera.

    Args:
        source: The fields of the source in the spec.
        clock: The clock for times.
        timeout_s: Not used.

    Raises:
        AbortError: If the camera cannot be opened, or does not accept the size, exposure or gain.
    """

    def __init__(self, source: DeviceSource, clock: Clock, timeout_s: float) -> None:
        self.rate_hz = source.rate
        self._name = f"camera {source.index}"
        self._clock = clock
        backend = cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY
        logging.setLogLevel(logging.LOG_LEVEL_ERROR)  # its others go to stderr, as ours do
        self._capture = capture = cv2.VideoCapture(source.index, backend)
        if not capture.isOpened():
            raise AbortError(
                f"{self._name} cannot be opened",
                "check that the camera is plugged in, that lab.camera.source.index is its number, "
                "and that no other program uses it",
            )
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*source.format))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, source.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, source.height)
        capture.set(cv2.CAP_PROP_FPS, source.rate)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # so that no old pictures wait in the buffer
        if source.exposure is not None:
            capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # by hand
        for setting, property_id, value in (
            ("exposure", cv2.CAP_PROP_EXPOSURE, source.exposure),
            ("gain", cv2.CAP_PROP_GAIN, source.gain),
        ):
            if value is not None and not (
                capture.set(property_id, value)
                and abs(capture.get(property_id) - value) <= 0.01 * value + 0.5
            ):
                capture.release()
                raise AbortError(
                    f"{self._name} does not accept {setting} {value:g}, and keeps "
                    f"{capture.get(property_id):g}",
                    "this command lists the camera's limits: v4l2-ctl --list-ctrls",
                )
        width = round(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if (width, height) != (source.width, source.height):
            capture.release()
            raise AbortError(
                f"{self._name} gives images of {width}x{height}, not "
                f"{source.width}x{source.height}",
                "choose a size from the list that this command prints: v4l2-ctl --list-formats-ext",
            )

    def read(self) -> Picture:
        """Wait for the next image.

        Raises:
            SourceEndedError: If the camera delivers no more images.
        """
        if not self._capture.grab():
            raise SourceEndedError(f"{self._name} sends no more images")
        received_ns = self._clock.now()  # taken before the picture is decompressed
        is_read, pixels = self._capture.retrieve()
        if not is_read:
            raise SourceEndedError(f"{self._name} sends no more images")
        return Picture(pixels, received_ns)

    def close(self) -> None:
        """Release the camera."""
        self._capture.release()


class FileFeed(Feed):
    """Images of a video file, read with imageio and played at its own rate or the spec's rate.

    Args:
        source: The fields of the source in the spec.
        clock: The clock for times.
        timeout_s: Not used.

    Raises:
        AbortError: If the file or imageio is missing, the file cannot be read, or no rate is
            known.
    """

    live = False
    emulated = True  # robots in a film cannot be steered

    def __init__(self, source: FileSource, clock: Clock, timeout_s: float) -> None:
        self._path = source.path
        self._clock = clock
        if not Path(source.path).is_file():
            raise AbortError(f"there is no file {source.path}", "see lab.camera.source.path")
        try:
            imageio = import_module("imageio.v3")
        except ModuleNotFoundError as error:
            raise AbortError(
                "a source of type file needs imageio, which is not installed", INSTALL_FILMS
            ) from error
        self._film: Any = None
        try:
            self._film = imageio.imopen(source.path, "r")
            self._images = _split_images(self._film)
            first_image = next(self._images)
            own_rate_hz = self._film.metadata().get("fps")
        except (Exception, StopIteration) as error:  # imageio does not document what it raises
            self.close()
            raise AbortError(
                f"{source.path} is not a video that imageio can read",
                f"convert it to MP4, AVI or TIFF, or {INSTALL_FILMS}",
            ) from error
        self.rate_hz = source.rate or own_rate_hz
        if not self.rate_hz:
            self.close()
            raise AbortError(
                f"{source.path} does not state its frame rate", "set lab.camera.source.rate"
            )
        self._shift_bits = max(0, int(first_image.max()).bit_length() - 8)
        self._images = chain([first_image], self._images)
        self._start_ns: int | None = None
        self._read_count = 0

    def read(self) -> Picture:
        """Wait until the next image of the video is due, and return this image.

        Raises:
            SourceEndedError: If the film has ended.
        """
        pixels = next(self._images, None)
        if pixels is None:
            raise SourceEndedError(f"{self._path} has ended")
        if self._start_ns is None:
            self._start_ns = self._clock.now()
        assert self.rate_hz is not None
        self._clock.sleep_until(self._start_ns + round(self._read_count * SECOND / self.rate_hz))
        self._read_count += 1
        return Picture(self._grey(pixels), self._clock.now())

    def close(self) -> None:
        """Close the file."""
        if self._film is not None:
            self._film.close()

    def _grey(self, pixels: np.ndarray) -> GreyImage:
        """Convert pixels to 8-bit grey levels, shifted by as many bits as the first image needs.

        Colours are averaged first, and larger levels become 255.
        """
        if pixels.ndim == 3:
            pixels = pixels[..., :3].mean(axis=-1)
        levels = pixels.astype(np.int64) >> self._shift_bits
        return np.clip(levels, 0, 255).astype(np.uint8)


def _split_images(film: Any) -> Iterator[np.ndarray]:
    """Yield the images of a video one by one. An array that holds several images is split."""
    for image in film.iter():
        is_stack = image.ndim > 2 and image.shape[-1] not in (3, 4)
        yield from image if is_stack else [image]


class MjpegFeed(Feed):
    """Images of a network camera, read over HTTP from its multipart stream.

    Args:
        source: The fields of the source in the spec.
        clock: The clock for times.
        timeout_s: Maximum time until the camera has answered the request [s].

    Raises:
        AbortError: If the camera does not answer in time, or with anything but an MJPEG stream.
    """

    def __init__(self, source: MjpegSource, clock: Clock, timeout_s: float) -> None:
        self._url = source.url
        self._clock = clock
        url = urlsplit(source.url)
        self._connection = connection = http.client.HTTPConnection(url.netloc, timeout=timeout_s)
        path = (url.path or "/") + (f"?{url.query}" if url.query else "")
        deadline_s = time.monotonic() + timeout_s
        try:
            connection.connect()
            self._socket: socket.socket = connection.sock
            # the socket's own timeout is per byte, this one is for the whole answer
            deadline_timer = threading.Timer(deadline_s - time.monotonic(), self.interrupt)
            deadline_timer.start()
            try:
                connection.request("GET", path)
                self._response = connection.getresponse()
            finally:
                deadline_timer.cancel()
            if time.monotonic() >= deadline_s:
                raise TimeoutError
        except (OSError, ValueError, http.client.HTTPException) as error:
            connection.close()
            is_late = time.monotonic() >= deadline_s
            reason = f"not within {timeout_s:g} s" if is_late else error or type(error).__name__
            raise AbortError(
                f"the camera at {source.url} does not answer: {reason}",
                "is the camera on, and is lab.camera.source.url its address?",
            ) from error
        content_type = self._response.headers.get_content_type()
        boundary = self._response.headers.get_param("boundary", "")
        if not isinstance(boundary, str):
            boundary = boundary[2]  # of charset, language and value
        if (
            self._response.status != 200
            or content_type != "multipart/x-mixed-replace"
            or not boundary
        ):
            self.close()
            raise AbortError(
                f"the camera at {source.url} does not send an MJPEG stream: it answers with "
                f"status {self._response.status}, {content_type}",
                "the camera must answer with multipart/x-mixed-replace and a boundary",
            )
        self.emulated = EMULATED_NAME in self._response.getheader("Server", "")
        self._socket.settimeout(None)  # from now on, closing the socket interrupts the reader
        self._parts = Multipart(boundary)
        self._unread_jpegs: list[bytes] = []

    @property
    def damaged(self) -> int:
        """Number of parts of the stream that could not be decoded."""
        return self._parts.damaged

    def read(self) -> Picture:
        """Wait for the next image of the stream.

        Raises:
            SourceEndedError: If the stream has ended or failed.
        """
        while not self._unread_jpegs:
            try:
                data = self._response.read1(1 << 16)
            except (OSError, ValueError, http.client.HTTPException) as error:
                raise SourceEndedError(f"{self._url} failed: {error}") from error
            if not data:
                raise SourceEndedError(f"the camera at {self._url} closed the stream")
            self._unread_jpegs = self._parts.feed(data)
        return Picture(self._unread_jpegs.pop(0), self._clock.now())

    def interrupt(self) -> None:
        """Shut down the connection, which ends a wait for data in another thread.

        It never raises.
        """
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection."""
        self._response.close()
        self._connection.close()
