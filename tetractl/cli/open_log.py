"""`tetractl open`: shows logs in the browser of this machine."""

import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.serving import (
    LICHTBLICK,
    Browser,
    Viewer,
    answers,
    layout_of,
    link,
    print_forwarding,
)
from tetractl.core.errors import Exit


def open_logs(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG|FOLDER...", help="Trial logs: files, folders or globs."),
    ],
    port: Annotated[
        int,
        typer.Option(
            min=0, max=65535, metavar="N", help="TCP port to serve at; 0 for any free port."
        ),
    ] = 0,
    browser: Browser = True,
    viewer: Viewer = LICHTBLICK,
) -> int:
    """Show trials in the browser: the page of `tetractl report`, until Ctrl-C.

    The page and the logs named, and nothing else, are served on this machine's loopback address
    under a random path; nothing is uploaded. If Lichtblick runs here, two more addresses are
    printed: one opens the first log there, the other is a layout for its menu "Layouts", "Import
    from file", which frames the arena, shows the scene and plots error, J, solve time and estimate.

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
