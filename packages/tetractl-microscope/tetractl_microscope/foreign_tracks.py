"""Tracks of other programs: the tables of napari, trackpy, TrackMate, MTrackJ, ImageJ's Manual
Tracking and Imaris, and GEFF graphs.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tetractl.core.errors import AbortError, UsageError, printable
from tetractl.core.poses import Floats
from tetractl.replay.identification.csv_tracks import COLUMNS_SAID, POSES_MAX
from tetractl.tools.table.csv_rows import columns_of, is_number, read_csv
from tetractl.tools.table.quantities import (
    SECONDS,
    TIME_MAX,
    TIME_NAMES,
    NumberColumn,
    factor,
    name_and_unit,
)
from tetractl_microscope.number_columns import read_numbers

NUMBERS = ("particle", "track_id", "trackid", "track", "tid", "track_n°", "trajectory", "id")
"""Names of the column of a track's number, with _ for a blank; the first that a table has counts:
spots have an id of their own, too."""
FRAMES = ("frame", "slice_n°", "slice", "t", "time")
"""Names of the column of the numbers of pictures."""
PLACES = (("x", "position_x"), ("y", "position_y"))
"""Names of the columns of places, before their units."""
PIXELS = ("", "px", "pixel", "pixels")
"""Units of places that need a scale."""
AXES = (("t", "time", "frame"), ("x",), ("y",))
"""Names of the axes of a graph of which no types are stated."""
SPARSE = 10
"""Least common step of the numbers of all pictures that is said: times in ms have such a one."""
SAID_MAX = 200
"""Most characters of an error of the library geff that are shown."""
TRACKMATE = ("track_id", "position_x", "position_y", "frame")
"""Columns of a table of TrackMate's spots, below whose header stand their names in words, twice,
and units; `position_t` has times."""


MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6, "inch": 25400.0}
"""Units of lengths [um]."""


@dataclass(frozen=True, slots=True)
class AxisStep:
    """What 1 stands for along an axis: its `size` [um or s], None if it is not stated. If numbers
    are `counted`, they are pixels or pictures, whose size an option may state instead."""

    size: float | None = None
    counted: bool = True


FROM_ONE = "pictures are numbered from 1: that is taken as the first of the film, at 0 s"


@dataclass(frozen=True, slots=True)
class SpotTable:
    """Spots of tracks: rows (R, 4) of track, picture or time, x and y, downwards; what 1 stands for
    in `time` and along x, `across`; along y it is `tall` times as long.
    """

    rows: Floats
    across: AxisStep = AxisStep()
    time: AxisStep = AxisStep()
    tall: float = 1.0


@dataclass(frozen=True, slots=True)
class SpotTrack:
    """A track of another program: rows (K, 3) of time [s], x and y [um], y upwards, in order."""

    number: float
    rows: Floats


def spot_tracks(
    path: Path, um_px: float | None, rate_hz: float | None, remarks: list[str]
) -> list[SpotTrack]:
    """Return the tracks in a table or graph of another program; add what is to be said of them.

    These are given in pixels, y downwards, and pictures, so that they need a scale `um_px` and a
    rate, unless the table states them.
    """
    spots = _graph(path) if path.is_dir() else _spot_table(path, rate_hz, remarks)
    return _scaled_tracks(path, spots, um_px, rate_hz)


def _spot_table(path: Path, rate_hz: float | None, remarks: list[str]) -> SpotTable:
    """Return the spots of a table of tracks; UsageError if a column of it is missing.

    Their times are those of a column with a unit of time, or else the numbers of pictures from the
    first one on, which a rate that is given makes of any table.
    """
    headers = columns_of(path)
    if not headers:
        raise UsageError(f"{path}: has no rows")
    names = {name.lower(): name for name in headers}
    if set(TRACKMATE) <= set(names):
        return _trackmate(path, names, rate_hz, remarks)
    by_name = {name.lower().replace(" ", "_"): name for name in headers}
    number = next((by_name[name] for name in NUMBERS if name in by_name), "")
    frame = next((by_name[name] for name in FRAMES if name in by_name), "")
    timed = next((header for header in headers if _is_time(header)), "")
    places = [_place_column(headers, axis_names) for axis_names in PLACES]
    missing = list[str]()
    if not number:
        missing.append("particle, track_id or id")
    if not frame and not timed:
        missing.append("frame, t or time_s")
    missing += [
        axis_names[0] for axis_names, place in zip(PLACES, places, strict=True) if not place
    ]
    if missing:
        has = ", ".join(printable(header) for header in headers[:COLUMNS_SAID])
        said = f"{path}: no column of tracks: {'; '.join(missing)} missing; its columns are {has}"
        raise UsageError(said, "tracks have the columns particle, frame, x, y, in the first line")
    um_across, um_up = (factor(_place_and_unit(place)[1], MICROMETRES) for place in places)
    tracks, x, y = read_numbers(path, (number, *places)).T
    across = AxisStep(um_across, um_across is None)
    tall = um_up / um_across if um_across and um_up else 1.0
    if not timed:
        frames = read_numbers(path, (frame,))[:, 0]
        _require_whole(path, frame, frames)
        frames = _from_first_picture(path, frames, remarks)
        _note_sparse(path, frame, frames, remarks)
        return SpotTable(np.column_stack([tracks, frames, x, y]), across, tall=tall)
    column = NumberColumn(timed, SECONDS[name_and_unit(timed)[1]], TIME_MAX)
    times = np.array([column.number(path, row) for row in read_csv(path)])
    if not frame:
        rows = np.column_stack([tracks, times, x, y])
        return SpotTable(rows, across, AxisStep(1.0, False), tall)
    frames = read_numbers(path, (frame,))[:, 0]
    if rate_hz is not None:
        frames = _from_first_picture(path, frames, remarks)
    counted = SpotTable(np.column_stack([tracks, frames, x, y]), across, tall=tall)
    return _timed(path, counted, times, rate_hz, remarks)


def _place_column(headers: Sequence[str], names: Sequence[str]) -> str:
    """Return the column of places with one of some names, "" if there is none."""
    for header in headers:
        name, unit = _place_and_unit(header)
        if name in names and (unit in PIXELS or factor(unit, MICROMETRES) is not None):
            return header
    return ""


def _place_and_unit(header: str) -> tuple[str, str]:
    """Return the name of a column of places and its unit, "" if it states none."""
    name, unit = name_and_unit(header)
    for pixels in PIXELS[1:]:
        if not unit and name.endswith(f"_{pixels}"):
            return name.removesuffix(f"_{pixels}"), pixels
    return name, unit


def _is_time(header: str) -> bool:
    name, unit = name_and_unit(header)
    return name in TIME_NAMES and unit in SECONDS


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
        return replace(counted, rows=timed, time=AxisStep(1.0, False))
    off = (times - times[0]) - (rows[:, 1] - rows[0, 1]) / rate_hz
    most = float(np.abs(off).max())
    if most > 0.5 / rate_hz:
        remarks.append(
            f"warning: {path}: --rate {rate_hz:g} replaces its times, up to {most:.3g} s off"
        )
    return counted


def _trackmate(
    path: Path, names: Mapping[str, str], rate_hz: float | None, remarks: list[str]
) -> SpotTable:
    """Return the spots of a table of TrackMate that belong to tracks.

    The rows below the header that name columns and units have no number in the frame's column.
    """
    track, x, y, frame = (NumberColumn(names[name]) for name in TRACKMATE)
    timed = NumberColumn(names.get("position_t", frame.key))
    units: dict[str, str] = {}
    rows: list[list[float]] = []
    for row in read_csv(path):
        if not is_number(row.cells[frame.key]):
            units = {key: text.strip("()") for key, text in row.cells.items()}
        elif not math.isnan(track.optional(path, row)):  # else a spot of no track
            columns = (track, frame, timed, x, y)
            rows.append([column.number(path, row) for column in columns])
    if not rows:
        raise UsageError(f"{path}: has no spot of a track")
    tracks, frames, times, *places = np.array(rows).T
    seconds = factor(units.get(timed.key, ""), SECONDS)
    um = factor(units.get(x.key, ""), MICROMETRES)
    spots = SpotTable(np.column_stack([tracks, frames, *places]), AxisStep(um, um is None))
    return spots if seconds is None else _timed(path, spots, times * seconds, rate_hz, remarks)


def _scaled_tracks(
    path: Path, spots: SpotTable, um_px: float | None, rate_hz: float | None
) -> list[SpotTrack]:
    """Return the tracks of spots in seconds and micrometres."""
    um = _size(path, "--scale", "its places are in a unit of length", um_px, spots.across)
    period = None if rate_hz is None else 1 / rate_hz
    seconds = _size(path, "--rate", "it states times", period, spots.time)
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
    path: Path, option: str, states: str, stated: float | None, step: AxisStep
) -> float | None:
    """Return what 1 stands for: as an option states it, or else the table; UsageError for an option
    if nothing is counted."""
    if stated is None:
        return step.size
    if not step.counted:
        said = f"{path}: {states}, so that {option} has no meaning"
        raise UsageError(said, f"leave out {option}")
    return stated


def _graph(path: Path) -> SpotTable:
    """Return the spots of a GEFF graph, by the types of its axes.

    A track begins where a node has no predecessor, or one with several successors.
    """
    try:
        from geff.core_io import read_to_memory
    except ModuleNotFoundError as error:
        said = f"{path}: is a folder, and GEFF graphs are read by geff, which is not installed"
        raise AbortError(said, "pip install './packages/tetractl-microscope[geff]'") from error
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    try:
        graph: Mapping[str, Any] = read_to_memory(path)
        properties = graph["node_props"]
        axes = _axes(graph["metadata"].axes or (), properties)
        nodes = [properties[axis.name]["values"].astype(float) for axis in axes]
    except Exception as error:  # geff and zarr do not document what they raise
        version = _geff_version(path)
        if version.startswith("0."):
            raise UsageError(
                f"{path}: is in GEFF {printable(version, SAID_MAX)}, older than the format's first "
                "release, and geff does not read it",
                "write it again with a newer version of the program that wrote it, or as CSV",
            ) from error
        raise UsageError(
            f"{path}: cannot be read as a GEFF graph of t, x, y: {_said(error)}",
            "write it again with the program that made it, or as CSV",
        ) from error
    ids = graph["node_ids"]
    edges = graph["edge_ids"]
    if len(ids) > POSES_MAX:
        raise UsageError(f"{path}: has {len(ids)} nodes; at most {POSES_MAX} are read")
    if not len(edges):
        raise UsageError(f"{path}: has no edges, and so no tracks")
    order = np.argsort(ids)
    first, last = order[np.searchsorted(ids, edges, sorter=order)].T
    single = np.bincount(first, minlength=len(ids))[first] == 1
    ends = (first[single], last[single])
    count = len(ids)
    links = coo_array((np.ones(single.sum()), ends), (count, count))
    _, track = connected_components(links, directed=False)
    time, x, y = axes
    across = _step(x, MICROMETRES)
    down = _step(y, MICROMETRES)
    tall = down.size / across.size if across.size and down.size else 1.0
    return SpotTable(np.column_stack([track + 1, *nodes]), across, _step(time, SECONDS), tall)


def _said(error: Exception) -> str:
    """Return what is wrong with a graph, of a library's many lines what says so."""
    problems: Any = getattr(error, "errors", None)  # pydantic's, each with its place and a text
    if callable(problems):
        first: Any = problems(include_url=False)[0]  # pyright: ignore[reportIndexIssue]
        place = ".".join(map(str, first["loc"]))
        return printable(f"{place}: {first['msg']}" if place else str(first["msg"]), SAID_MAX)
    return printable(" ".join(f"{type(error).__name__}: {error}".split()), SAID_MAX)


def _geff_version(path: Path) -> str:
    """Return the version of the format that a graph states, "" if it states none."""
    import zarr

    try:
        attributes = zarr.open_group(path, mode="r").attrs.asdict()
    except Exception:  # zarr does not document what it raises
        return ""
    stated: Any = attributes.get("geff", attributes)
    return str(stated.get("geff_version", "")) if isinstance(stated, Mapping) else ""


def _axes(stated: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """Return the axes of time, x and y, by the types that the metadata state, or else by the names
    of axes or, without any, of properties: t or time, x and y.

    In space, x and y are those whose names end so, or else the last two: a picture's are y, x.
    """
    times = [axis for axis in stated if axis.type == "time"]
    places = [axis for axis in stated if axis.type == "space"]
    if times and len(places) >= 2:
        ends = {axis.name.lower()[-1:]: axis for axis in places}
        *_, y, x = places
        return [times[0], ends["x"], ends["y"]] if {"x", "y"} <= set(ends) else [times[0], x, y]
    named_axes = [*stated] or [
        SimpleNamespace(name=name, unit="", scale=None, scaled_unit="") for name in names
    ]
    by_name = {axis.name.lower(): axis for axis in named_axes}
    by_place = [_first_of(by_name, names_of_place) for names_of_place in AXES]
    if None in by_place:
        said = ", ".join(axis.name for axis in named_axes)
        raise ValueError(f"no axis has a type, and their names are {said}")
    return by_place


def _first_of(by_name: Mapping[str, Any], names: Iterable[str]) -> Any:
    """Return the axis with the first of some names that one has; None if none has one."""
    return next((by_name[name] for name in names if name in by_name), None)


def _step(axis: Any, units: Mapping[str, float]) -> AxisStep:
    """Return what 1 stands for along an axis, in one of some units."""
    scaled = factor(axis.scaled_unit or "", units)
    if scaled is not None and axis.scale:
        return AxisStep(axis.scale * scaled)
    size = factor(axis.unit or "", units)
    return AxisStep(size, size is None)
