"""Reads tracks that other programs have written.

It reads the tables of napari, trackpy, TrackMate, MTrackJ, ImageJ's Manual Tracking and Imaris, and
GEFF graphs.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tetractl.core.errors import AbortError, UsageError, printable
from tetractl.core.poses import Floats
from tetractl.tools.table.csv_rows import is_number, read_csv
from tetractl.tools.table.quantities import (
    SECONDS,
    TIME_MAX,
    TIME_NAMES,
    NumberColumn,
    find_factor,
    split_header,
)

COLUMNS_SHOWN = 8
"""Maximum number of columns that a message names."""
POSES_MAX = 2_000_000
"""Maximum number of positions that are read."""
AXES = (("t", "time", "frame"), ("x",), ("y",))
"""Names of the axes of a graph of which no types are stated."""
SPARSE = 10
"""Minimum common step of all image numbers that is reported: times in ms have such a step."""
ERROR_CHARACTERS_MAX = 200
"""Maximum number of characters of an error of the library geff that are shown."""
MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6, "inch": 25400.0}
"""Units of lengths [um]."""
PIXELS = ("", "px", "pixel", "pixels")
"""Units of places that need a scale."""


def _is_count(unit: str) -> bool:
    """Check whether a unit is that of counts: none, or frames."""
    return unit in ("", "frame", "frames")


def _is_time(unit: str) -> bool:
    """Check whether a unit is a unit of time."""
    return find_factor(unit, SECONDS) is not None


def _is_place(unit: str) -> bool:
    """Check whether a unit is a unit of length that can be converted to um, or pixels."""
    return unit in PIXELS or find_factor(unit, MICROMETRES) is not None


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
"""The names of each column in tables of other programs, before its unit, and the units it may have.

The first name that a table has counts, because spots also have their own id.
"""
WORDS_BELOW = "position_x"
"""Where TrackMate's tables have rows of words below the header, of which the last states units."""


@dataclass(frozen=True, slots=True)
class AxisStep:
    """The meaning of one unit along an axis of a file.

    Attributes:
        size: Its size [um or s]. None if it is not stated.
        counted: Whether numbers count pixels or images. Then an option may state the size.
    """

    size: float | None = None
    counted: bool = True


TRACK_MAX = 2.0**53
"""Maximum number of a track. Imaris counts tracks from 1e9."""
FROM_ONE = "images are numbered from 1; image 1 is taken as the first of the video, at 0 s"


@dataclass(frozen=True, slots=True)
class SpotTable:
    """The spots of all tracks in a table from another program.

    Attributes:
        rows: Array of shape (R, 4): track id, time or image index, x, y (pointing down).
        across: What one unit of x means.
        time: What one unit of the second column means.
        tall: Length of one unit of y, as a multiple of one unit of x.
    """

    rows: Floats
    across: AxisStep = AxisStep()
    time: AxisStep = AxisStep()
    tall: float = 1.0


@dataclass(frozen=True, slots=True)
class SpotTrack:
    """A track of another program.

    Attributes:
        number: Its number.
        rows: Time [s], x and y [um], y pointing up, shape (K, 3), in the order of time.
    """

    number: float
    rows: Floats


def spot_tracks(
    path: Path, um_px: float | None, rate_hz: float | None, remarks: list[str]
) -> list[SpotTrack]:
    """Read the tracks in a table or graph of another program.

    Positions are usually in pixels, with y pointing down, and times are image numbers. Such tables
    need a scale and a rate, unless they contain them.

    Args:
        path: The table or graph.
        um_px: Scale [um/px]. None if the table contains it.
        rate_hz: Frame rate [Hz]. None if the table contains it.
        remarks: List to which remarks for the user are added.

    Raises:
        UsageError: If the table is invalid, or if the scale or rate is missing or has no meaning.
        AbortError: If software for GEFF graphs is not installed.
    """
    spots = _graph(path) if path.is_dir() else _spot_table(path, rate_hz, remarks)
    um = _size(path, "--scale", "the file gives places in a unit of length", um_px, spots.across)
    period = None if rate_hz is None else 1 / rate_hz
    seconds = _size(path, "--rate", "it states times", period, spots.time)
    missing = list[str]()
    if um is None:
        missing.append("a unit of length")
    if seconds is None:
        missing.append("the time of an image")
    if um is None or seconds is None:
        said = f"{path}: its tracks do not state {' and '.join(missing)}"
        raise UsageError(said, "give --scale UM_PER_PIXEL and --rate IMAGES_PER_SECOND")
    if not np.isfinite(spots.rows).all():
        raise UsageError(f"{path}: the file contains a value that is not finite")
    tracks = list[SpotTrack]()
    for number in np.unique(spots.rows[:, 0]).tolist():
        is_on_track = spots.rows[:, 0] == number
        track = np.unique(spots.rows[is_on_track, 1:], axis=0)  # by time; a row twice counts once
        rows = track * (seconds, um, -spots.tall * um)
        _require_one_place(path, number, rows[:, 0])
        tracks.append(SpotTrack(number, rows))
    return tracks


def _spot_table(path: Path, rate_hz: float | None, remarks: list[str]) -> SpotTable:
    """Read the spots of the tracks in a table.

    The times come from a column with a unit of time. Without such a column, or if a rate is given,
    they are image numbers, counted from the first image.

    Raises:
        UsageError: If a column is missing or a value is invalid.
    """
    rows = read_csv(path)
    first = next(rows, None)
    if first is None:
        raise UsageError(f"{path}: the file has no rows of data")
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
    columns["track"] = NumberColumn(headers["track"], largest=TRACK_MAX)
    if "time" in units:
        second = find_factor(units["time"], SECONDS) or 1.0
        columns["time"] = NumberColumn(headers["time"], second, TIME_MAX)
    numbers = list[float]()
    for row in chain([first] if first else [], rows):
        if not math.isnan(columns["track"].optional(path, row)):  # else a spot of no track
            for what, column in columns.items():
                is_place = what in ("x", "y")  # a cell need not be found in each picture
                number = column.optional(path, row) if is_place else column.number(path, row)
                numbers.append(number)
    if not numbers:
        raise UsageError(f"{path}: the file has no point that belongs to a track")
    table = np.reshape(numbers, (-1, len(columns)))
    values = dict(zip(columns, table.T, strict=True))
    if "time" in values and ("frame" not in values or rate_hz is None):
        when = values["time"]
        time = AxisStep(1.0, False)
    else:
        if "time" not in values:
            _require_whole(path, headers["frame"], values["frame"])
            _note_sparse(path, headers["frame"], values["frame"], remarks)
        when = _from_first_picture(path, values["frame"], remarks)
        time = AxisStep()
        if "time" in values and rate_hz is not None:
            _note_other_times(path, values["time"], when / rate_hz, rate_hz, remarks)
    um_across = find_factor(units["x"], MICROMETRES)
    um_up = find_factor(units["y"], MICROMETRES)
    spots = np.column_stack([values["track"], when, values["x"], values["y"]])
    spots = spots[np.isfinite(spots).all(axis=1)]
    if not len(spots):
        raise UsageError(f"{path}: the file has no point that belongs to a track")
    return SpotTable(
        spots,
        across=AxisStep(um_across, um_across is None),
        time=time,
        tall=um_up / um_across if um_across and um_up else 1.0,
    )


def _name_and_unit(header: str) -> tuple[str, str]:
    """Split the header of a column into its name, with _ for a blank, and its unit.

    The unit is "" if the header contains none.
    """
    name, unit = split_header(header)
    for pixels in PIXELS[1:]:
        if not unit and name.endswith(f"_{pixels}"):
            return name.removesuffix(f"_{pixels}"), pixels
    return name, unit


def _column(
    quantities: Mapping[str, tuple[str, str]], names: Sequence[str], fits: Callable[[str], bool]
) -> str:
    """Find the first of several names that a column with a fitting unit has.

    Args:
        quantities: Name and unit of each column, by its header.
        names: The names to look for, in this order.
        fits: Checks whether a unit is possible.

    Returns:
        The header of the column. "" if there is none.
    """
    for wanted in names:
        for header, (name, unit) in quantities.items():
            if name == wanted and fits(unit):
                return header
    return ""


def _require_columns(path: Path, headers: Mapping[str, str], listed: Sequence[str]) -> None:
    """Check that a table has all columns of tracks.

    Args:
        path: The table.
        headers: Header of each column that was found. "" if it was not found.
        listed: All headers of the table, for the message.

    Raises:
        UsageError: If a column is missing.
    """
    missing = list[str]()
    if not headers["track"]:
        missing.append("particle, track_id or id")
    if not headers["frame"] and not headers["time"]:
        missing.append("frame, t or time_s")
    missing += [axis for axis in ("x", "y") if not headers[axis]]
    if missing:
        listed = ", ".join(printable(header) for header in listed[:COLUMNS_SHOWN])
        said = (
            f"{path}: columns of the tracks are missing: {'; '.join(missing)}; the file's "
            f"columns are {listed}"
        )
        raise UsageError(
            said, "the first line of the file must name the columns particle, frame, x and y"
        )


def _require_whole(path: Path, column: str, frames: Floats) -> None:
    """Check that image numbers are whole and not negative.

    Raises:
        UsageError: If they are not.
    """
    is_fraction = frames % 1 != 0
    if is_fraction.any():
        first = frames[is_fraction][0]
        said = (
            f"{path}: column {printable(column)}: {first:g} is not a whole number, so "
            "it is not a frame number"
        )
        raise UsageError(
            said, f"if these are times in seconds, name the column {printable(column)}_s"
        )
    if frames.min() < 0:
        said = (
            f"{path}: column {printable(column)}: {frames.min():g} is below 0, so it is not "
            "a frame number"
        )
        raise UsageError(said, "number the first frame of the video 0")


def _from_first_picture(path: Path, frames: Floats, remarks: list[str]) -> Floats:
    """Return image indices that start at 0, so that the first image is taken at time 0.

    Programs that count from 0 almost always find something in that image. A table without 0
    therefore counts from 1.
    """
    if frames.min() != 1:
        return frames
    remarks.append(f"warning: {path}: {FROM_ONE}")
    return frames - 1


def _note_sparse(path: Path, column: str, frames: Floats, remarks: list[str]) -> None:
    """Add a warning to `remarks` if all image numbers are multiples of SPARSE or a larger step.

    Such numbers may be milliseconds. They are counted from the first image.
    """
    after_first = (frames - frames.min()).astype(np.int64)
    step = int(np.gcd.reduce(after_first))
    if step >= SPARSE:
        name = printable(column)
        remarks.append(
            f"warning: {path}: the values in column {name} increase in steps of {step}; if they "
            f"are milliseconds, name the column {name}_ms"
        )


def _note_other_times(
    path: Path, stated: Floats, times: Floats, rate_hz: float, remarks: list[str]
) -> None:
    """Add a warning to `remarks` if the times (R,) [s] of a table differ from those of --rate.

    They must differ by more than half the time between two images. Both are counted from their
    first time.
    """
    most = float(np.abs((stated - stated[0]) - (times - times[0])).max())
    if most > 0.5 / rate_hz:
        remarks.append(
            f"warning: {path}: --rate {rate_hz:g} replaces the times in the file, which differ "
            f"by up to {most:.3g} s"
        )


def _require_one_place(path: Path, number: float, times: Floats) -> None:
    """Check that a track has only one position at each time. `times` (K,) rises or repeats [s].

    Raises:
        UsageError: If it has two at one time.
    """
    is_twice = np.diff(times) == 0
    if is_twice.any():
        when = times[:-1][is_twice][0]
        raise UsageError(
            f"{path}: cell {number:.0f} has two different places at {when:.15g} s",
            "do several tracks have the same number, or are the times rounded?",
        )


def _size(
    path: Path, option: str, states: str, stated: float | None, step: AxisStep
) -> float | None:
    """Return the size of one unit of a column [um or s]. An option has priority over the table.

    Raises:
        UsageError: If the option is given, but the column has a unit.
    """
    if stated is None:
        return step.size
    if not step.counted:
        said = f"{path}: {states}, so the option {option} must be left out"
        raise UsageError(said, f"leave out {option}")
    return stated


def _graph(path: Path) -> SpotTable:
    """Read the spots of a GEFF graph. The types of its axes tell which are time, x and y.

    A track begins at a node that has no predecessor, or whose predecessor has several successors.

    Raises:
        UsageError: If the graph cannot be read.
        AbortError: If the library geff is not installed.
    """
    try:
        from geff.core_io import read_to_memory
    except ModuleNotFoundError as error:
        said = f"{path}: reading a GEFF graph (a folder) needs geff, which is not installed"
        raise AbortError(said, "pip install './packages/tetractl-microscope[geff]'") from error
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    try:
        graph: Mapping[str, Any] = read_to_memory(path)
        properties = graph["node_props"]
        axes = _axes(graph["metadata"].axes or (), properties)
        nodes = [properties[axis.name]["values"].astype(float) for axis in axes]
    except Exception as error:  # geff and zarr do not document what they raise
        raise UsageError(
            f"{path}: cannot be read as a GEFF graph with t, x and y: {_problem_of(error)}",
            "export the tracks again with a newer version of the program that wrote them, or "
            "as CSV",
        ) from error
    ids = graph["node_ids"]
    edges = graph["edge_ids"]
    if len(ids) > POSES_MAX:
        raise UsageError(
            f"{path}: the graph has {len(ids)} nodes, but at most {POSES_MAX} can be read"
        )
    if not len(edges):
        raise UsageError(f"{path}: the graph has no edges, and therefore no tracks")
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


def _problem_of(error: Exception) -> str:
    """Describe an error of a library in one line of at most ERROR_CHARACTERS_MAX characters.

    If it is an error of pydantic, only its first problem is described.
    """
    problems: Any = getattr(error, "errors", None)  # pydantic's, each with its place and a text
    if callable(problems):
        first: Any = problems(include_url=False)[0]  # pyright: ignore[reportIndexIssue]
        place = ".".join(map(str, first["loc"]))
        return printable(
            f"{place}: {first['msg']}" if place else str(first["msg"]), ERROR_CHARACTERS_MAX
        )
    words = f"{type(error).__name__}: {error}".split()
    return printable(" ".join(words), ERROR_CHARACTERS_MAX)


def _axes(stated: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """Find the axes of time, x and y.

    They are found by the types in the metadata, or else by the names of axes or, without axes, of
    properties: t or time, x and y. In space, x and y are the axes whose names end so, or else the
    last two: images have the order y, x.
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
    by_place: list[Any] = []
    for names_of_place in AXES:
        by_place += [by_name[name] for name in names_of_place if name in by_name][:1]
    if len(by_place) < len(AXES):
        names_said = ", ".join(axis.name for axis in named_axes)
        has_types = "no axis has a type"
        if times:
            has_types = "no two axes have the type space"
        elif places:
            has_types = "no axis has the type time"
        raise ValueError(f"{has_types}, and their names are {names_said}")
    return by_place


def _step(axis: Any, units: Mapping[str, float]) -> AxisStep:
    """Return the length of one unit along an axis of a graph, as its units state it.

    The length is None if no unit is known.
    """
    scaled = find_factor(axis.scaled_unit or "", units)
    if scaled is not None and axis.scale:
        return AxisStep(axis.scale * scaled)
    size = find_factor(axis.unit or "", units)
    return AxisStep(size, size is None)
