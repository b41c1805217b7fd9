"""Reads tracks of other programs: the tables of napari, trackpy, TrackMate, MTrackJ, ImageJ's
Manual Tracking and Imaris.

`spot_tracks` returns each track as rows of time [s], x and y [um], y upwards. A table states
pictures and pixels, y downwards, or else seconds and a unit of length: what the header of a column
says, such as `x [um]`. Pictures need a rate, and pixels a scale.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Floats
from tetractl.replay.identification.csv_tracks import COLUMNS_SAID
from tetractl.tools.table.csv_rows import is_number, read_csv
from tetractl.tools.table.quantities import (
    SECONDS,
    TIME_MAX,
    TIME_NAMES,
    NumberColumn,
    factor,
    name_and_unit,
)

SPARSE = 10
"""Least common step of the numbers of all pictures that is said: times in ms have such a one."""
MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6, "inch": 25400.0}
"""Units of lengths [um]."""
PIXELS = ("", "px", "pixel", "pixels")
"""Units of places that need a scale."""


def _is_count(unit: str) -> bool:
    return unit == ""


def _is_time(unit: str) -> bool:
    return factor(unit, SECONDS) is not None


def _is_place(unit: str) -> bool:
    return unit in PIXELS or factor(unit, MICROMETRES) is not None


COLUMNS = {
    "track": (
        ("particle", "track_id", "trackid", "track", "tid", "track_n°", "trajectory", "id"),
        _is_count,
    ),
    "frame": (("frame", "slice_n°", "slice", "t", "time"), _is_count),
    "time": ((*TIME_NAMES, "position_t"), _is_time),
    "x": (("x", "position_x"), _is_place),
    "y": (("y", "position_y"), _is_place),
}
"""The names of each column in the tables of other programs, before its unit, and which units it may
have; the first name that a table has counts: spots have an id of their own, too."""
WORDS_BELOW = "position_x"
"""Where TrackMate's tables have rows of words below the header, of which the last states units."""


FROM_ONE = "pictures are numbered from 1: that is taken as the first of the film, at 0 s"


@dataclass(frozen=True, slots=True)
class SpotTable:
    """Spots of tracks: rows (R, 4) of track, picture or time, x and y, downwards. Times are in
    `seconds` [s], and x in `um` [um], None if they are pictures and pixels; 1 along y is `tall`
    times as long as along x.
    """

    rows: Floats
    um: float | None = None
    seconds: float | None = None
    tall: float = 1.0


@dataclass(frozen=True, slots=True)
class SpotTrack:
    """A track of another program: rows (K, 3) of time [s], x and y [um], y upwards, in order."""

    number: float
    rows: Floats


def spot_tracks(
    path: Path, um_px: float | None, rate_hz: float | None, remarks: list[str]
) -> list[SpotTrack]:
    """Return the tracks in a table of another program; add what is to be said of them.

    These are given in pixels, y downwards, and pictures, so that they need a scale `um_px` and a
    rate, unless the table states them.
    """
    spots = _spot_table(path, rate_hz, remarks)
    return _scaled_tracks(path, spots, um_px, rate_hz)


def _spot_table(path: Path, rate_hz: float | None, remarks: list[str]) -> SpotTable:
    """Return the spots of tracks in a table; UsageError if a column of it is missing.

    Their times are those of a column with a unit of time, or else the numbers of pictures from the
    first one on, which a rate that is given makes of any table.
    """
    rows = read_csv(path)
    first = next(rows, None)
    if first is None:
        raise UsageError(f"{path}: has no rows")
    quantities = {header: _name_and_unit(header) for header in first.cells}
    words = [header for header, (name, _) in quantities.items() if name == WORDS_BELOW]
    while first and words and not is_number(first.cells[words[0]]):
        for header, text in first.cells.items():
            unit = text.strip("()") if text.startswith("(") else ""
            quantities[header] = quantities[header][0], unit
        first = next(rows, None)
    headers = {what: _column(quantities, *COLUMNS[what]) for what in COLUMNS}
    _require_columns(path, headers, list(quantities))
    units = {what: quantities[header][1] for what, header in headers.items() if header}
    columns = {what: NumberColumn(headers[what]) for what in units}
    if "time" in units:
        second = factor(units["time"], SECONDS) or 1.0
        columns["time"] = NumberColumn(headers["time"], second, TIME_MAX)
    numbers = list[float]()
    for row in chain([first] if first else [], rows):
        if not math.isnan(columns["track"].optional(path, row)):  # else a spot of no track
            numbers += [column.number(path, row) for column in columns.values()]
    if not numbers:
        raise UsageError(f"{path}: has no spot of a track")
    table = np.reshape(numbers, (-1, len(columns)))
    values = dict(zip(columns, table.T, strict=True))
    frames = values.get("frame")
    times = values.get("time")
    if frames is not None and times is None:
        _require_whole(path, headers["frame"], frames)
        _note_sparse(path, headers["frame"], frames, remarks)
    if frames is not None and (times is None or rate_hz is not None):
        frames = _from_first_picture(path, frames, remarks)
    um_across = factor(units["x"], MICROMETRES)
    um_up = factor(units["y"], MICROMETRES)
    spots = SpotTable(
        np.column_stack(
            [
                values["track"],
                values["time"] if frames is None else frames,
                values["x"],
                values["y"],
            ]
        ),
        um=um_across,
        seconds=1.0 if frames is None else None,
        tall=um_up / um_across if um_across and um_up else 1.0,
    )
    if frames is None or times is None:
        return spots
    return _timed(path, spots, times, rate_hz, remarks)


def _name_and_unit(header: str) -> tuple[str, str]:
    """Return the name of a column, with _ for a blank, and its unit, "" if it states none."""
    name, unit = name_and_unit(header)
    for pixels in PIXELS[1:]:
        if not unit and name.endswith(f"_{pixels}"):
            return name.removesuffix(f"_{pixels}"), pixels
    return name, unit


def _column(
    quantities: Mapping[str, tuple[str, str]], names: Sequence[str], fits: Callable[[str], bool]
) -> str:
    """Return the column with the first of some names that one with a unit that fits has; "" if none
    has one."""
    for wanted in names:
        for header, (name, unit) in quantities.items():
            if name == wanted and fits(unit):
                return header
    return ""


def _require_columns(path: Path, headers: Mapping[str, str], listed: Sequence[str]) -> None:
    """Raise UsageError if a table of the `listed` columns lacks one of tracks."""
    missing = list[str]()
    if not headers["track"]:
        missing.append("particle, track_id or id")
    if not headers["frame"] and not headers["time"]:
        missing.append("frame, t or time_s")
    missing += [axis for axis in ("x", "y") if not headers[axis]]
    if missing:
        listed = ", ".join(printable(header) for header in listed[:COLUMNS_SAID])
        said = (
            f"{path}: no column of tracks: {'; '.join(missing)} missing; its columns are {listed}"
        )
        raise UsageError(said, "tracks have the columns particle, frame, x, y, in the first line")


def _require_whole(path: Path, column: str, frames: Floats) -> None:
    """Raise UsageError if numbers of pictures are fractions, or below 0."""
    is_fraction = frames % 1 != 0
    if is_fraction.any():
        first = frames[is_fraction][0]
        said = f"{path}: column {printable(column)}: {first:g} is no number of a picture"
        raise UsageError(said, f"of times in seconds, name the column {printable(column)}_s")
    if frames.min() < 0:
        said = f"{path}: column {printable(column)}: {frames.min():g} is no number of a picture"
        raise UsageError(said, "the film's first picture is number 0")


def _from_first_picture(path: Path, frames: Floats, remarks: list[str]) -> Floats:
    """Return the numbers of pictures from 0 on, as the first is taken at time 0. Programs that
    count from 0 hardly ever find nothing in that picture: a table without 0 counts from 1.
    """
    if frames.min() != 1:
        return frames
    remarks.append(f"warning: {path}: {FROM_ONE}")
    return frames - 1


def _note_sparse(path: Path, column: str, frames: Floats, remarks: list[str]) -> None:
    """Say if all numbers of pictures are multiples of one that is large."""
    step = int(np.gcd.reduce((frames - frames.min()).astype(np.int64)))
    if step >= SPARSE:
        name = printable(column)
        remarks.append(
            f"warning: {path}: column {name} counts in steps of {step}: if these are milliseconds, "
            f"name it {name}_ms"
        )


def _timed(
    path: Path, counted: SpotTable, times: Floats, rate_hz: float | None, remarks: list[str]
) -> SpotTable:
    """Return spots at the times (R,) [s] that their table states, or in pictures if a rate is
    given, and say if these differ."""
    rows = counted.rows
    if rate_hz is None:
        timed = np.column_stack([rows[:, 0], times, rows[:, 2:]])
        return replace(counted, rows=timed, seconds=1.0)
    off = (times - times[0]) - (rows[:, 1] - rows[0, 1]) / rate_hz
    most = float(np.abs(off).max())
    if most > 0.5 / rate_hz:
        remarks.append(
            f"warning: {path}: --rate {rate_hz:g} replaces its times, up to {most:.3g} s off"
        )
    return counted


def _scaled_tracks(
    path: Path, spots: SpotTable, um_px: float | None, rate_hz: float | None
) -> list[SpotTrack]:
    """Return the tracks of spots in seconds and micrometres."""
    um = _size(path, "--scale", "its places are in a unit of length", um_px, spots.um)
    period = None if rate_hz is None else 1 / rate_hz
    seconds = _size(path, "--rate", "it states times", period, spots.seconds)
    missing = list[str]()
    if um is None:
        missing.append("a unit of length")
    if seconds is None:
        missing.append("the time of a picture")
    if um is None or seconds is None:
        said = f"{path}: its tracks do not state {' and '.join(missing)}"
        raise UsageError(said, "give --scale UM_PER_PIXEL and --rate PICTURES_PER_SECOND")
    if not np.isfinite(spots.rows).all():
        raise UsageError(f"{path}: has a value that is not finite")
    tracks = list[SpotTrack]()
    for number in np.unique(spots.rows[:, 0]).tolist():
        is_on_track = spots.rows[:, 0] == number
        track = np.unique(spots.rows[is_on_track, 1:], axis=0)  # by time; a row twice counts once
        rows = track * (seconds, um, -spots.tall * um)
        _require_one_place(path, number, rows[:, 0])
        tracks.append(SpotTrack(number, rows))
    return tracks


def _require_one_place(path: Path, number: float, times: Floats) -> None:
    """Raise UsageError if a track is at two places at one time (K,) [s]."""
    is_twice = np.diff(times) == 0
    if is_twice.any():
        when = times[:-1][is_twice][0]
        raise UsageError(
            f"{path}: cell {number:g} is at two places at {when:.6g} s",
            "are these several tracks, or times that are rounded?",
        )


def _size(
    path: Path, option: str, states: str, given: float | None, stated: float | None
) -> float | None:
    """Return what 1 stands for: as an option gives it, or else as the table states it; UsageError
    for both."""
    if given is not None and stated is not None:
        said = f"{path}: {states}, so that {option} has no meaning"
        raise UsageError(said, f"leave out {option}")
    return stated if given is None else given
