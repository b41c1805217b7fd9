"""`tetractl serve` and `tetractl open`: show a trial in a log viewer, or logs in the browser."""

import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.options import Logs, warn_of_damage
from tetractl.cli.serving import (
    LICHTBLICK,
    PORT,
    Browser,
    ServerPort,
    Viewer,
    answers,
    layout_of,
    link,
    print_forwarding,
)
from tetractl.core.errors import Exit, UsageError

SPECS = (".yaml", ".yml")


def serve(
    what: Annotated[
        Path,
        typer.Argument(metavar="LOG|SPEC", help="The log of a trial to play, or a spec to run."),
    ],
    rate: Annotated[
        float,
        typer.Option(metavar="R", help="With a LOG: speed, in seconds of the trial per second."),
    ] = 1.0,
    start: Annotated[
        float, typer.Option(metavar="S", help="With a LOG: begin at this second of the trial.")
    ] = 0.0,
    until: Annotated[
        float | None, typer.Option(metavar="S", help="With a LOG: end at this second of the trial.")
    ] = None,
    loop: Annotated[bool, typer.Option(help="With a LOG: at its end, start again.")] = True,
    paused: Annotated[
        bool,
        typer.Option(
            "--paused", help="With a LOG: start paused, until the viewer or a key plays it."
        ),
    ] = False,
    port: ServerPort = PORT,
    browser: Browser = True,
    viewer: Viewer = LICHTBLICK,
) -> int:
    """Show a trial in Foxglove or Lichtblick by a live WebSocket, until Ctrl-C.

    The trial is served on this machine's loopback address under a random path; nothing is uploaded.
    The browser opens Lichtblick if it runs on this machine, otherwise Foxglove. A layout for the
    viewer's menu "Layouts", "Import from file" is served too.

    A LOG is played over and over: the viewer plays, pauses, seeks and sets the rate, and so do the
    keys of `tetractl replay` on a terminal.

    The trials of a SPEC are run as by `tetractl run SPEC --serve`; that command has more options.

    Example: tetractl serve trial-000.mcap
    """
    if what.suffix.lower() in SPECS:
        from tetractl.cli.run import run

        if (rate, start, until, loop, paused) != (1.0, 0.0, None, True, False):
            raise UsageError(
                "only a LOG can be played back",
                "leave out the options for playback, or give a LOG in place of the SPEC",
            )
        return run(what, serve=True, port=port)
    if not 0 < rate < float("inf"):
        raise UsageError(f"--rate must be above 0, not {rate:g}")
    from tetractl.cli.replay import is_terminal
    from tetractl.core.clock import MonotonicClock
    from tetractl.log.read.find import find_log
    from tetractl.log.read.reader import trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.replay.player import Player, Recording, span
    from tetractl.run.interrupt import interrupted_once
    from tetractl.serve.live import ServedReplay
    from tetractl.serve.server import FOXGLOVE, LoopbackServer

    path, wall = find_log(what), MonotonicClock()
    contents = scan(path)
    recording = Recording(trial_of(contents))
    played = span(recording, start, until)
    warn_of_damage(recording.log)
    player = Player(recording, wall, played, rate=rate, loop=loop, paused=paused)
    served = ServedReplay(contents, player)
    server = LoopbackServer(port, layout=layout_of([path]), live=served.viewers, viewer=viewer)
    with suppress(KeyboardInterrupt), interrupted_once(), server:
        print_forwarding(server)
        print(f"served at {server.live_url}", flush=True)
        shown = link(FOXGLOVE, "foxglove-websocket", server.live_url)
        print(f"in Foxglove: {shown}")
        if answers(viewer):
            shown = link(viewer, "foxglove-websocket", server.live_url)
            print(f"in Lichtblick: {shown}")
        print(f"  its layout: {server.layout_url}", flush=True)
        if browser:
            webbrowser.open(shown)
        if is_terminal():
            from rich.console import Console

            from tetractl.view.terminal.replay_screen import play

            note = f"served at {server.live_url}"
            play(Console(), player, follow=served.follow, note=note)
        else:
            served.play(wall)
    return Exit.FAILED if recording.log.damage else Exit.DONE


def open_logs(
    logs: Logs,
    port: ServerPort = 0,
    browser: Browser = True,
    viewer: Viewer = LICHTBLICK,
) -> int:
    """Show trials in the browser: the page of `tetractl report`, until Ctrl-C.

    The page and the logs named, and nothing else, are served on this machine's loopback address
    under a random path; nothing is uploaded. If Lichtblick runs on this machine, two more addresses
    are printed: one opens the first log in Lichtblick, the other is a layout for its menu
    "Layouts", "Import from file", which frames the arena, shows the scene and plots error, J, solve
    time and estimate.

    Example: tetractl open trial-000.mcap
    """
    from tetractl.log.read.find import find_logs
    from tetractl.report.page import report
    from tetractl.run.interrupt import interrupted_once
    from tetractl.serve.server import LoopbackServer

    found = find_logs(logs)
    html, unread = report(logs, None, lambda done, total: None)
    for problem in unread:
        print(f"warning: {problem}", file=sys.stderr)
    named = {f"{i}-{path.name}": path for i, path in enumerate(found)}
    server = LoopbackServer(port, html.encode(), layout_of(found), named)
    in_viewer = answers(viewer)  # imported first: Ctrl-C during an import would be lost
    with suppress(KeyboardInterrupt), interrupted_once(), server:
        print_forwarding(server)
        print(server.page_url, flush=True)
        if in_viewer:
            first = link(viewer, "remote-file", server.log_url(next(iter(named))))
            print(f"in Lichtblick: {first}\n  its layout: {server.layout_url}", flush=True)
        if browser:
            webbrowser.open(server.page_url)
        threading.Event().wait()
    return Exit.FAILED if unread else Exit.DONE
