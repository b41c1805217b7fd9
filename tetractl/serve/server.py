"""The server on the loopback address: a live WebSocket for log viewers.

Its path is a random token, which keeps other users of this machine out: they can reach the port but
do not know the link. Requests whose `Host` is another site's name for this machine (DNS rebinding)
are refused, and so are those whose `Origin` is a page of another site in the operator's browser.
"""

import hmac
import secrets
import threading
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.serve.live import Viewers

ADDRESS = "127.0.0.1"
FOXGLOVE = "https://app.foxglove.dev"
"""Address of Foxglove in the browser."""


class LoopbackServer:
    """Streams `live` over WebSockets at the address `url`, from construction to `close`, in threads
    of its own; a context manager.

    Raises UsageError if the port cannot be used; port 0 takes any free port.
    """

    def __init__(self, live: "Viewers", port: int = 0) -> None:
        # 96 random bits; a link fits next to the arena on a terminal of 80 columns
        self.token = secrets.token_urlsafe(12)
        self.live = live
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
    def url(self) -> str:
        """The address of the WebSocket."""
        return f"ws://{ADDRESS}:{self.port}/{self.token}"

    def close(self) -> None:
        """Send the viewers their last messages, end their connections, and stop the server."""
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
        """Pass the connection of an admitted WebSocket on, with the request that was read."""
        self.close_connection = True
        upgrade = (self.headers.get("Upgrade") or "").lower() == "websocket"
        if not (upgrade and self._let_in() and is_viewers_origin(self.headers.get("Origin"))):
            self.send_response(HTTPStatus.FORBIDDEN if upgrade else HTTPStatus.NOT_FOUND)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.connection.settimeout(None)
        head = "".join(f"{name}: {value}\r\n" for name, value in self.headers.items())
        line = f"{self.command} {self.path} {self.request_version}\r\n"
        self._site.live.converse(self.connection, f"{line}{head}\r\n".encode("latin-1"))

    def _let_in(self) -> bool:
        """Return whether a request has this server's `Host` and, compared in constant time, its
        token.
        """
        ours = (f"{ADDRESS}:{self._site.port}", f"localhost:{self._site.port}")
        token = self.path.strip("/").encode()
        right = hmac.compare_digest(token, self._site.token.encode())
        return right and self.headers.get("Host") in ours

    def log_message(self, format: str, *args: object) -> None:
        """Do nothing, so that requests are not printed."""


def is_viewers_origin(origin: str | None) -> bool:
    """Whether a request comes from a program (without `origin`), a desktop viewer or the page of a
    known viewer: Foxglove, or any page served by this machine.
    """
    if origin is None or origin in (FOXGLOVE, "file://"):
        return True
    where = urlsplit(origin)
    return where.scheme in ("http", "https") and where.hostname in (ADDRESS, "localhost")
