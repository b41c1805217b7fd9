"""`tetractl report`: writes one HTML page of trials and their statistics."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.options import Logs, progress
from tetractl.core.errors import Exit, UsageError


def report(
    logs: Logs,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="HTML file to write; an existing file is overwritten.",
        ),
    ] = Path("report.html"),
    title: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Title of the page.  \\[experiment's name]")
    ] = None,
) -> int:
    """Write one HTML page that shows trials and their statistics, and needs no network.

    The page holds a player of every trial, the tables of `tetractl stats`, the distribution of the
    errors, figures of each batch and of the first trial, and where the numbers come from. Each
    folder is a batch; several batches are shown side by side.

    Example: tetractl report logs/three-m3pi -o report.html
    """
    from tetractl.core.files import save_whole
    from tetractl.report import page

    if not output.parent.is_dir():  # checked before the logs are read
        raise UsageError(f"{output}: there is no folder {output.parent}")

    with progress("Reading logs") as on_log:
        html, unread = page.report(logs, title, on_log)
    save_whole(output, html.encode())
    for problem in unread:
        print(f"warning: {problem}", file=sys.stderr)
    print(output)
    return Exit.FAILED if unread else Exit.DONE
