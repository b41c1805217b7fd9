"""An emulated network camera, which serves drawn pictures as multipart MJPEG on this computer."""

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self

import cv2

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import EMULATED_NAME
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Grey
from tetractl.core.worker import LOOK_S

BOUNDARY = "emulated-by-tetractl"


class EmulatedNetworkCamera:
    """Serves pictures at http://127.0.0.1:`port`/; a context manager.

    `draw(exposed_ns)` returns the picture whose exposure has its middle at a time on `clock`. The
    middle of picture k's exposure, which lasts `exposure_s`, is k / `rate_hz` after the camera was
    entered. The picture is sent `latency_s` after the middle of the exposure, or as soon as it is
    drawn; a busy host skips some exposures. Each of `changes` changes the bytes of a part before
    they are sent; `frozen` stops exposures while it is set; only every `every`-th picture is sent.
    A camera that `drips` sends an endless header byte by byte. TetractlError if the port is in use.
    """

    def __init__(
        self,
        draw: Callable[[int], Grey],
        clock: Clock,
        rate_hz: float = 30.0,
        exposure_s: float = 0.0,
        latency_s: float = 0.0,
        quality: int = 90,
        port: int = 0,
        drips: bool = False,
    ) -> None:
        self.changes: list[Callable[[bytes], bytes]] = []
        self._drips = drips
        self.frozen = threading.Event()
        self.every = 1
        self.exposed = 0  # number of the last picture
        self._draw = draw
        self._clock = clock
        self._rate_hz = rate_hz
        self._quality = quality
        self._half = round(exposure_s * SECOND / 2)
        self.latency_ns = round(latency_s * SECOND)
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
        half = self._half
        while not self._closing.is_set():
            due = int((self._clock.now() - start - half) * self._rate_hz / SECOND)
            self.exposed = max(self.exposed + 1, due)  # a busy host skips some exposures
            exposed = start + round(self.exposed * SECOND / self._rate_hz)
            self._clock.sleep_until(exposed + half)
            if self.frozen.is_set() or not self._clients or self.exposed % self.every:
                continue
            jpeg = coded(self._draw(exposed), self._quality)
            for client in list(self._clients):
                with suppress(queue.Full):
                    client.put_nowait((exposed + self.latency_ns, jpeg))

    def _changed(self, part: bytes) -> bytes:
        """Return a part as it is sent."""
        for change in self.changes:
            part = change(part)
        return part

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
                    answer.wfile.write(self._changed(part(jpeg)))
        except OSError:
            pass  # the client has gone
        finally:
            self._clients.discard(mine)


def coded(picture: Grey, quality: int) -> bytes:
    """Return a picture as a JPEG file."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def part(jpeg: bytes) -> bytes:
    """Return one part of the stream for a JPEG file, beginning with the boundary."""
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"
