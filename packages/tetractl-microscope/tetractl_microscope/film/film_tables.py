"""The results of a film as a record of plain values, and its poses as tables."""

from collections.abc import Sequence

import numpy as np

from tetractl.tools.table.table import Column, Table
from tetractl.tools.table.table_files import plain
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.picture_now import pixels_of
from tetractl_microscope.film.fit_cell import CellSummary
from tetractl_microscope.film.follow import Followed

POSES = {"time": "s", "picture": "", "cell": "", "x": "um", "y": "um", "heading": "rad"}
POSES |= {"axis": "rad", "sure": "", "found": "", "merged": ""}
"""Columns of the table of poses, with their units."""
LISTED = 5  # most meetings with an uncertain end that are listed one by one
TRACKS = ("id", "t", "y", "x", "frame", "particle", "sure", "found")


def notes(followed: Followed, cells: Sequence[CellSummary]) -> list[str]:
    """Return remarks on how well the cells of a film were followed, one line each."""
    width, height = followed.size
    look = "bright on dark" if followed.bright else "dark on bright"
    lines = [
        f"{followed.pictures} pictures of {width} x {height} px at {followed.rate_hz:g} Hz, "
        f"{followed.um_px:.3g} um/px; cells {look}, contrast {followed.contrast:.0f} grey levels, "
        f"noise {followed.noise:.1f}",
        *followed.remarks,
    ]
    if followed.paths:
        lines.append(
            f"a number lasts {followed.number_lasts_s:.1f} s, and a track, which may have several "
            f"in turn, {followed.track_lasts_s:.1f} s (medians)"
        )
    if followed.damaged:
        lines.append(
            f"warning: {followed.damaged} pictures could not be read, or are not as large as most"
        )
    for names in followed.doubtful[:LISTED]:
        who = f"cells {', '.join(map(str, names))} met"
        if len(names) == 1:
            who = f"cell {names[0]} met others"
        lines.append(f"warning: {who} and cannot be distinguished afterwards")
    more = len(followed.doubtful) - LISTED
    if more > 0:
        lines.append(f"warning: {more} more meetings ended as uncertain; --json lists all")
    if any(cell.speed_um_s is None for cell in cells):
        lines.append("Cells seen for less than 2 s have no speed.")
    return lines


def as_items(
    film: str,
    followed: Followed,
    cells: Sequence[CellSummary],
    field: FieldRecord | None = None,
) -> dict:
    """Return the record of the film with this name: the JSON object of --json, which its log
    holds, too.

    `field` lists x and y of the field from each of its times [s] on, None without a field.
    """
    record = {
        "film": film,
        "pictures": followed.pictures,
        "damaged": followed.damaged,
        "rate_hz": followed.rate_hz,
        "um_per_px": followed.um_px,
        "organism": followed.organism.name,
        "width": followed.size[0],
        "height": followed.size[1],
        "bright": followed.bright,
        "contrast": followed.contrast,
        "noise": followed.noise,
        "cells": [cell.items() for cell in cells],
        "indistinguishable": followed.doubtful,
        "number_lasts_s": followed.number_lasts_s,
        "track_lasts_s": followed.track_lasts_s,
        "notes": notes(followed, cells),
        "field": field and field.items(),
    }
    return plain(record)


def pose_tables(followed: Followed) -> tuple[Table, Table]:
    """Return the data tables with one row per cell and picture: `poses` in um, y upwards, and
    `tracks` in pixels, y downwards.

    In `tracks` the first four columns are those of napari's tracks, and `particle`, `frame`, `y`
    and `x` are trackpy's; `sure` and `found` are those of `poses`; (0, 0) is the
    middle of the upper left pixel.
    """
    rows = sorted(
        (
            *(picture, path.identity, time, cell.x, cell.y, cell.heading, cell.axis),
            *(cell.sure, cell.has_blob, cell.merged),
        )
        for path in followed.paths
        for time, picture, cell in path.pictures()
    )
    picture, cell, time, *states = zip(*rows, strict=True) if rows else [()] * 10
    sure = states[4]
    has_blob = states[5]
    places = np.transpose(states[:2]).reshape(-1, 2)
    x, y = pixels_of(places, followed.um_px, followed.size[1]).T.tolist()
    pose_columns = tuple(map(Column, POSES, (time, picture, cell, *states), POSES.values()))
    track_columns = tuple(map(Column, TRACKS, (cell, picture, y, x, picture, cell, sure, has_blob)))
    return Table("Poses", pose_columns), Table("Tracks", track_columns)
