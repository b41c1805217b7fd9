"""The server on the loopback address: a page, logs, a layout, and a live WebSocket for log viewers.

Everything is below a path that begins with a random token, which keeps other users of this machine
out: they can reach the port but do not know the link. Requests whose `Host` is another site's name
for this machine (DNS rebinding) are refused, and so are WebSockets whose `Origin` is a page of
another site in the operator's browser. Requests for parts of a file (RFC 9110, section 14) and from
pages of another origin (CORS) are answered, since a log viewer reads a log piece by piece.
"""

import hmac
import re
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self
from urllib.parse import quote, unquote, urlsplit

from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.serve.live import Viewers

ADDRESS = "127.0.0.1"
FOXGLOVE = "https://app.foxglove.dev"
"""Address of Foxglove in the browser."""
_ANY_PAGE: dict[str, object] = {
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Expose-Headers": "Accept-Ranges, Content-Length, Content-Range",
    "Cache-Control": "no-store",
}
"""Headers with which a browser passes a log on to a viewer's page."""


class LoopbackServer:
    """Serves from construction to `close`, in threads of its own; a context manager.

    It serves `page` (HTML), `layout` (JSON) and `logs`, which are files by name, and streams `live`
    over WebSockets, also to pages of the viewer at the address `viewer`. Their addresses are
    `page_url`, `layout_url`, `log_url` and `live_url`. Raises UsageError if the port cannot be
    used; port 0 takes any free port.
    """

    def __init__(
        self,
        port: int = 0,
        page: bytes = b"",
        layout: bytes = b"{}",
        logs: Mapping[str, Path] | None = None,
        live: "Viewers | None" = None,
        viewer: str = "",
    ) -> None:
        # 96 random bits; a link fits next to the arena on a terminal of 80 columns
        self.token = secrets.token_urlsafe(12)
        self.page, self.layout, self.logs = page, layout, dict(logs or {})
        self.live, self.viewer = live, viewer
        try:
            self._http = _Server((ADDRESS, port), partial(_Handler, self))
        except OSError as error:
            why = f"port {port}: cannot be used: {error.strerror}"
            raise UsageError(why, "try --port 0") from error
        self.port: int = self._http.server_address[1]
        self._thread = threading.Thread(
            target=self._http.serve_forever, args=(0.05,), name="viewers", daemon=True
        )
        self._thread.start()

    @property
    def page_url(self) -> str:
        """The address of the page."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    @property
    def layout_url(self) -> str:
        """The address of the layout."""
        return f"{self.page_url}layout.json"

    @property
    def live_url(self) -> str:
        """The address of the WebSocket."""
        return f"ws://{ADDRESS}:{self.port}/{self.token}"

    def log_url(self, name: str) -> str:
        """Return the address of a log."""
        return f"{self.page_url}logs/{quote(name)}"

    def close(self) -> None:
        """Send the viewers their last messages, end their connections, and stop the server."""
        if self.live:
            self.live.close()
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Do nothing, so that no request prints on the operator's terminal."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "tetractl", ""
    timeout = 30

    def __init__(self, server: LoopbackServer, *args: Any) -> None:
        self._site = server
        super().__init__(*args)

    def do_GET(self) -> None:
        if self._site.live and (self.headers.get("Upgrade") or "").lower() == "websocket":
            self._upgrade(self._site.live.converse)
        else:
            self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_OPTIONS(self) -> None:
        """Answer the CORS preflight before a viewer's request for a part of a file."""
        if self._wanted() is None:
            self._head(HTTPStatus.NOT_FOUND, {"Content-Length": 0})
            return
        allowed = {
            "Access-Control-Allow-Methods": "GET, HEAD, OPTIONS",
            "Access-Control-Allow-Headers": "Range",
            "Access-Control-Allow-Private-Network": "true",
        }
        self._head(HTTPStatus.NO_CONTENT, _ANY_PAGE | allowed)

    def _upgrade(self, converse: Callable[[socket.socket, bytes], None]) -> None:
        """Call `converse` with the WebSocket's connection and the request that was read from it."""
        self.close_connection = True
        token, origin = self.path.strip("/"), self.headers.get("Origin")
        if not (self._let_in(token) and is_viewers_origin(origin, self._site.viewer)):
            self._head(HTTPStatus.FORBIDDEN, {"Content-Length": 0})
            return
        self.connection.settimeout(None)
        head = "".join(f"{name}: {value}\r\n" for name, value in self.headers.items())
        line = f"{self.command} {self.path} {self.request_version}\r\n"
        converse(self.connection, f"{line}{head}\r\n".encode("latin-1"))

    def _let_in(self, token: str) -> bool:
        """Return whether a request has this server's `Host` and, compared in constant time, its
        token.
        """
        ours = (f"{ADDRESS}:{self._site.port}", f"localhost:{self._site.port}")
        right = hmac.compare_digest(token.encode(), self._site.token.encode())
        return right and self.headers.get("Host") in ours

    def _answer(self, body: bool) -> None:
        wanted = self._wanted()
        if isinstance(wanted, bytes):
            kind = "text/html" if wanted is self._site.page else "application/json"
            headers: dict[str, object] = {
                "Content-Type": f"{kind}; charset=utf-8",
                "Content-Length": len(wanted),
                "Referrer-Policy": "no-referrer",
            }
            if wanted is self._site.layout:
                headers["Content-Disposition"] = 'attachment; filename="layout.json"'
            self._head(HTTPStatus.OK, headers)
            if body:
                self.wfile.write(wanted)
            return
        with suppress(OSError):
            if wanted is not None:
                with wanted.open("rb") as file:
                    self._part(file, body)
                return
        self._head(HTTPStatus.NOT_FOUND, {"Content-Length": 0})

    def _wanted(self) -> bytes | Path | None:
        """Return the page, the layout or a log's file; None for any other address."""
        _, token, *rest = [unquote(step) for step in urlsplit(self.path).path.split("/")]
        if not self._let_in(token):
            return None
        if rest == [""]:
            return self._site.page or None
        if rest == ["layout.json"]:
            return self._site.layout
        return self._site.logs.get(rest[1]) if len(rest) == 2 and rest[0] == "logs" else None

    def _part(self, file: BinaryIO, body: bool) -> None:
        size = file.seek(0, 2)
        asked = self.headers.get("Range")
        span = (0, size - 1) if asked is None else byte_range(asked, size)
        if span is None:
            none = {"Content-Range": f"bytes */{size}", "Content-Length": 0}
            self._head(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, _ANY_PAGE | none)
            return
        first, last = span
        part = {} if asked is None else {"Content-Range": f"bytes {first}-{last}/{size}"}
        about = {
            "Content-Type": "application/octet-stream",
            "Accept-Ranges": "bytes",
            "Content-Length": last - first + 1,
        }
        status = HTTPStatus.PARTIAL_CONTENT if part else HTTPStatus.OK
        self._head(status, _ANY_PAGE | about | part)
        file.seek(first)
        left = last - first + 1 if body else 0
        while left > 0 and (block := file.read(min(left, 1 << 16))):
            self.wfile.write(block)
            left -= len(block)
        if left > 0:
            self.close_connection = True  # the file has become shorter meanwhile

    def _head(self, status: HTTPStatus, headers: Mapping[str, object]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Do nothing, so that requests are not printed."""


def is_viewers_origin(origin: str | None, viewer: str = "") -> bool:
    """Whether a request comes from a program (without `origin`), a desktop viewer or the page of a
    known viewer.

    Known viewers are Foxglove, any page served by this machine, and the viewer at address `viewer`.
    """
    if origin is None or origin in (FOXGLOVE, "file://"):
        return True
    where = urlsplit(origin)
    if where.scheme in ("http", "https") and where.hostname in (ADDRESS, "localhost"):
        return True
    return bool(where.netloc) and where[:2] == urlsplit(viewer)[:2]


def byte_range(asked: str, size: int) -> tuple[int, int] | None:
    """Return the first and last byte that a `Range` header requests, None if a file of `size` bytes
    has no such range.

    Several ranges are not supported and give None.
    """
    found = re.fullmatch(r"\s*bytes\s*=\s*(\d{0,18})\s*-\s*(\d{0,18})\s*", asked)
    if not found or not (found[1] or found[2]):
        return None
    if not found[1]:  # the last n bytes
        first, last = max(size - int(found[2]), 0), size - 1
        return (first, last) if int(found[2]) > 0 and size > 0 else None
    first, last = int(found[1]), min(int(found[2] or size - 1), size - 1)
    return (first, last) if first <= last else None
