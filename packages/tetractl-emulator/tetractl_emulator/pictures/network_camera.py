"""An emulated network camera that serves synthetic images over HTTP, like a webcam.

The stream is multipart MJPEG: a sequence of parts, each with a boundary, a header, and a JPEG file.

    stream = PictureStream(draw, rate_hz=30.0)
    with EmulatedNetworkCamera(stream, MonotonicClock()) as camera:
        print(camera.url)                                 for any program that reads such streams

`memory_camera` passes the same parts to our program without a network.
"""

import queue
import random
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self

import cv2

from tetractl.core.clock import SECOND, Clock
from tetractl.core.errors import TetractlError
from tetractl.core.poses import GreyImage
from tetractl.core.protocols import EMULATED_NAME
from tetractl.tools.worker import POLL_S
from tetractl_emulator.faults import ActingFaults

BOUNDARY = "emulated-by-tetractl"
WAITING_MAX = 32
"""Maximum number of images that wait on the way to a client."""


@dataclass(frozen=True, slots=True)
class DuePart:
    """A part of a stream that waits to be sent.

    Attributes:
        due_ns: When it is sent [ns].
        exposed_ns: When its image was exposed [ns].
        drawn: Its bytes.
    """

    due_ns: int
    exposed_ns: int
    drawn: bytes


class PictureStream:
    """The images of an emulated camera as parts of a multipart stream, with the acting faults.

    The middle of the exposure of image k is k / `rate_hz` after the camera was entered. The image
    is sent `latency_s` after that.

    Args:
        draw: Returns the image for the middle of an exposure [ns], on the camera's clock.
        rate_hz: Images per second [Hz].
        exposure_s: Exposure time [s].
        latency_s: Time from the middle of an exposure until the image is sent [s].
        acting: The faults that act now. None if there are none.
        seed: Seed that determines which parts the fault `bad_pictures` damages.

    Attributes:
        half_ns: Half the exposure time [ns].
    """

    def __init__(
        self,
        draw: Callable[[int], GreyImage],
        rate_hz: float = 30.0,
        exposure_s: float = 0.0,
        latency_s: float = 0.0,
        acting: ActingFaults | None = None,
        seed: int = 0,
    ) -> None:
        self.rate_hz = rate_hz
        self.half_ns = round(exposure_s * SECOND / 2)
        self._latency_s = latency_s
        self._draw = draw
        self._acting = acting or ActingFaults()
        self._chance = random.Random(seed)
        self._newest = b""  # the last part, before faults spoil it

    def middle_ns(self, number: int) -> int:
        """Compute the time from the camera's start to the middle of an image's exposure [ns].

        Args:
            number: Number of the image. Image 0 would be exposed at the start.
        """
        return round(number * SECOND / self.rate_hz)

    @property
    def latency_ns(self) -> int:
        """Present time from the middle of an exposure until its image is sent [ns]."""
        fault_delay_s = self._acting.total_by("late_pictures")
        return round(self._latency_s * SECOND) + round(fault_delay_s * SECOND)

    def withholds(self, number: int) -> bool:
        """Check whether a fault drops the image with this number."""
        is_skipped = any(number % fault.every for fault in self._acting.of_kind("half_rate"))
        return is_skipped or bool(self._acting.of_kind("no_frames"))

    def drawn_part(self, exposed_ns: int) -> DuePart:
        """Draw the image of an exposure as a part of the stream, due after the present latency."""
        drawn = part(coded(self._draw(exposed_ns)))
        return DuePart(exposed_ns + self.latency_ns, exposed_ns, drawn)

    def send(self, drawn: bytes) -> bytes:
        """Return the bytes to send for a part that is due.

        A fault can replace the part by the previous part, and faults can damage the part.
        """
        if not self._acting.of_kind("repeat") or not self._newest:
            self._newest = drawn
        sent = self._newest
        for fault in self._acting.of_kind("bad_pictures"):
            if self._chance.random() < fault.share:
                sent = SPOILT[fault.how](sent)
        return sent


class EmulatedNetworkCamera:
    """An HTTP server for a stream of images at http://127.0.0.1:`port`/; a context manager.

    While there is a client, one thread exposes images and puts each of them into the queue of every
    client. On a busy computer, exposures are skipped. One thread for each client sends the images
    in its queue when they are due. A client that reads slowly misses images. `_lock` protects the
    queues and the stream, which the threads share.

    Args:
        stream: The images.
        clock: The clock for times.
        port: The port. 0 for any free port.
        drips: Whether to send an endless header instead, byte by byte.

    Raises:
        TetractlError: If the port is in use.
    """

    def __init__(
        self, stream: PictureStream, clock: Clock, port: int = 0, drips: bool = False
    ) -> None:
        self._stream = stream
        self._clock = clock
        self._drips = drips
        self._lock = threading.Lock()
        self._clients = set[queue.Queue[DuePart]]()
        self._closing = threading.Event()
        serve = self._serve

        class Answer(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                serve(self)

            def log_message(self, format: str, *args: object) -> None:
                """Do nothing, so that requests are not printed."""

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Answer)
        except OSError as error:
            raise TetractlError(
                f"cannot open port {port} for the emulated camera: {error.strerror}"
            ) from error
        self._server.daemon_threads = True
        self._threads = [
            threading.Thread(
                target=self._server.serve_forever, args=(POLL_S,), name="emulated-http", daemon=True
            ),
            threading.Thread(target=self._expose, name="emulated-camera", daemon=True),
        ]

    @property
    def port(self) -> int:
        """The TCP port at which the camera serves its stream."""
        return self._server.server_address[1]

    @property
    def watched(self) -> bool:
        """Whether a client reads the stream."""
        return bool(self._clients)

    @property
    def url(self) -> str:
        """The URL of the stream on this computer."""
        return url_at(self.port)

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop exposing images, and close every connection."""
        self._closing.set()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def _expose(self) -> None:
        """Expose images until the camera closes. Images are skipped if drawing takes too long."""
        stream = self._stream
        start_ns = self._clock.now()
        number = 0
        while not self._closing.is_set():
            past_ns = self._clock.now() - start_ns - stream.half_ns
            number = max(number + 1, int(past_ns * stream.rate_hz / SECOND))
            exposed_ns = start_ns + stream.middle_ns(number)
            self._clock.sleep_until(exposed_ns + stream.half_ns)
            if self.watched and not stream.withholds(number):
                self._queue(exposed_ns)

    def _queue(self, exposed_ns: int) -> None:
        """Draw an image, and put it into each client's queue. Full queues miss the image."""
        due = self._stream.drawn_part(exposed_ns)
        with self._lock:
            for client in self._clients:
                with suppress(queue.Full):
                    client.put_nowait(due)

    def _serve(self, answer: BaseHTTPRequestHandler) -> None:
        """Send images to a client until it disconnects or the camera closes.

        Each image is sent when its latency has passed.
        """
        waiting = queue.Queue[DuePart](WAITING_MAX)
        with self._lock:
            self._clients.add(waiting)
        try:
            answer.send_response(200)
            answer.send_header("Server", f"camera ({EMULATED_NAME})")
            answer.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            if self._drips:
                answer.flush_headers()
            while self._drips and not self._closing.wait(POLL_S):
                answer.wfile.write(b"X")
            answer.end_headers()
            while not self._closing.is_set():
                with suppress(queue.Empty):
                    due = waiting.get(timeout=POLL_S)
                    self._clock.sleep_until(due.due_ns)
                    with self._lock:
                        sent = self._stream.send(due.drawn)
                    answer.wfile.write(sent)
        except OSError:
            pass  # the client has gone
        finally:
            with self._lock:
                self._clients.discard(waiting)


def url_at(port: int) -> str:
    """Return the URL of a camera at a port of this computer."""
    return f"http://127.0.0.1:{port}/"


def coded(picture: GreyImage, quality: int = 90) -> bytes:
    """Encode a grey image as the bytes of a JPEG file; `quality` is from 0 to 100."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def part(jpeg: bytes) -> bytes:
    """Encode a JPEG file as one part of the stream, starting with the boundary."""
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"


def cut_short(sent_part: bytes) -> bytes:
    """Return the first half of a part, as if the connection had lost the second half."""
    return sent_part[: len(sent_part) // 2]


def cut_before_its_end(sent_part: bytes) -> bytes:
    """Remove the second half of a part's JPEG data, but keep the end marker."""
    jpeg = sent_part.partition(b"\r\n\r\n")[2]
    return part(jpeg[: len(jpeg) // 2] + b"\xff\xd9")


def oversized(sent_part: bytes) -> bytes:
    """Change the header of a part's JPEG file to a size of 32767 x 32767 pixels.

    A part without a JPEG header is returned unchanged.
    """
    size_at = sent_part.find(b"\xff\xc0") + 5
    if size_at < 5:
        return sent_part
    return sent_part[:size_at] + b"\x7f\xff\x7f\xff" + sent_part[size_at + 4 :]


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "cut": cut_short,
    "cut_ended": cut_before_its_end,
    "oversized": oversized,
    "lost": lambda sent_part: b"",
    "doubled": lambda sent_part: sent_part + sent_part,
}
"""Functions that damage a part of the stream, by the field `how` of the fault `bad_pictures`."""
