"""`tetractl report` and `open`: write a page of logs, and show it in the browser."""

from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, out_option
from tetractl.core.errors import Exit, printable
from tetractl.tools.files import write_atomically


def report(
    logs: Logs,
    out: Annotated[
        Path, out_option("FILE", "HTML file to write. An existing file is overwritten.")
    ] = Path("report.html"),
    title: Annotated[str | None, option("TEXT", "Title of the page. [experiment's name]")] = None,
) -> int:
    """Write one HTML page that shows trials and their statistics.

    The page needs no network. It contains a player of every trial (of about 60 if there are more
    than 100), the tables of `tetractl stats`, the distribution of the errors, figures of each batch
    and of the first trial, and where the numbers come from. Each folder is a batch. Several batches
    are shown side by side.

    Example: tetractl report logs/three-m3pi -o report.html
    """
    from tetractl.report import page

    ui.require_folder_of(out)
    with ui.show_progress("Reading logs") as on_log:
        html, unread = page.report(logs, title, on_log)
    write_atomically(out, html.encode())
    ui.print_messages(*(f"warning: {problem}" for problem in unread))
    print(printable(str(out)))
    return Exit.FAILED if unread else Exit.DONE


def open_(
    logs: Logs,
    out: Annotated[
        Path | None,
        out_option("FILE", "HTML file to write. [one in the folder for temporary files]"),
    ] = None,
) -> int:
    """Write the page of `tetractl report` to a temporary file, and open it in the browser.

    Example: tetractl open trial-000.mcap
    """
    from tetractl.tools.children import open_in_browser

    out = out or Path(mkdtemp(prefix="tetractl-")) / "report.html"
    code = report(logs, out)
    if not open_in_browser(out.resolve().as_uri()):
        ui.print_messages(
            "notice: no browser was found on this computer; open the file in a browser yourself"
        )
    return code
