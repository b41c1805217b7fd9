"""`tetractl export`: writes the tables of logs as CSV files."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, out_option
from tetractl.core.errors import Exit, LogError, UsageError, printable
from tetractl.log.read.find import find_logs
from tetractl.tools.table.table_files import open_table_files


def export(
    logs: Logs,
    out: Annotated[
        Path,
        out_option(
            "DIR|FILE",
            "Folder for all tables, or a .csv file for the single table named by --table.",
        ),
    ],
    table: Annotated[
        str | None,
        option("NAME", "Write only this table: trials, steps, poses, estimates or events. [all]"),
    ] = None,
) -> int:
    """Write trials as tidy CSV tables.

    Each table has one row for each trial, control step, pose, estimate or event. The names of its
    columns end in their units. All tables have the columns `log` and `trial`, by which they can be
    joined. Existing files with the same names are overwritten.

    Example: tetractl export logs/three-m3pi -o tables
    """
    from tetractl.statistics.trial_tables import read_tables

    table_paths = _table_paths(out, table)
    log_paths = find_logs(logs)
    unread: list[Path] = []
    damaged: list[Path] = []
    with open_table_files(table_paths) as add_rows, ui.show_progress("Reading logs") as on_log:
        for number, path in enumerate(log_paths):
            on_log(number, len(log_paths))
            try:
                rows_of, damage = read_tables(path, table_paths)
            except LogError as error:
                ui.print_messages(f"warning: {error.message}")
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
    """Return the file of each table to write: in the folder `out`, or `out` for one table."""
    from tetractl.statistics.trial_tables import TABLES

    if table is not None and table not in TABLES:
        raise UsageError(
            f"there is no table named {table!r}", f"the tables are {', '.join(TABLES)}"
        )
    names = TABLES if table is None else (table,)
    ending = out.suffix.lower()
    is_table = ending == ".csv" and not out.is_dir()
    if is_table and table is None:
        raise UsageError(
            f"{out}: a single file can hold only one table",
            "choose the table with --table, or give a folder",
        )
    folder = out.parent if is_table else out
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not there.is_dir():
        raise UsageError(f"{there}: this is not a folder", "choose another folder with --out")
    return {name: out if is_table else out / f"{name}.csv" for name in names}
