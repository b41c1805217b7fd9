"""`tetractl track`: estimates speeds and responses of the cells on another program's tracks."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import AsJson, argument, option, out_option, switch
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.tools.table.table_files import open_table_files

VIDEO_SUFFIXES = (
    ".avi",
    ".mp4",
    ".mov",
    ".mkv",
    ".m4v",
    ".wmv",
    ".tif",
    ".tiff",
    ".nd2",
    ".czi",
    ".gif",
)
"""File name suffixes of videos. A tracking program must process a video first."""


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
    from tetractl_microscope.organisms import find_organism
    from tetractl_microscope.sent_directions import (
        SHORT_DELAYS_S,
        check_directions,
        compute_courses,
        create_mirror_reading,
        create_other_readings,
    )
    from tetractl_microscope.tracks.cell_tables import create_cell_tables, create_data_table
    from tetractl_microscope.tracks.field_file import (
        describe_clock_mismatches,
        describe_wrong_directions,
        read_field,
    )
    from tetractl_microscope.tracks.foreign_tracks import read_spot_tracks
    from tetractl_microscope.tracks.swimming_tracks import (
        create_track_record,
        describe_moving_stage,
        find_organism_by_speed,
        select_swimming_tracks,
    )

    if y_down and field is None:
        raise UsageError("--y-down needs --field")
    if tracks.suffix.lower() in VIDEO_SUFFIXES:
        raise UsageError(
            f"{tracks}: the file is a video, but this command needs tracks",
            "track the cells with trackpy or TrackMate, and give the table that it writes",
        )
    stated_organism = None if organism is None else find_organism(organism)
    ui.refuse_filled(out)
    directions = None if field is None else read_field(field, y_down)
    remarks: list[str] = []
    spots = read_spot_tracks(tracks, scale, rate, remarks)
    ui.print_messages(*remarks)
    cells = select_swimming_tracks(tracks, spots, directions is not None)
    ui.print_messages(*cells.remarks)
    if directions is not None and field is not None:
        ui.print_messages(
            *describe_clock_mismatches(directions, str(field), str(tracks), *cells.span_s)
        )
        readings = create_other_readings(str(field), directions, cells.period_s, "cells")
        readings.append(create_mirror_reading(str(tracks), str(field), directions, "cells"))
        path_rows = [path.rows for path in cells.paths]
        check_directions(
            str(field), compute_courses(path_rows), directions, SHORT_DELAYS_S, readings
        )
        ui.print_messages(*describe_wrong_directions(directions, path_rows))
    stage_warnings = describe_moving_stage(cells.paths, directions)
    ui.print_messages(*stage_warnings)
    chosen_organism = (
        find_organism_by_speed(cells.paths) if stated_organism is None else stated_organism
    )
    with ui.show_progress("Fitting"):
        record = create_track_record(
            tracks, cells, chosen_organism, None if stage_warnings else directions
        )
    ui.print_results(as_json, record, create_cell_tables(record))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        with open_table_files({"cells": out / "cells.csv"}) as add:
            add("cells", create_data_table(record), "")
        ui.print_messages(printable(f"wrote {out}: cells.csv"))
    return Exit.DONE
