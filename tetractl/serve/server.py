"""A server for log viewers on the same computer: a live WebSocket on the loopback address.

The path of its address is a random token, which keeps other users of this machine out: they can
reach the port but do not know the link. Requests whose `Host` is another site's name for this
machine (DNS rebinding) are refused, and so are those whose `Origin` is a page of another site in
the operator's browser.
"""

import hmac
import logging
import re
import secrets
import threading
from http import HTTPStatus
from typing import Self

from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Origin, Subprotocol

from tetractl.core.errors import UsageError
from tetractl.serve.foxglove_protocol import PROTOCOL
from tetractl.serve.live import CLOSE_S, Viewers

ADDRESS = "127.0.0.1"
"""The loopback address of this machine."""
TOKEN_BYTES = 12
"""Random bytes of a link, 96 bits; it fits next to the arena on a terminal of 80 columns."""
OPEN_S = 2.0
"""Time within which a request must be complete, for which `close` may wait [s]."""
MESSAGE_MAX = 1 << 16
"""Maximum size of a message from a viewer [bytes]."""
ORIGINS = (
    None,  # a program
    Origin("file://"),  # a desktop viewer
    Origin("https://app.foxglove.dev"),
    re.compile(rf"https?://({re.escape(ADDRESS)}|localhost)(:\d+)?"),
)
"""Origins from which connections are accepted.

They are programs, which send no origin, and the pages of known viewers and of this machine.
"""

_QUIET = logging.getLogger(__name__)
_QUIET.addHandler(logging.NullHandler())  # otherwise errors of viewers are printed to stderr
_QUIET.propagate = False


class LoopbackServer:
    """A server that streams trials to log viewers over WebSockets, at the address `url`.

    The server is a context manager. It runs in its own threads from construction to `close`.

    Args:
        live: The viewers that connect to the server.
        port: TCP port of the server. 0 for any free port.

    Raises:
        UsageError: If the port cannot be used.
    """

    def __init__(self, live: Viewers, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self.live = live
        try:
            self._server = serve(
                live.serve_viewer,
                ADDRESS,
                port,
                origins=ORIGINS,
                subprotocols=[Subprotocol(PROTOCOL)],
                compression=None,
                process_request=self._refuse_stranger,
                server_header="tetractl",
                open_timeout=OPEN_S,
                ping_interval=None,
                close_timeout=CLOSE_S / 2,
                max_size=MESSAGE_MAX,
                logger=_QUIET,
            )
        except OSError as error:
            problem = f"port {port} cannot be used: {error.strerror}"
            raise UsageError(problem, "try --port 0") from error
        self.port: int = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="viewers", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """The address at which viewers connect to the WebSocket."""
        return f"ws://{ADDRESS}:{self.port}/{self.token}"

    def close(self) -> None:
        """Send the viewers their last messages, end their connections, and stop the server."""
        self.live.close()
        self._server.shutdown()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _refuse_stranger(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the refusal of a request without this server's `Host` or token. None to accept it.

        The token is compared in constant time.
        """
        hosts = request.headers.get_all("Host")
        is_our_host = hosts in ([f"{ADDRESS}:{self.port}"], [f"localhost:{self.port}"])
        token = request.path.strip("/").encode()
        has_our_token = hmac.compare_digest(token, self.token.encode())
        if has_our_token and is_our_host:
            return None
        return connection.respond(HTTPStatus.FORBIDDEN, "")
