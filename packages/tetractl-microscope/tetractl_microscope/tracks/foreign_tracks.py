"""Reads tracks of cells that other programs have written.

The module reads the tables of napari, trackpy, TrackMate, MTrackJ, ImageJ's Manual Tracking and
Imaris, and GEFF graphs.
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
AXIS_NAMES = (("t", "time", "frame"), ("x",), ("y",))
"""Possible names of the axes of time, x and y in a graph whose axes have no types."""
SPARSE_STEP_MIN = 10
"""Minimum common step of image numbers for a warning that they may be times in ms."""
ERROR_CHARACTERS_MAX = 200
"""Maximum number of characters of an error of the library geff that are shown."""
MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6, "inch": 25400.0}
"""Length of each unit [um]."""
PIXELS = ("", "px", "pixel", "pixels")
"""Units of positions that need a scale to be converted to um."""


def _is_count(unit: str) -> bool:
    """Check whether a unit means that numbers are counts: no unit, or frames."""
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
"""For each quantity, the names of its column in tables of other programs, and a check of its unit.

A name excludes the unit. The first name in this order that a table contains is used, because spots
also have their own id.
"""
HAS_WORD_ROWS = "position_x"
"""Name of a column by which TrackMate's tables are recognised.

These tables have rows of words below the header. The last of these rows states the units.
"""


@dataclass(frozen=True, slots=True)
class AxisStep:
    """The meaning of one unit along an axis of a file.

    Attributes:
        size: Size of one unit [um or s]. None if the file does not state it.
        counted: Whether the numbers count pixels or images. An option may then state the size.
    """

    size: float | None = None
    counted: bool = True


TRACK_MAX = 2.0**53
"""Maximum number of a track. Imaris counts tracks from 1e9, and floats are exact up to 2^53."""
COUNTED_FROM_ONE = "images are numbered from 1; image 1 is taken as the first of the video, at 0 s"


@dataclass(frozen=True, slots=True)
class SpotTable:
    """The spots of all tracks in a table from another program.

    Attributes:
        rows: Array of shape (R, 4): track id, time or image index, x, y (pointing down).
        x_step: The meaning of one unit of x.
        time: The meaning of one unit of the second column.
        y_per_x: Length of one unit of y, as a multiple of one unit of x.
    """

    rows: Floats
    x_step: AxisStep = AxisStep()
    time: AxisStep = AxisStep()
    y_per_x: float = 1.0


@dataclass(frozen=True, slots=True)
class SpotTrack:
    """The track of one cell that another program has found.

    Attributes:
        number: Number of the track in the file.
        rows: Time [s], x and y [um] of each position, with y pointing up, shape (K, 3), in the
            order of time.
    """

    number: float
    rows: Floats


def read_spot_tracks(
    path: Path, um_px: float | None, rate_hz: float | None, remarks: list[str]
) -> list[SpotTrack]:
    """Read the tracks of cells from a table or a graph of another program.

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
    spots = _read_graph(path) if path.is_dir() else _read_spot_table(path, rate_hz, remarks)
    um_per_unit = _find_unit_size(
        path, "--scale", "the file gives places in a unit of length", um_px, spots.x_step
    )
    period_s = None if rate_hz is None else 1 / rate_hz
    s_per_unit = _find_unit_size(path, "--rate", "it states times", period_s, spots.time)
    missing = list[str]()
    if um_per_unit is None:
        missing.append("a unit of length")
    if s_per_unit is None:
        missing.append("the time of an image")
    if um_per_unit is None or s_per_unit is None:
        problem = f"{path}: its tracks do not state {' and '.join(missing)}"
        raise UsageError(problem, "give --scale UM_PER_PIXEL and --rate IMAGES_PER_SECOND")
    if not np.isfinite(spots.rows).all():
        raise UsageError(f"{path}: the file contains a value that is not finite")
    tracks = list[SpotTrack]()
    for number in np.unique(spots.rows[:, 0]).tolist():
        is_on_track = spots.rows[:, 0] == number
        track = np.unique(spots.rows[is_on_track, 1:], axis=0)  # by time; a row twice counts once
        rows = track * (s_per_unit, um_per_unit, -spots.y_per_x * um_per_unit)
        _require_one_place(path, number, rows[:, 0])
        tracks.append(SpotTrack(number, rows))
    return tracks


def _read_spot_table(path: Path, rate_hz: float | None, remarks: list[str]) -> SpotTable:
    """Read the spots of all tracks from a table of another program.

    The times come from a column with a unit of time. Without such a column, or if a rate is given,
    they are image numbers, counted from the first image.

    Raises:
        UsageError: If a column is missing or a value is invalid.
    """
    rows = read_csv(path)
    first_row = next(rows, None)
    if first_row is None:
        raise UsageError(f"{path}: the file has no rows of data")
    quantities = {header: _split_name_and_unit(header) for header in first_row.cells}
    word_headers = [header for header, (name, _) in quantities.items() if name == HAS_WORD_ROWS]
    while first_row and word_headers and not is_number(first_row.cells[word_headers[0]]):
        for header, cell in first_row.cells.items():
            unit = cell.strip("()") if cell.startswith("(") else ""
            quantities[header] = quantities[header][0], unit
        first_row = next(rows, None)
    headers = {quantity: _find_column(quantities, *COLUMNS[quantity]) for quantity in COLUMNS}
    _require_columns(path, headers, list(quantities))
    units = {quantity: quantities[header][1] for quantity, header in headers.items() if header}
    columns = {quantity: NumberColumn(headers[quantity]) for quantity in units}
    columns["track"] = NumberColumn(headers["track"], number_max=TRACK_MAX)
    if "time" in units:
        seconds_per_unit = find_factor(units["time"], SECONDS) or 1.0
        columns["time"] = NumberColumn(headers["time"], seconds_per_unit, TIME_MAX)
    numbers = list[float]()
    for row in chain([first_row] if first_row else [], rows):
        if not math.isnan(columns["track"].read_optional(path, row)):  # else a spot of no track
            for quantity, column in columns.items():
                is_place = quantity in ("x", "y")  # a cell need not be found in each picture
                number = column.read_optional(path, row) if is_place else column.number(path, row)
                numbers.append(number)
    if not numbers:
        raise UsageError(f"{path}: the file has no point that belongs to a track")
    table = np.reshape(numbers, (-1, len(columns)))
    values = dict(zip(columns, table.T, strict=True))
    if "time" in values and ("frame" not in values or rate_hz is None):
        time_values = values["time"]
        time_step = AxisStep(1.0, False)
    else:
        if "time" not in values:
            _require_whole(path, headers["frame"], values["frame"])
            _warn_if_sparse(path, headers["frame"], values["frame"], remarks)
        time_values = _count_from_first_image(path, values["frame"], remarks)
        time_step = AxisStep()
        if "time" in values and rate_hz is not None:
            _warn_of_other_times(path, values["time"], time_values / rate_hz, rate_hz, remarks)
    um_across = find_factor(units["x"], MICROMETRES)
    um_upwards = find_factor(units["y"], MICROMETRES)
    spots = np.column_stack([values["track"], time_values, values["x"], values["y"]])
    spots = spots[np.isfinite(spots).all(axis=1)]
    if not len(spots):
        raise UsageError(f"{path}: the file has no point that belongs to a track")
    return SpotTable(
        spots,
        x_step=AxisStep(um_across, um_across is None),
        time=time_step,
        y_per_x=um_upwards / um_across if um_across and um_upwards else 1.0,
    )


def _split_name_and_unit(header: str) -> tuple[str, str]:
    """Split the header of a column into its name, with _ for a blank, and its unit.

    The unit is "" if the header contains none.
    """
    name, unit = split_header(header)
    for pixels in PIXELS[1:]:
        if not unit and name.endswith(f"_{pixels}"):
            return name.removesuffix(f"_{pixels}"), pixels
    return name, unit


def _find_column(
    quantities: Mapping[str, tuple[str, str]],
    names: Sequence[str],
    is_unit_possible: Callable[[str], bool],
) -> str:
    """Find the first of several names that a column with a fitting unit has.

    Args:
        quantities: Name and unit of each column, by its header.
        names: The names to look for, in this order.
        is_unit_possible: Checks whether a unit is possible.

    Returns:
        The header of the column. "" if there is none.
    """
    for expected_name in names:
        for header, (name, unit) in quantities.items():
            if name == expected_name and is_unit_possible(unit):
                return header
    return ""


def _require_columns(path: Path, headers: Mapping[str, str], all_headers: Sequence[str]) -> None:
    """Check that a table has all columns of tracks.

    Args:
        path: The table.
        headers: Header of each column that was found. "" if it was not found.
        all_headers: All headers of the table, for the message.

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
        all_headers = ", ".join(printable(header) for header in all_headers[:COLUMNS_SHOWN])
        problem = (
            f"{path}: columns of the tracks are missing: {'; '.join(missing)}; the file's "
            f"columns are {all_headers}"
        )
        raise UsageError(
            problem, "the first line of the file must name the columns particle, frame, x and y"
        )


def _require_whole(path: Path, column: str, frames: Floats) -> None:
    """Check that image numbers are whole and not negative.

    Raises:
        UsageError: If they are not.
    """
    is_fraction = frames % 1 != 0
    if is_fraction.any():
        first_fraction = frames[is_fraction][0]
        problem = (
            f"{path}: column {printable(column)}: {first_fraction:g} is not a whole number, so "
            "it is not a frame number"
        )
        raise UsageError(
            problem, f"if these are times in seconds, name the column {printable(column)}_s"
        )
    if frames.min() < 0:
        problem = (
            f"{path}: column {printable(column)}: {frames.min():g} is below 0, so it is not "
            "a frame number"
        )
        raise UsageError(problem, "number the first frame of the video 0")


def _count_from_first_image(path: Path, frames: Floats, remarks: list[str]) -> Floats:
    """Count images from 0 if a table counts them from 1, so that the first image is at time 0.

    Programs that count from 0 almost always find something in that image. A table without 0
    therefore counts from 1.
    """
    if frames.min() != 1:
        return frames
    remarks.append(f"warning: {path}: {COUNTED_FROM_ONE}")
    return frames - 1


def _warn_if_sparse(path: Path, column: str, frames: Floats, remarks: list[str]) -> None:
    """Add a warning to `remarks` if image numbers increase in steps of at least SPARSE_STEP_MIN.

    Such numbers may be milliseconds. The step is the greatest common divisor of all differences
    from the first image number.
    """
    after_first = (frames - frames.min()).astype(np.int64)
    step = int(np.gcd.reduce(after_first))
    if step >= SPARSE_STEP_MIN:
        name = printable(column)
        remarks.append(
            f"warning: {path}: the values in column {name} increase in steps of {step}; if they "
            f"are milliseconds, name the column {name}_ms"
        )


def _warn_of_other_times(
    path: Path, stated: Floats, times: Floats, rate_hz: float, remarks: list[str]
) -> None:
    """Add a warning to `remarks` if the times in a table disagree with the option --rate.

    The times (R,) [s] disagree if they differ by more than half the time between two images. Both
    are counted from their first time.
    """
    difference_max_s = float(np.abs((stated - stated[0]) - (times - times[0])).max())
    if difference_max_s > 0.5 / rate_hz:
        remarks.append(
            f"warning: {path}: --rate {rate_hz:g} replaces the times in the file, which differ "
            f"by up to {difference_max_s:.3g} s"
        )


def _require_one_place(path: Path, number: float, times: Floats) -> None:
    """Check that a track has only one position at each time.

    Args:
        path: The file, for the message.
        number: Number of the track.
        times: Times of its positions in order, shape (K,) [s].

    Raises:
        UsageError: If the track has two positions at one time.
    """
    is_repeated = np.diff(times) == 0
    if is_repeated.any():
        time_s = times[:-1][is_repeated][0]
        raise UsageError(
            f"{path}: cell {number:.0f} has two different places at {time_s:.15g} s",
            "do several tracks have the same number, or are the times rounded?",
        )


def _find_unit_size(
    path: Path, option: str, states: str, stated: float | None, step: AxisStep
) -> float | None:
    """Find the size of one unit of a column [um or s], from an option or from the table.

    Args:
        path: The file, for the message.
        option: Name of the option that states the size.
        states: What the file states if the column has a unit, for the message.
        stated: Value of the option. None if the option is not given.
        step: The meaning of one unit of the column in the file.

    Returns:
        The size. None if neither the option nor the file states it.

    Raises:
        UsageError: If the option is given, but the column has a unit.
    """
    if stated is None:
        return step.size
    if not step.counted:
        problem = f"{path}: {states}, so the option {option} must be left out"
        raise UsageError(problem, f"leave out {option}")
    return stated


def _read_graph(path: Path) -> SpotTable:
    """Read the spots of all tracks from a GEFF graph.

    Time, x and y are found by the types of the graph's axes. A track begins at a node that has no
    predecessor, or whose predecessor has several successors.

    Raises:
        UsageError: If the graph cannot be read.
        AbortError: If the library geff is not installed.
    """
    try:
        from geff.core_io import read_to_memory
    except ModuleNotFoundError as error:
        problem = f"{path}: reading a GEFF graph (a folder) needs geff, which is not installed"
        raise AbortError(problem, "pip install './packages/tetractl-microscope[geff]'") from error
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    try:
        graph: Mapping[str, Any] = read_to_memory(path)
        properties = graph["node_props"]
        axes = _find_axes(graph["metadata"].axes or (), properties)
        nodes = [properties[axis.name]["values"].astype(float) for axis in axes]
    except Exception as error:  # geff and zarr do not document what they raise
        raise UsageError(
            f"{path}: cannot be read as a GEFF graph with t, x and y: "
            f"{_describe_library_error(error)}",
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
    sources, targets = order[np.searchsorted(ids, edges, sorter=order)].T
    has_single_successor = np.bincount(sources, minlength=len(ids))[sources] == 1
    edge_ends = (sources[has_single_successor], targets[has_single_successor])
    count = len(ids)
    links = coo_array((np.ones(has_single_successor.sum()), edge_ends), (count, count))
    _, track = connected_components(links, directed=False)
    time, x, y = axes
    x_step = _find_axis_step(x, MICROMETRES)
    y_step = _find_axis_step(y, MICROMETRES)
    y_to_x_ratio = y_step.size / x_step.size if x_step.size and y_step.size else 1.0
    return SpotTable(
        np.column_stack([track + 1, *nodes]), x_step, _find_axis_step(time, SECONDS), y_to_x_ratio
    )


def _describe_library_error(error: Exception) -> str:
    """Describe an error of a library in one short line.

    The line has at most ERROR_CHARACTERS_MAX characters. If the error comes from pydantic, only its
    first problem is described.
    """
    problems: Any = getattr(error, "errors", None)  # pydantic's, each with its place and a text
    if callable(problems):
        first_problem: Any = problems(include_url=False)[0]  # pyright: ignore[reportIndexIssue]
        location = ".".join(map(str, first_problem["loc"]))
        return printable(
            f"{location}: {first_problem['msg']}" if location else str(first_problem["msg"]),
            ERROR_CHARACTERS_MAX,
        )
    described = f"{type(error).__name__}: {error}".split()
    return printable(" ".join(described), ERROR_CHARACTERS_MAX)


def _find_axes(stated_axes: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """Find the axes of time, x and y of a GEFF graph.

    The axes are found by their types in the metadata. If they have no types, they are found by
    their names, or by the names of properties if the metadata contains no axes (see AXIS_NAMES).
    Among several space axes, x and y are the axes whose names end in x and y. If no names do, they
    are the last two axes, because images have the order y, x.
    """
    time_axes = [axis for axis in stated_axes if axis.type == "time"]
    space_axes = [axis for axis in stated_axes if axis.type == "space"]
    if time_axes and len(space_axes) >= 2:
        by_last_letter = {axis.name.lower()[-1:]: axis for axis in space_axes}
        *_, y, x = space_axes
        return (
            [time_axes[0], by_last_letter["x"], by_last_letter["y"]]
            if {"x", "y"} <= set(by_last_letter)
            else [time_axes[0], x, y]
        )
    named_axes = [*stated_axes] or [
        SimpleNamespace(name=name, unit="", scale=None, scaled_unit="") for name in names
    ]
    by_name = {axis.name.lower(): axis for axis in named_axes}
    found_axes: list[Any] = []
    for axis_names in AXIS_NAMES:
        found_axes += [by_name[name] for name in axis_names if name in by_name][:1]
    if len(found_axes) < len(AXIS_NAMES):
        listed_names = ", ".join(axis.name for axis in named_axes)
        missing_types = "no axis has a type"
        if time_axes:
            missing_types = "no two axes have the type space"
        elif space_axes:
            missing_types = "no axis has the type time"
        raise ValueError(f"{missing_types}; the names of the axes are {listed_names}")
    return found_axes


def _find_axis_step(axis: Any, units: Mapping[str, float]) -> AxisStep:
    """Find the size of one unit along an axis of a GEFF graph from its scale and units.

    The size is None if no unit is known.
    """
    scaled = find_factor(axis.scaled_unit or "", units)
    if scaled is not None and axis.scale:
        return AxisStep(axis.scale * scaled)
    size = find_factor(axis.unit or "", units)
    return AxisStep(size, size is None)
