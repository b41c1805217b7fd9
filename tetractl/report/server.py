"""A file server on the loopback address, for a browser on this machine and nobody else.

Served are one page, the layout for a log viewer and the logs named, nothing else, and only under a
path that begins with a random token. Requests for a part of a file (RFC 9110, section 14) and from
pages of another origin (CORS) are answered, since a log viewer reads a log piece by piece. A `Host`
other than this server's is refused, so that no other site's name can be pointed at it.
"""

import re
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote, unquote, urlsplit

from tetractl.core.errors import UsageError
from tetractl.serve.door import ADDRESS, is_own_host, is_token, new_token

BLOCK_BYTES = 1 << 16


class FileServer:
    """The server and its addresses: `page_url`, `layout_url`, and `log_url` of a log by name."""

    def __init__(
        self, page: bytes, logs: Mapping[str, Path], port: int = 0, layout: bytes = b"{}"
    ) -> None:
        self.token = new_token()
        self.page, self.logs, self.layout = page, dict(logs), layout
        try:
            self._http = ThreadingHTTPServer((ADDRESS, port), partial(_Handler, self))
        except OSError as error:
            raise UsageError(f"port {port}: cannot be used: {error.strerror}") from error
        self._http.daemon_threads = True
        self.port = self._http.server_address[1]

    @property
    def page_url(self) -> str:
        """The address of the page."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    @property
    def layout_url(self) -> str:
        """The address of the layout."""
        return f"{self.page_url}layout.json"

    def log_url(self, name: str) -> str:
        """Return the address of a log."""
        return f"{self.page_url}logs/{quote(name)}"

    @contextmanager
    def running(self) -> Iterator[None]:
        """Answer requests, in a thread of its own, until the block ends."""
        thread = threading.Thread(target=self._http.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._http.shutdown()
            self._http.server_close()
            thread.join()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "tetractl", ""
    timeout = 30

    def __init__(self, server: FileServer, *args: object) -> None:
        self._files = server
        super().__init__(*args)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_OPTIONS(self) -> None:
        """Allow what a viewer asks for before it reads a part of a file."""
        if self._wanted() is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.NO_CONTENT)
        self._allow()
        self.send_header("Access-Control-Allow-Methods", "GET, HEAD, OPTIONS")
        self.send_header("Access-Control-Allow-Headers", "Range")
        self.send_header("Access-Control-Allow-Private-Network", "true")
        self.end_headers()

    def _answer(self, body: bool) -> None:
        wanted = self._wanted()
        if wanted is None:
            self._refuse(HTTPStatus.NOT_FOUND)
        elif isinstance(wanted, bytes):
            page = wanted is self._files.page
            kind = "text/html" if page else "application/json"
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(wanted)))
            if not page:
                self.send_header("Content-Disposition", 'attachment; filename="layout.json"')
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            if body:
                self.wfile.write(wanted)
        else:
            try:
                with wanted.open("rb") as file:
                    self._part(file, body)
            except OSError:
                self._refuse(HTTPStatus.NOT_FOUND)

    def _wanted(self) -> bytes | Path | None:
        """Return the page, the layout, the file of a log, or None for what is not served."""
        if not is_own_host(self.headers.get("Host"), self._files.port):
            return None
        _, token, *rest = [unquote(step) for step in urlsplit(self.path).path.split("/")]
        if not is_token(token, self._files.token):
            return None
        if rest == [""]:
            return self._files.page
        if rest == ["layout.json"]:
            return self._files.layout
        return self._files.logs.get(rest[1]) if len(rest) == 2 and rest[0] == "logs" else None

    def _part(self, file: BinaryIO, body: bool) -> None:
        size = file.seek(0, 2)
        asked = self.headers.get("Range")
        span = (0, size - 1) if asked is None else byte_range(asked, size)
        if span is None:
            self.send_response(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
            self._allow()
            self.send_header("Content-Range", f"bytes */{size}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        first, last = span
        self.send_response(HTTPStatus.OK if asked is None else HTTPStatus.PARTIAL_CONTENT)
        self._allow()
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(last - first + 1))
        if asked is not None:
            self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
        self.end_headers()
        file.seek(first)
        left = last - first + 1 if body else 0
        while left > 0 and (block := file.read(min(left, BLOCK_BYTES))):
            self.wfile.write(block)
            left -= len(block)
        if left > 0:
            self.close_connection = True  # the file was cut meanwhile

    def _allow(self) -> None:
        self.send_header("Access-Control-Allow-Origin", "*")
        self.send_header(
            "Access-Control-Expose-Headers", "Accept-Ranges, Content-Length, Content-Range"
        )
        self.send_header("Cache-Control", "no-store")

    def _refuse(self, status: HTTPStatus) -> None:
        self.send_response(status)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def byte_range(asked: str, size: int) -> tuple[int, int] | None:
    """Return the first and last byte of a `Range` header, None where it cannot be satisfied.

    Of several ranges none is given.
    """
    found = re.fullmatch(r"\s*bytes\s*=\s*(\d{0,18})\s*-\s*(\d{0,18})\s*", asked)
    if not found or not (found[1] or found[2]):
        return None
    if not found[1]:  # the last n bytes
        first, last = max(size - int(found[2]), 0), size - 1
        return (first, last) if int(found[2]) > 0 and size > 0 else None
    first, last = int(found[1]), min(int(found[2] or size - 1), size - 1)
    return (first, last) if first <= last else None
