"""`tetractl serve` and `open`: show a trial in Foxglove or Lichtblick, or logs in the browser."""

import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlencode

from tetractl.cli import ui
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, LogError, UsageError
from tetractl.log.read.find import find_log, find_logs
from tetractl.run.interrupt import interrupted_once

if TYPE_CHECKING:
    from tetractl.core.protocols import Observer
    from tetractl.serve.server import LoopbackServer

SPECS = (".yaml", ".yml")
PORT = 8765
"""TCP port at which Foxglove and Lichtblick look for a WebSocket by default."""
LICHTBLICK = "http://localhost:8080"
"""Default address of Lichtblick on this machine."""

TCP = ui.ValueRange(0, 65535)


def serve(
    what: Path,
    rate: float = 1.0,
    start: float = 0.0,
    until: float | None = None,
    loop: bool = True,
    paused: bool = False,
    port: Annotated[int, TCP] = PORT,
    browser: bool = True,
    viewer: Annotated[str, "--lichtblick"] = LICHTBLICK,
) -> int:
    """Show a trial in Foxglove or Lichtblick by a live WebSocket, until Ctrl-C.

    The trial is served on this machine's loopback address under a random path; nothing is uploaded.
    The browser opens Lichtblick if it runs on this machine, otherwise Foxglove. A layout for the
    viewer's menu "Layouts", "Import from file" is served too.

    A LOG is played over and over: the viewer plays, pauses, seeks and sets the rate, and so do the
    keys of `tetractl replay` on a terminal.

    The trials of a SPEC are run as by `tetractl run SPEC --serve`; that command has more options.

    Example: tetractl serve trial-000.mcap

    Options:
      what LOG|SPEC: The log of a trial to play, or a spec to run.
      rate R: With a LOG: speed, in seconds of the trial per second.
      start S: With a LOG: begin at this second of the trial.
      until S: With a LOG: end at this second of the trial.
      loop: With a LOG: at its end, start again.
      paused: With a LOG: start paused, until the viewer or a key starts it.
      port N: TCP port to serve at; 0 for any free port.
      browser: Open the browser; otherwise only print the address.
      viewer URL: Address at which Lichtblick runs.
    """
    if what.suffix.lower() in SPECS:
        from tetractl.cli.run import run

        if (rate, start, until, loop, paused) != (1.0, 0.0, None, True, False):
            raise UsageError(
                "only a LOG can be played back",
                "leave out the options for playback, or give a LOG in place of the SPEC",
            )
        return run(what, serve=True, port=port)
    ui.require_positive(rate)
    from tetractl.log.read.reader import trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.replay.player import Player, Recording, span
    from tetractl.serve.live import ServedReplay
    from tetractl.serve.server import FOXGLOVE, LoopbackServer

    path, wall = find_log(what), MonotonicClock()
    contents = scan(path)
    recording = Recording(trial_of(contents))
    played = span(recording, start, until)
    ui.warn_of_damage(recording.log.path, recording.log.damage)
    player = Player(recording, wall, played, rate=rate, loop=loop, paused=paused)
    served = ServedReplay(contents, player)
    server = LoopbackServer(port, layout=_layout_of([path]), live=served.viewers, viewer=viewer)
    with suppress(KeyboardInterrupt), interrupted_once(), server:
        _print_forwarding(server)
        print(f"served at {server.live_url}", flush=True)
        shown = _link(FOXGLOVE, "foxglove-websocket", server.live_url)
        print(f"in Foxglove: {shown}")
        if _answers(viewer):
            shown = _link(viewer, "foxglove-websocket", server.live_url)
            print(f"in Lichtblick: {shown}")
        print(f"  its layout: {server.layout_url}", flush=True)
        if browser:
            webbrowser.open(shown)
        if ui.is_terminal():
            from rich.console import Console

            from tetractl.view.terminal.replay_screen import play

            note = f"served at {server.live_url}"
            play(Console(), player, follow=served.follow, note=note)
        else:
            served.play(wall)
    return Exit.FAILED if recording.log.damage else Exit.DONE


def open_(
    logs: ui.Logs,
    port: Annotated[int, TCP] = 0,
    browser: bool = True,
    viewer: Annotated[str, "--lichtblick"] = LICHTBLICK,
) -> int:
    """Show trials in the browser: the page of `tetractl report`, until Ctrl-C.

    The page and the logs named, and nothing else, are served on this machine's loopback address
    under a random path; nothing is uploaded. If Lichtblick runs on this machine, two more addresses
    are printed: one opens the first log in Lichtblick, the other is a layout file (menu
    "Layouts", "Import from file") that frames the arena, shows the scene and plots error, J, solve
    time and estimate.

    Example: tetractl open trial-000.mcap

    Options:
      port N: TCP port to serve at; 0 for any free port.
      browser: Open the browser; otherwise only print the address.
      viewer URL: Address at which Lichtblick runs.
    """
    from tetractl.report.page import report
    from tetractl.serve.server import LoopbackServer

    found = find_logs(logs)
    html, unread = report(logs, None, lambda done, total: None)
    ui.tell(*(f"warning: {problem}" for problem in unread))
    named = {f"{i}-{path.name}": path for i, path in enumerate(found)}
    server = LoopbackServer(port, html.encode(), _layout_of(found), named)
    in_viewer = _answers(viewer)  # imported first: Ctrl-C during an import would be lost
    with suppress(KeyboardInterrupt), interrupted_once(), server:
        _print_forwarding(server)
        print(server.page_url, flush=True)
        if in_viewer:
            first = _link(viewer, "remote-file", server.log_url(next(iter(named))))
            print(f"in Lichtblick: {first}\n  its layout: {server.layout_url}", flush=True)
        if browser:
            webbrowser.open(server.page_url)
        threading.Event().wait()
    return Exit.FAILED if unread else Exit.DONE


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
    with LoopbackServer(port, live=viewers) as server:
        ui.tell(f"served at {server.live_url}")
        yield [ServedRun(viewers, MonotonicClock())]


def _print_forwarding(server: "LoopbackServer") -> None:
    """Print how to end a server, and how to reach it from another machine."""
    ui.tell("Ctrl-C ends the server; over ssh, forward the port:")
    ui.tell(f"  ssh -L {server.port}:127.0.0.1:{server.port} HOST")


def _link(viewer: str, kind: str, address: str) -> str:
    """Return the link with which `viewer` opens a data source of the given kind at `address`."""
    return f"{viewer.rstrip('/')}/?{urlencode({'ds': kind, 'ds.url': address})}"


def _layout_of(logs: list[Path]) -> bytes:
    """Return the viewer's layout for the first log that can be read."""
    from tetractl.log.format.layout import layout
    from tetractl.log.read.reader import read_result

    for log in logs:
        with suppress(LogError):
            return layout(read_result(log).experiment.setup).encode()
    return b"{}"


def _answers(url: str) -> bool:
    """Return whether a web server answers at an address within a second."""
    from http.client import HTTPException
    from urllib.request import urlopen

    try:
        with urlopen(url, timeout=1):
            return True
    except (OSError, ValueError, HTTPException):
        return False
