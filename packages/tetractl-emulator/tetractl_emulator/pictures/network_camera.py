"""An emulated network camera, which serves drawn pictures as multipart MJPEG on this computer."""

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
from tetractl.core.poses import Grey
from tetractl.core.protocols import EMULATED_NAME
from tetractl.tools.worker import LOOK_S
from tetractl_emulator.faults import ActingFaults

BOUNDARY = "emulated-by-tetractl"


@dataclass(frozen=True, slots=True)
class PictureTiming:
    """When pictures are exposed and sent: the middle of picture k's exposure, which lasts
    `exposure_s`, is k / `rate_hz` after the camera was entered, and the picture is sent `latency_s`
    after the middle.
    """

    rate_hz: float = 30.0
    exposure_s: float = 0.0
    latency_s: float = 0.0

    def middle_ns(self, number: int) -> int:
        """Return the middle of a picture's exposure, after the camera was entered [ns]."""
        return round(number * SECOND / self.rate_hz)

    @property
    def half_ns(self) -> int:
        """Half the time of an exposure [ns]."""
        return round(self.exposure_s * SECOND / 2)

    @property
    def latency_ns(self) -> int:
        """Time from the middle of an exposure to the sending of its picture [ns]."""
        return round(self.latency_s * SECOND)


class EmulatedNetworkCamera:
    """Serves pictures at http://127.0.0.1:`port`/; a context manager.

    `draw(exposed_ns)` returns the picture whose exposure has its middle at a time on `clock`. A
    picture is sent when its `timing` says so, or as soon as it is drawn; a busy host skips some
    exposures. `seed` draws which parts faults spoil. A camera that `drips` sends an endless header
    byte by byte. TetractlError if the port is in use.
    """

    def __init__(
        self,
        draw: Callable[[int], Grey],
        clock: Clock,
        timing: PictureTiming,
        port: int = 0,
        drips: bool = False,
        acting: ActingFaults | None = None,
        seed: int = 0,
    ) -> None:
        self.timing = timing
        self._chance = random.Random(seed)
        self._newest = b""  # the last part, before faults spoil it
        self.acting = acting or ActingFaults()
        self._drips = drips
        self._draw = draw
        self._clock = clock
        self._clients: set[queue.Queue[tuple[int, bytes]]] = set()
        self._closing = threading.Event()
        self._open(port)

    def _open(self, port: int) -> None:
        camera = self

        class Answer(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                camera._serve(self)

            def log_message(self, format: str, *args: object) -> None:
                """Do nothing, so that requests are not printed."""

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Answer)
        except OSError as error:
            raise TetractlError(f"port {port} cannot be opened: {error.strerror}") from error
        self._server.daemon_threads = True
        self._threads = [
            threading.Thread(
                target=self._server.serve_forever, args=(LOOK_S,), name="emulated-http", daemon=True
            ),
            threading.Thread(target=self._expose, name="emulated-camera", daemon=True),
        ]

    @property
    def port(self) -> int:
        """The port that was really opened."""
        return self._server.server_address[1]

    @property
    def watched(self) -> bool:
        """Whether a client reads the stream."""
        return bool(self._clients)

    @property
    def url(self) -> str:
        """The stream's URL."""
        return f"http://127.0.0.1:{self.port}/"

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop taking pictures, and close every connection."""
        self._closing.set()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def _expose(self) -> None:
        start = self._clock.now()
        half = self.timing.half_ns
        number = 0
        while not self._closing.is_set():
            due = int((self._clock.now() - start - half) * self.timing.rate_hz / SECOND)
            number = max(number + 1, due)  # a busy host skips some exposures
            exposed = start + self.timing.middle_ns(number)
            self._clock.sleep_until(exposed + half)
            if self.withholds(number) or not self._clients:
                continue
            jpeg = coded(self._draw(exposed))
            for client in list(self._clients):
                with suppress(queue.Full):
                    client.put_nowait((exposed + self._latency_ns, jpeg))

    @property
    def _latency_ns(self) -> int:
        """Time from the middle of an exposure to the sending of its picture, at present [ns]."""
        return self.timing.latency_ns + round(self.acting.total_by("late_pictures") * SECOND)

    def withholds(self, number: int) -> bool:
        """Return whether the picture with this number is not exposed or not sent."""
        slow = any(number % fault.every for fault in self.acting.of("half_rate"))
        return slow or bool(self.acting.of("no_frames"))

    def changed(self, part: bytes) -> bytes:
        """Return a part as it is sent: the one before if pictures repeat, and perhaps spoilt."""
        if not self.acting.of("repeat") or not self._newest:
            self._newest = part
        sent = self._newest
        for fault in self.acting.of("bad_pictures"):
            if self._chance.random() < fault.share:
                sent = SPOILT[fault.how](sent)
        return sent

    def _serve(self, answer: BaseHTTPRequestHandler) -> None:
        # further pictures are dropped, for a client that reads slowly
        mine: queue.Queue[tuple[int, bytes]] = queue.Queue(32)
        self._clients.add(mine)
        try:
            answer.send_response(200)
            answer.send_header("Server", f"camera ({EMULATED_NAME})")
            answer.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
            if self._drips:
                answer.flush_headers()
            while self._drips and not self._closing.wait(LOOK_S):
                answer.wfile.write(b"X")
            answer.end_headers()
            while not self._closing.is_set():
                with suppress(queue.Empty):
                    due, jpeg = mine.get(timeout=LOOK_S)
                    self._clock.sleep_until(due)
                    answer.wfile.write(self.changed(part(jpeg)))
        except OSError:
            pass  # the client has gone
        finally:
            self._clients.discard(mine)


def coded(picture: Grey, quality: int = 90) -> bytes:
    """Return a picture as a JPEG file."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def part(jpeg: bytes) -> bytes:
    """Return one part of the stream for a JPEG file, beginning with the boundary."""
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"


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


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "cut": cut_short,
    "cut_ended": cut_before_its_end,
    "oversized": oversized,
    "lost": lambda sent_part: b"",
    "doubled": lambda sent_part: sent_part + sent_part,
}
"""What becomes of a part, by the ways of the fault `bad_pictures`."""
