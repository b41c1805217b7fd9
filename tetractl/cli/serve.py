"""`run --serve`: show trials in Foxglove or Lichtblick as they run."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tetractl.cli import ui
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import UsageError

if TYPE_CHECKING:
    from tetractl.core.protocols import Observer

PORT = 8765
"""TCP port at which Foxglove and Lichtblick look for a WebSocket by default."""


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
    from tetractl.serve.live import ServedRun, Viewers
    from tetractl.serve.server import LoopbackServer

    viewers = Viewers(name)
    with LoopbackServer(viewers, port) as server:
        ui.tell(f"served at {server.url}")
        yield [ServedRun(viewers, MonotonicClock())]
