"""`tetractl track`: estimates speeds and responses of the cells on another program's tracks."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, option, out_option, switch
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.tools.table.table_files import open_table_files

FILMS = (".avi", ".mp4", ".mov", ".mkv", ".m4v", ".wmv", ".tif", ".tiff", ".nd2", ".czi", ".gif")
"""Endings of the names of films, which are given to a tracking program first."""


def track(
    tracks: Annotated[
        Path,
        argument("TRACKS", "Tracks from another program: a CSV file or a GEFF graph."),
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
            "Micrometres per pixel, if the tracks do not state this scale.",
            min=0.05,
            max=100,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        option(
            "HZ",
            "Images per second, if the tracks have no times.",
            min=0.1,
            max=2000,
        ),
    ] = None,
    organism: Annotated[
        str | None,
        option(
            "NAME",
            "The organism in the recording, by its name in `tetractl kinds`. By default, the one "
            "whose speed is closest to that of the cells.",
        ),
    ] = None,
    y_down: Annotated[
        bool, switch("Directions in the --field file run clockwise.", "--y-down")
    ] = False,
    out: Annotated[Path | None, out_option("DIR", "Folder for cells.csv.")] = None,
    as_json: AsJson = False,
) -> int:
    """Estimate each cell's speed and response from the tracks of another program.

    The tracks are a CSV file with the columns of trackpy (particle, frame, y and x in pixels),
    TrackMate, napari, MTrackJ, Manual Tracking or Imaris, or a GEFF graph. The table that is
    printed has the speed, helix and straight-line velocity of each cell, with 95 % intervals.

    With the field's direction over time, it also has each cell's turning rate a, its heading bias,
    and whether it has a magnet. Exits with 1 if nothing swims.

    Example: tetractl track tracks.csv --scale 2.3 --rate 30

    Example: tetractl track tracks.csv --field field.csv --scale 2.3 --rate 30 -o cells
    """
    from tetractl_microscope.organisms import named
    from tetractl_microscope.sent_directions import (
        SHORT_DELAYS_S,
        check_directions,
        courses,
        mirror_reading,
        other_readings,
    )
    from tetractl_microscope.tracks.cell_tables import cell_data, cell_tables
    from tetractl_microscope.tracks.field_file import clock_remarks, read_field, side_remarks
    from tetractl_microscope.tracks.foreign_tracks import spot_tracks
    from tetractl_microscope.tracks.swimming_tracks import (
        organism_by_speed,
        stage_remarks,
        swimming_tracks,
        track_record,
    )

    if y_down and field is None:
        raise UsageError("--y-down needs --field")
    if tracks.suffix.lower() in FILMS:
        raise UsageError(
            f"{tracks}: the file is a video, but this command needs tracks",
            "track the cells with trackpy or TrackMate, and give the table that it writes",
        )
    kind = None if organism is None else named(organism)
    ui.refuse_filled(out)
    directions = None if field is None else read_field(field, y_down)
    remarks: list[str] = []
    spots = spot_tracks(tracks, scale, rate, remarks)
    ui.print_messages(*remarks)
    cells = swimming_tracks(tracks, spots, directions is not None)
    ui.print_messages(*cells.remarks)
    if directions is not None and field is not None:
        ui.print_messages(*clock_remarks(directions, str(field), str(tracks), *cells.span_s))
        readings = other_readings(str(field), directions, cells.period_s, "cells")
        readings.append(mirror_reading(str(tracks), str(field), directions, "cells"))
        rows = [path.rows for path in cells.paths]
        check_directions(str(field), courses(rows), directions, SHORT_DELAYS_S, readings)
        ui.print_messages(*side_remarks(directions, rows))
    together = stage_remarks(cells.paths, directions)
    ui.print_messages(*together)
    swimmer = organism_by_speed(cells.paths) if kind is None else kind
    with ui.show_progress("Fitting"):
        record = track_record(tracks, cells, swimmer, None if together else directions)
    ui.print_results(as_json, record, cell_tables(record))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        with open_table_files({"cells": out / "cells.csv"}) as add:
            add("cells", cell_data(record), "")
        ui.print_messages(printable(f"wrote {out}: cells.csv"))
    return Exit.DONE
