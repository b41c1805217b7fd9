"""`tetractl plot`, `report`, `open` and `export`: write figures, a page or tables of logs."""

from os.path import commonpath
from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, out_option
from tetractl.core.errors import Exit, LogError, UsageError, printable
from tetractl.log.read.find import find_logs
from tetractl.tools.files import save_whole
from tetractl.tools.retired import refuse_retired
from tetractl.tools.table.table_files import table_files

TRAJECTORY = "trajectory"
"""The figure that `plot` draws by default."""
VIDEO = "video"
Page = Annotated[Path, out_option("FILE", "HTML file to write; an existing file is overwritten.")]


def plot(
    logs: Logs,
    out: Annotated[
        Path | None,
        out_option(
            "FILE",
            "Picture to write: .png, .svg or .pdf; by default LOG-KIND.png in this folder. A "
            "video: .mp4, .gif or .webp, by default LOG-video.gif.",
        ),
    ] = None,
    kind: Annotated[
        str | None, option("NAME", "The figure to draw, a name from the lists above. [trajectory]")
    ] = None,
) -> int:
    """Draw a figure of one trial or several, and print the name of its file.

    trajectory: paths in one trial or several, the paper's Figure 5.
    convergence: cost over the iterations, the paper's Figure 3.
    swarm: particles of the first search, the paper's Figure 2.
    errors: errors over time, of one trial or, with their median by folder, of several.
    batch: final errors by folder: each trial, the mean with its interval, the distribution.
    over-time: signal, solve times, and the estimates of turning rate a, speed and so on.
    video: the trial as a video.

    Installed packages may add figures.

    The same log gives the same bytes. MP4 needs ffmpeg.

    Example: tetractl plot trial-000.mcap --kind convergence -o convergence.pdf
    """
    from tetractl.view.figures.draw import check_kind, draw
    from tetractl.view.style import file_format, save

    if kind == VIDEO:
        return _video(find_logs(logs), out)
    figure = kind or TRAJECTORY
    check_kind(figure)  # before the logs are read
    log_paths = find_logs(logs)
    path = out or _default_name(log_paths, figure)
    file_format(path)
    trials = [ui.open_trial(log) for log in log_paths]
    save(draw(figure, trials), path)
    print(printable(str(path)))
    return Exit.FAILED if any(trial.damage for trial in trials) else Exit.DONE


def _video(logs: list[Path], out: Path | None) -> int:
    """Write the video of one trial, and print the name of its file; return the exit code."""
    from tetractl.view.video import check_file, write_video

    if len(logs) > 1:
        raise UsageError(f"a video shows one trial, not {len(logs)}", "give one log")
    path = out or _default_name(logs, VIDEO).with_suffix(".gif")
    check_file(path)
    log = ui.open_trial(logs[0])
    with ui.progress("Drawing") as on_picture:
        speed = write_video(log, path, on_picture)
    if speed > 1:
        ui.tell(f"plays {speed} times faster than the trial")
    print(printable(str(path)))
    return Exit.FAILED if log.damage else Exit.DONE


def _default_name(logs: list[Path], kind: str) -> Path:
    """Return the picture's name: after the log, or after the folder that all logs are in."""
    common = Path(commonpath([log.absolute().parent for log in logs]))
    name = logs[0].name if len(logs) == 1 else common.name or "trials"
    return Path(f"{name.partition('.mcap')[0]}-{kind}.png")


def report(
    logs: Logs,
    out: Page = Path("report.html"),
    title: Annotated[str | None, option("TEXT", "Title of the page. [experiment's name]")] = None,
) -> int:
    """Write one HTML page that shows trials and their statistics, and needs no network.

    The page holds a player of every trial, or of some 60 out of more than 100, the tables of
    `tetractl stats`, the distribution of the errors, figures of each batch and of the first trial,
    and where the numbers come from. Each folder is a batch; several batches are shown side by side.

    Example: tetractl report logs/three-m3pi -o report.html
    """
    from tetractl.report import page

    ui.require_folder_of(out)
    with ui.progress("Reading logs") as on_log:
        html, unread = page.report(logs, title, on_log)
    save_whole(out, html.encode())
    ui.tell(*(f"warning: {problem}" for problem in unread))
    print(printable(str(out)))
    return Exit.FAILED if unread else Exit.DONE


def open_(
    logs: Logs,
    out: Annotated[
        Path | None, out_option("FILE", "HTML file to keep. [one in the folder of temporary files]")
    ] = None,
) -> int:
    """Write the page of `tetractl report` to a temporary file, and open it in the browser.

    Example: tetractl open trial-000.mcap
    """
    from tetractl.tools.children import open_in_browser

    out = out or Path(mkdtemp(prefix="tetractl-")) / "report.html"
    code = report(logs, out)
    if not open_in_browser(out.resolve().as_uri()):
        ui.tell("notice: no browser was found here; open the file in one")
    return code


def export(
    logs: Logs,
    out: Annotated[
        Path,
        out_option(
            "DIR|FILE",
            "Folder for all tables; or a .csv file for the one named by --table.",
        ),
    ],
    table: Annotated[
        str | None,
        option("NAME", "Write only this table: trials, steps, poses, estimates or events. [all]"),
    ] = None,
) -> int:
    """Write trials as tidy CSV tables: one row per trial, control step, pose, estimate or event.

    The names of columns end in their units. Each table has the columns `log` and `trial`, by which
    tables can be joined. Existing files of these names are overwritten.

    Example: tetractl export logs/three-m3pi -o tables
    """
    from tetractl.results.trial_tables import of_log

    table_paths = _table_paths(out, table)
    log_paths = find_logs(logs)
    unread: list[Path] = []
    damaged: list[Path] = []
    with table_files(table_paths) as add_rows, ui.progress("Reading logs") as on_log:
        for number, path in enumerate(log_paths):
            on_log(number, len(log_paths))
            try:
                rows_of, damage = of_log(path, table_paths)
            except LogError as error:
                ui.tell(f"warning: {error.message}")
                unread.append(path)
                continue
            ui.warn_of_damage(str(path), damage)
            if damage is not None:
                damaged.append(path)
            for name, rows in rows_of.items():
                add_rows(name, rows, str(path))
        if len(unread) == len(log_paths):
            raise LogError("none of the logs can be read")
    for path in table_paths.values():
        print(printable(str(path)))
    return Exit.FAILED if unread or damaged else Exit.DONE


def _table_paths(out: Path, table: str | None) -> dict[str, Path]:
    """Return the file of each table to write: of all tables in the folder `out`, or of one."""
    from tetractl.results.trial_tables import TABLES

    if table is not None and table not in TABLES:
        raise UsageError(f"there is no table {table!r}", f"there are {', '.join(TABLES)}")
    ending = out.suffix.lower().removeprefix(".")
    refuse_retired("export", ending)
    if ending != "csv" or out.is_dir():
        _refuse_file_as_folder(out)
        names = TABLES if table is None else (table,)
        return {name: out / f"{name}.csv" for name in names}
    if table is None:
        raise UsageError(f"{out}: one file holds one table", "name the table with --table")
    _refuse_file_as_folder(out.parent)
    return {table: out}


def _refuse_file_as_folder(folder: Path) -> None:
    """Raise UsageError if a folder cannot be made, as it or one that it is in is a file."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not there.is_dir():
        raise UsageError(f"{there}: not a folder", "name another with --out")
