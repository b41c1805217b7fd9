"""Options and functions for commands that show a trial in Foxglove or Lichtblick by a WebSocket."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlencode

import typer

from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.core.protocols import Observer
    from tetractl.serve.server import LoopbackServer

PORT = 8765
"""TCP port at which Foxglove and Lichtblick look for a WebSocket by default."""
LICHTBLICK = "http://localhost:8080"
"""Default address of Lichtblick on this machine."""

Serve = Annotated[
    bool,
    typer.Option(
        "--serve", help="Print a link that shows the trial in Foxglove or Lichtblick as it runs."
    ),
]
Port = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=65535,
        metavar="N",
        help=f"With --serve: TCP port of the server; 0 for any free port.  \\[{PORT}]",
    ),
]
ServerPort = Annotated[
    int,
    typer.Option(min=0, max=65535, metavar="N", help="TCP port to serve at; 0 for any free port."),
]
Browser = Annotated[bool, typer.Option(help="Open the browser; otherwise only print the address.")]
Viewer = Annotated[
    str, typer.Option("--lichtblick", metavar="URL", help="Address at which Lichtblick runs.")
]


def wanted_port(serve: bool, port: int | None) -> int | None:
    """Return the port to serve at, None without --serve; UsageError for a port without --serve."""
    if port is not None and not serve:
        raise UsageError("--port needs --serve")
    return PORT if serve and port is None else port


@contextmanager
def served_run(name: str, port: int | None) -> "Iterator[list[Observer]]":
    """Yield the observers that send the trials of a `with` block to viewers; none if `port` is
    None."""
    if port is None:
        yield []
        return
    from tetractl.core.clock import MonotonicClock
    from tetractl.serve.live import ServedRun, Viewers
    from tetractl.serve.server import LoopbackServer

    viewers = Viewers(name)
    with LoopbackServer(port, live=viewers) as server:
        print(f"served at {server.live_url}", file=sys.stderr)
        yield [ServedRun(viewers, MonotonicClock())]


def print_forwarding(server: "LoopbackServer") -> None:
    """Print how to end a server, and how to reach it from another machine."""
    print("Ctrl-C ends the server; over ssh, forward the port:", file=sys.stderr)
    print(f"  ssh -L {server.port}:127.0.0.1:{server.port} HOST", file=sys.stderr)


def link(viewer: str, kind: str, address: str) -> str:
    """Return the link with which `viewer` opens a data source of the given kind at `address`."""
    return f"{viewer.rstrip('/')}/?{urlencode({'ds': kind, 'ds.url': address})}"


def layout_of(logs: list[Path]) -> bytes:
    """Return the viewer's layout for the first log that can be read."""
    from contextlib import suppress

    from tetractl.core.errors import LogError
    from tetractl.log.format.layout import layout
    from tetractl.log.read.reader import read_result

    for log in logs:
        with suppress(LogError):
            return layout(read_result(log).experiment.setup).encode()
    return b"{}"


def answers(url: str) -> bool:
    """Return whether a web server answers at an address within a second."""
    from http.client import HTTPException
    from urllib.request import urlopen

    try:
        with urlopen(url, timeout=1):
            return True
    except (OSError, ValueError, HTTPException):
        return False
