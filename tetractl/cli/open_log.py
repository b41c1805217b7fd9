"""`tetractl open`: logs in the browser of this machine."""

import sys
import threading
import webbrowser
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated
from urllib.parse import urlencode

import typer

from tetractl.core.errors import Exit, UsageError

VIEWER = "http://localhost:8080"
"""Where Lichtblick answers when it is started on this machine as its manual tells."""


def open_logs(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG|FOLDER...", help="Logs of trials, folders of them, patterns."),
    ],
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="N", help="TCP port; 0 is any that is free.")
    ] = 0,
    browser: Annotated[
        bool, typer.Option(help="Open the browser; otherwise only print the address.")
    ] = True,
    viewer: Annotated[
        str, typer.Option("--lichtblick", metavar="URL", help="Where Lichtblick is started.")
    ] = VIEWER,
    foxglove: Annotated[
        bool,
        typer.Option(
            "--foxglove",
            help="Open one log in a viewer instead, by a live WebSocket, over and over: in "
            "Lichtblick where it answers, else in Foxglove, which can pause and seek.",
        ),
    ] = False,
) -> int:
    """Show trials in the browser: the page of `tetractl report`, until Ctrl-C.

    The page and the logs named, and nothing else, are served on this machine's loopback address
    under a random path; nothing is uploaded. Where Lichtblick answers, the address that opens the
    first log there is printed too, and that of a layout for its menu "Layouts", "Import from file":
    it frames the arena, shows the scene and plots error, J, solve time and estimate.

    Example: tetractl open trial-000.mcap
    """
    from tetractl.cli.serving import served_replay
    from tetractl.core.clock import MonotonicClock
    from tetractl.log.read.find import find_logs
    from tetractl.report.page import report
    from tetractl.report.server import FileServer
    from tetractl.run.interrupt import interrupted_once
    from tetractl.serve.door import FOXGLOVE

    found, live = find_logs(logs), None
    if foxglove and len(found) > 1:
        raise UsageError("--foxglove takes one log")
    wall = MonotonicClock()
    if foxglove:
        live = served_replay(found[0], wall, (0.0, None), loop=True, port=0, viewer=viewer)
    html, unread = report(logs, None, lambda done, total: None)
    for problem in unread:
        print(f"warning: {problem}", file=sys.stderr)
    server = FileServer(
        html.encode(),
        {f"{i}-{path.name}": path for i, path in enumerate(found)},
        port,
        _layout(found).encode(),
    )
    with suppress(KeyboardInterrupt), interrupted_once(), server.running(), ExitStack() as stack:
        shown, source = server.page_url, ("remote-file", server.log_url(f"0-{found[0].name}"))
        ports = [server.port]
        if live:
            stack.enter_context(live.server)
            ports.append(live.server.port)
            source = ("foxglove-websocket", live.server.url)
            shown = _with_source(f"{FOXGLOVE}/", source)
        print("Ctrl-C ends it; over ssh, forward the port:", file=sys.stderr)
        forwards = " ".join(f"-L {one}:127.0.0.1:{one}" for one in ports)
        print(f"  ssh {forwards} HOST", file=sys.stderr)
        print(server.page_url, flush=True)
        if live:
            print(f"in Foxglove: {shown}", flush=True)
        answers = _answers(viewer)
        if answers:
            in_lichtblick = _with_source(f"{viewer.rstrip('/')}/", source)
            print(f"in Lichtblick: {in_lichtblick}", flush=True)
            shown = in_lichtblick if live else shown
        if live or answers:
            print(f"  its layout: {server.layout_url}", flush=True)
        if browser:
            webbrowser.open(shown)
        if live:
            live.play(wall)
        else:
            threading.Event().wait()
    return Exit.FAILED if unread else Exit.DONE


def _with_source(viewer: str, source: tuple[str, str]) -> str:
    """Return the address that opens a source of data, its kind and address, in a viewer."""
    return f"{viewer}?{urlencode({'ds': source[0], 'ds.url': source[1]})}"


def _layout(logs: list[Path]) -> str:
    """Return the layout for the first log that can be read."""
    from tetractl.core.errors import LogError
    from tetractl.log.format.layout import layout
    from tetractl.log.read.reader import read_result

    for log in logs:
        with suppress(LogError):
            return layout(read_result(log).experiment.setup)
    return "{}"


def _answers(url: str) -> bool:
    """Whether a web server answers at an address within a second."""
    from http.client import HTTPException
    from urllib.request import urlopen

    try:
        with urlopen(url, timeout=1):
            return True
    except (OSError, ValueError, HTTPException):
        return False
