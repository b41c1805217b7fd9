"""Reads the direction of the magnetic field over time from a CSV file, and checks it."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats
from tetractl.tools.table.csv_rows import read_column_names, read_csv
from tetractl.tools.table.quantities import (
    RADIANS,
    NumberColumn,
    create_order_error,
    find_column,
    find_time,
    refuse_degrees,
)
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.helix import Piece
from tetractl_microscope.handedness import describe_wrong_sides, find_handedness
from tetractl_microscope.one_recording import FileSpan, describe_clock_mismatch, refuse_times_apart

STRENGTH_COLUMN = "strength"
STRENGTH_MAX = 100.0  # maximum strength of a field, relative to the reference field


def describe_wrong_directions(field: FieldRecord, paths: Sequence[Floats]) -> tuple[str, ...]:
    """Describe how the directions of the field seem to be mirrored or rotated, if they do.

    The turning of the cells shows this.

    Args:
        field: The field.
        paths: For each cell, times [s] and positions x, y, shape (K, 3).

    Returns:
        The warnings. Empty if the directions are right or if too few cells were seen.
    """
    mirrored = (
        "the directions run clockwise (give --y-down), or the image is mirrored; until this is "
        "corrected, do not use the values of a, bias and magnet"
    )
    turning = find_handedness(paths, field.field_at)
    lines = [] if turning is None else describe_wrong_sides(turning, mirrored, "is it rotated?")
    return tuple(f"warning: {line}" for line in lines)


def describe_clock_mismatches(
    field: FieldRecord, source: str, tracks: str, start_s: float, end_s: float
) -> tuple[str, ...]:
    """Describe how the times of the field and of the tracks seem to come from different clocks.

    Args:
        field: The field.
        source: The file of the field.
        tracks: The file of the tracks.
        start_s: When the tracks begin [s].
        end_s: When the tracks end [s].

    Raises:
        UsageError: If the times do not overlap at all.

    Returns:
        One warning, or none.
    """
    tracks_span = FileSpan(tracks, start_s, end_s)
    field_span = FileSpan(source, float(field.times[0]), math.inf)
    # cells swim all the time
    covered = (end_s - max(start_s, field_span.begin_s)) / max(end_s - start_s, 1e-9)
    refuse_times_apart(tracks_span, field.times, field_span)
    remark = describe_clock_mismatch(tracks_span, field.times, field_span, covered)
    return () if remark is None else (f"warning: {remark}",)


def _missing_column_error(path: Path, name: str, headers: Sequence[str]) -> UsageError:
    """Create the error for a table without a required column.

    The message names the first eight columns. If there are no columns, it reports that the file has
    no rows.
    """
    if not headers:
        return UsageError(f"{path}: the file has no rows below its header")
    listed = printable(", ".join(headers[:8]))
    return UsageError(f"{path}: the column {name} is missing; the columns are {listed}")


def no_field(start_s: float, end_s: float) -> Sequence[Piece]:
    """Return the interval from `start_s` to `end_s` [s] as one piece without a field."""
    return ((end_s - start_s, 0.0, 0.0),)


def read_field(path: Path, upside_down: bool = False) -> FieldRecord:
    """Read the field over time from a CSV file.

    The file has the columns time_s and direction_rad, and optionally strength. Directions are
    anticlockwise from the image's right. Strengths are fractions of the reference field, 1 by
    default.

    Args:
        path: The file.
        upside_down: Whether directions are clockwise instead.

    Raises:
        UsageError: If a column is missing or a value is invalid.
    """
    headers = read_column_names(path)
    time_column = find_time(path, headers)
    direction_column = find_column(path, headers, ("direction",), RADIANS)
    if time_column is None or direction_column is None:
        raise _missing_column_error(
            path, "time_s" if time_column is None else "direction_rad", headers
        )
    strength_column = NumberColumn(STRENGTH_COLUMN) if STRENGTH_COLUMN in headers else None
    lines: list[int] = []
    times: list[float] = []
    angles: list[float] = []
    strengths: list[float] = []
    for row in read_csv(path):
        times.append(time_column.number(path, row))
        if len(times) > 1 and times[-1] < times[-2]:
            raise create_order_error(path, row)
        strength = 1.0 if strength_column is None else strength_column.read_optional(path, row)
        strength = 1.0 if math.isnan(strength) else strength
        if abs(strength) > STRENGTH_MAX:
            problem = f"{path}, line {row.line}: {STRENGTH_COLUMN}: {strength:g} is too large"
            raise UsageError(
                problem,
                "the strength is relative to the reference field, and can "
                f"be at most {STRENGTH_MAX:g}",
            )
        strengths.append(strength)
        angles.append(direction_column.number(path, row))
        lines.append(row.line)
    directions = np.array(angles)
    refuse_degrees(path, direction_column, lines, directions)
    if upside_down:
        directions = -directions
    return FieldRecord(np.array(times), directions, np.array(strengths))
