"""`tetractl track`: follows the cells of a film."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, option, out_option, switch
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.tools.table.table_files import table_files

if TYPE_CHECKING:
    from tetractl.replay.identification.sent_directions import DirectionReading
    from tetractl_microscope.cells.field_record import FieldRecord
    from tetractl_microscope.film.who import CellPath
    from tetractl_microscope.organisms import Organism

TABLES = (".csv", ".tsv", ".txt", ".geff", ".zarr")
"""Endings of the names of tables and graphs of tracks."""


def track(
    film: Annotated[
        Path,
        argument(
            "FILM",
            "A film, a TIFF stack or a folder of pictures; or tracks of another program.",
        ),
    ],
    field: Annotated[
        Path | None,
        option(
            "CSV",
            "CSV file of the field's direction over time, with columns time_s and direction_rad.",
        ),
    ] = None,
    scale: Annotated[
        float | None,
        option(
            "UM",
            "Micrometres per pixel; by default as the film states it.",
            min=0.05,
            max=100,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        option(
            "HZ",
            "Pictures per second, if the rate that the film states is wrong or missing.",
            min=0.1,
            max=2000,
        ),
    ] = None,
    organism: Annotated[
        str | None,
        option(
            "NAME",
            "What swims: one that `tetractl kinds` lists, whose sizes and speeds are searched "
            "for; by default tetrahymena.",
        ),
    ] = None,
    y_down: Annotated[
        bool, switch("Directions in the --field file run clockwise.", "--y-down")
    ] = False,
    out: Annotated[
        Path | None,
        out_option("DIR", "Folder for the tables, figures, and the film with the tracks drawn in."),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Follow the cells of a film, and print speed, path and sway of each with 95 % intervals.

    Of tracks of another program, in GEFF or in a CSV file with the columns of TrackMate, napari,
    trackpy (particle or track_id, frame or t, y and x in pixels), MTrackJ, Manual Tracking or
    Imaris, it prints the same of each cell; -o names the folder of cells.csv.

    If the field's direction over time is given, it also prints each cell's turning rate a, heading
    bias and whether it has a magnet. Nothing is steered. Exits with 1 if no cell swims in the film.

    Example: tetractl track dish.avi --field field.csv --scale 2.3 -o tracks

    Example: tetractl track tracks.csv --field field.csv --scale 2.3 --rate 30
    """
    from tetractl.replay.identification.sent_directions import other_readings
    from tetractl_microscope.film.field_file import clock_remarks, read_field
    from tetractl_microscope.film.film_tables import as_items
    from tetractl_microscope.film.fit_cell import fit_cells
    from tetractl_microscope.film.follow import follow
    from tetractl_microscope.film.pictures import open_film
    from tetractl_microscope.film_files import write_results
    from tetractl_microscope.organisms import named
    from tetractl_microscope.results.cell_tables import cell_tables

    if y_down and field is None:
        raise UsageError("--y-down needs --field")
    kind = None if organism is None else named(organism)
    ui.refuse_filled(out)
    directions = None if field is None else read_field(field, y_down)
    if film.suffix.lower() in TABLES:
        return _show_tracks(film, field, directions, scale, rate, kind, out, as_json)
    pictures = open_film(film, rate, scale)
    ui.tell(*(f"{film}: {remark}" for remark in pictures.remarks))
    if pictures.um_px is None:
        raise UsageError(f"{film}: states no scale", "give --scale UM_PER_PIXEL")
    with ui.progress("Following") as on_picture:
        followed = follow(
            pictures, pictures.um_px, directions, kind, lambda number: on_picture(number, None)
        )
    if directions is not None and field is not None:
        first_s = pictures.seconds(0)
        last_s = pictures.seconds(followed.pictures - 1)
        ui.tell(*clock_remarks(directions, str(field), str(film), first_s, last_s))
        readings = other_readings(str(field), directions, 1 / pictures.rate_hz, "cells")
        of_sides = _side_remarks(str(field), directions, followed.paths, readings)
        followed = replace(followed, remarks=(*followed.remarks, *of_sides))
    with ui.progress("Fitting"):
        followed, cells = fit_cells(followed, directions)
    record = as_items(film.name, followed, cells, directions)
    if out is not None:
        with ui.progress("Writing"):
            write_results(out, pictures, followed, record)
    ui.show(as_json, record, cell_tables(record))
    if out is not None and not as_json:
        files = sorted(path.name for path in out.iterdir())
        print(f"wrote {out}: {', '.join(files)}")
    if not followed.paths:
        read = followed.pictures - followed.damaged
        ui.tell(
            f"{film}: no cell swims in this film: {read} pictures read, {followed.seconds:.3g} s, "
            f"contrast {followed.contrast:.0f} grey levels, {followed.um_px:.3g} um/px"
        )
    return Exit.DONE if followed.paths else Exit.FAILED


def _side_remarks(
    source: str,
    directions: "FieldRecord",
    cells: "Sequence[CellPath]",
    readings: "Sequence[DirectionReading]",
) -> tuple[str, ...]:
    """Return a warning if cells turn as if the field's directions were of the other sense, or
    rotated; UsageError if they turn by another of the readings of these.
    """
    import numpy as np

    from tetractl.replay.identification.sent_directions import AT_ONCE_S, check_directions, courses
    from tetractl_microscope.film.field_file import side_remarks

    paths = [np.column_stack([cell.times, cell.places]) for cell in cells]
    check_directions(source, courses(paths), directions, AT_ONCE_S, readings)
    return side_remarks(directions, paths)


def _show_tracks(
    source: Path,
    field: Path | None,
    directions: "FieldRecord | None",
    scale: float | None,
    rate: float | None,
    kind: "Organism | None",
    out: Path | None,
    as_json: bool,
) -> int:
    """Print the cells of the tracks of another program, and write their tables into `out`."""
    from tetractl.replay.identification.sent_directions import image, other_readings
    from tetractl_microscope.film.field_file import clock_remarks
    from tetractl_microscope.foreign_tracks import spot_tracks
    from tetractl_microscope.results.cell_tables import cell_data, cell_tables
    from tetractl_microscope.track_cells import (
        organism_by_speed,
        stage_remarks,
        swimming_tracks,
        track_record,
    )

    remarks: list[str] = []
    tracks = spot_tracks(source, scale, rate, remarks)
    ui.tell(*remarks)
    cells = swimming_tracks(source, tracks, directions is not None)
    ui.tell(*cells.remarks)
    if directions is not None and field is not None:
        times = cells.timing.stated or [0.0]
        ui.tell(*clock_remarks(directions, str(field), str(source), times[0], times[-1]))
        readings = other_readings(str(field), directions, 1 / cells.timing.rate_hz, "cells")
        readings.append(image(str(source), str(field), directions, "cells"))
        ui.tell(*_side_remarks(str(field), directions, cells.paths, readings))
    together = stage_remarks(cells.paths, directions)
    ui.tell(*together)
    organism = organism_by_speed(cells.paths) if kind is None else kind
    with ui.progress("Fitting"):
        record = track_record(source, cells, organism, None if together else directions)
    ui.show(as_json, record, cell_tables(record))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        with table_files({"cells": out / "cells.csv"}) as add:
            add("cells", cell_data(record), "")
        ui.tell(printable(f"wrote {out}: cells.csv"))
    return Exit.DONE
