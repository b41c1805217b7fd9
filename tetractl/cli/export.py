"""`tetractl export`: writes logs as tables that other programs can read."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tetractl.cli.options import Logs, progress
from tetractl.core.errors import Exit, UsageError


def export(
    logs: Logs,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="DIR|FILE",
            help="Folder for all tables; or a .csv or .parquet file for the one named by --table.",
        ),
    ],
    table: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write only this table: trials, steps, poses, estimates or events.  \\[all]",
        ),
    ] = None,
    format_name: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="File format: csv or parquet.  \\[csv]"),
    ] = None,
) -> int:
    """Write trials as tidy tables: one row per trial, control step, pose, estimate or event.

    The names of columns end in their units. Each table has the columns `log` and `trial`, by which
    tables can be joined. Existing files of these names are overwritten.

    Example: tetractl export logs/three-m3pi -o tables --format parquet
    """
    from tetractl.core.errors import LogError
    from tetractl.core.table.table_files import TableFiles
    from tetractl.log.read.find import find_logs
    from tetractl.results.trial_tables import of_log

    paths, kind = _files(output, table, format_name)
    found, unread = find_logs(logs), 0
    with TableFiles(paths, kind) as files, progress("Reading logs") as on_log:
        for number, path in enumerate(found):
            on_log(number, len(found))
            try:
                added = of_log(path, paths)
            except LogError as error:
                print(f"warning: {error}", file=sys.stderr)
                unread += 1
                continue
            for name, rows in added.items():
                files.add(name, rows, str(path))
    if unread == len(found):
        raise LogError("none of the logs can be read")
    for path in paths.values():
        print(path)
    return Exit.FAILED if unread else Exit.DONE


def _files(output: Path, table: str | None, kind: str | None) -> tuple[dict[str, Path], str]:
    """Return the file of each table, and the format."""
    from tetractl.core.table.table_files import FORMATS, check_format
    from tetractl.results.trial_tables import TABLES

    if table is not None and table not in TABLES:
        raise UsageError(f"there is no table {table!r}", f"there are {', '.join(TABLES)}")
    ending = output.suffix.lower().removeprefix(".")
    if ending not in FORMATS or output.is_dir():
        kind = kind or "csv"
        check_format(kind)
        names = TABLES if table is None else (table,)
        return {name: output / f"{name}.{kind}" for name in names}, kind
    if table is None:
        raise UsageError(f"{output}: one file holds one table", "name the table with --table")
    if kind not in (None, ending):
        raise UsageError(f"{output}: ends in .{ending}, but --format is {kind}")
    check_format(ending)
    return {table: output}, ending
