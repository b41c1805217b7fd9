"""`tetractl track`: follows the cells of a film."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import AsJson, progress
from tetractl.core.errors import Exit, UsageError, printable

if TYPE_CHECKING:
    from tetractl.film.fit_cell import CellSummary
    from tetractl.film.follow import Followed
    from tetractl.film.pictures import FilmPictures


def track(
    film: Annotated[
        Path, typer.Argument(metavar="FILM", help="A film, a TIFF stack or a folder of pictures.")
    ],
    field: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="CSV file of the field's direction over time, with columns time_s and "
            "direction_rad.",
        ),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            max=100,
            metavar="UM",
            help="Micrometres per pixel; by default as the film states it, or else guessed from "
            "the cells' size.",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=2000,
            metavar="HZ",
            help="Pictures per second, if the rate that the film states is wrong or missing.",
        ),
    ] = None,
    y_down: Annotated[
        bool, typer.Option("--y-down", help="Directions in the --field file run clockwise.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="DIR",
            help="Folder for the tables, a log and the film with the tracks drawn in.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Follow the cells of a film, and print speed, path and sway of each with 95 % intervals.

    If the field's direction over time is given, it also prints each cell's turning rate a, heading
    bias and whether it has a magnet. Nothing is steered. Exits with 1 if no cell swims in the film.

    Example: tetractl track dish.avi --field field.csv --scale 2.3 -o tracks
    """
    from tetractl.core.table.table_files import json_text
    from tetractl.core.table.terminal_table import print_tables
    from tetractl.film.field_file import read_field
    from tetractl.film.film_tables import as_items, cell_table
    from tetractl.film.fit_cell import summarise
    from tetractl.film.follow import follow
    from tetractl.film.pictures import open_film

    if y_down and field is None:
        raise UsageError("--y-down needs --field")
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: exists already", "name another with --out")
    directions = None if field is None else read_field(field, y_down)
    pictures = open_film(film, rate, scale)
    name = printable(str(film))
    for remark in pictures.remarks:
        print(f"{name}: {remark}", file=sys.stderr)
    with progress("Following") as on_picture:
        found = follow(
            pictures, pictures.um_px, directions, lambda number: on_picture(number, None)
        )
    with progress("Fitting"):
        cells = summarise(found, directions)
    if out is not None:
        _write(out, pictures, found, cells)
    if as_json:
        print(json_text(as_items(found, cells)))
    else:
        print_tables([cell_table(found, cells)])
        if out is not None:
            print(f"wrote {out}: {', '.join(sorted(path.name for path in out.iterdir()))}")
    if not found.paths:
        read = found.pictures - found.damaged
        print(
            f"{name}: no cell swims in this film: {read} pictures read, {found.seconds:.3g} s, "
            f"contrast {found.contrast:.0f} grey levels, {found.um_px:.3g} um/px",
            file=sys.stderr,
        )
    return Exit.DONE if found.paths else Exit.FAILED


def _write(
    out: Path,
    pictures: "FilmPictures",
    found: "Followed",
    cells: "Sequence[CellSummary]",
) -> None:
    """Write the tables, the log and the film with the tracks."""
    from tetractl.core.table.table_files import TableFiles
    from tetractl.film.film_files import write_log, write_overlay
    from tetractl.film.film_tables import pose_table, summary_table

    files = {"cells": out / "cells.csv", "poses": out / "poses.csv"}
    with TableFiles(files, "csv") as tables:
        tables.add("cells", summary_table(cells))
        tables.add("poses", pose_table(found))
    write_log(out / "track.mcap", pictures, found)
    write_overlay(out / "overlay.mp4", pictures, found)
