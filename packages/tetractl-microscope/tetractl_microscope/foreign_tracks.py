"""Tracks of other programs as poses: the tables of napari and trackpy, and GEFF graphs."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.errors import AbortError, UsageError
from tetractl.core.poses import Floats
from tetractl.core.table.table_files import read_csv
from tetractl.replay.identification.tracks import POSES_MAX
from tetractl_microscope.film.kinematics import TURN_S
from tetractl_microscope.film.track_log import CELL
from tetractl_microscope.number_columns import read_numbers

NUMBERS = ("particle", "track_id", "track id", "id")  # names of the column of a track's number
FRAMES = ("frame", "t")

PoseRow = dict[str, str]


def pose_rows(path: Path, um_px: float | None, rate_hz: float | None) -> Iterator[PoseRow]:
    """Yield the rows of a table of poses or of the field; cells as robots, tracks of other programs
    as rows of poses.

    These are given in pixels, y downwards, and pictures, so that they need a scale `um_px` and a
    rate, unless a graph states them; headings are the directions of motion.
    """
    if path.is_dir():
        yield from _poses(path, *_graph(path, um_px, rate_hz))
        return
    names = {name.strip().lower(): name for name in next(read_csv(path), {})}
    number = next((names[name] for name in NUMBERS if name in names), None)
    frame = next((names[name] for name in FRAMES if name in names), None)
    if number is None or frame is None or not {"x", "y"} <= set(names):
        for row in read_csv(path):
            yield row | {"robot": CELL + row["cell"]} if "cell" in row else row
        return
    kept = (number, frame, names["x"], names["y"])
    yield from _poses(path, read_numbers(path, kept, {}), um_px, rate_hz)


def _poses(
    path: Path, table: Floats, um_px: float | None, rate_hz: float | None
) -> Iterator[PoseRow]:
    """Yield the poses of rows (R, 4) of track, picture, x and y [pixels]."""
    if um_px is None or rate_hz is None:
        said = f"{path}: its tracks are in pixels and pictures"
        raise UsageError(said, "give --scale UM_PER_PIXEL and --rate PICTURES_PER_SECOND")
    if not np.isfinite(table).all():
        raise UsageError(f"{path}: has a value that is not finite")
    half = max(1, round(TURN_S * rate_hz / 2))
    for number in np.unique(table[:, 0]):
        track = table[table[:, 0] == number]
        _, frame, x, y = track[np.argsort(track[:, 1], kind="stable")].T
        index = np.arange(len(x))
        begin, end = np.maximum(index - half, 0), np.minimum(index + half, len(x) - 1)
        heading = np.unwrap(np.arctan2(y[begin] - y[end], x[end] - x[begin]))
        columns = (frame / rate_hz, um_px * x, -um_px * y, heading)
        for time, *pose in zip(*(column.tolist() for column in columns), strict=True):
            values = dict(zip(("x_um", "y_um", "heading_rad"), map(repr, pose), strict=True))
            yield {"time_s": repr(time), "robot": f"{CELL}{number:g}"} | values


def _graph(
    path: Path, um_px: float | None, rate_hz: float | None
) -> tuple[Floats, float | None, float | None]:
    """Return rows (R, 4) as `_poses` takes them of a GEFF graph, and its scale and rate.

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
        axes = {axis.name: axis for axis in graph["metadata"].axes or ()}
        nodes = {name: graph["node_props"][name]["values"].astype(float) for name in "txy"}
    except Exception as error:  # geff and zarr do not document what they raise
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise UsageError(f"{path}: cannot be read as a GEFF graph of t, x, y: {said}") from error
    ids, edges = graph["node_ids"], graph["edge_ids"]
    if len(ids) > POSES_MAX:
        raise UsageError(f"{path}: has {len(ids)} nodes; at most {POSES_MAX} are read")
    order = np.argsort(ids)
    first, last = order[np.searchsorted(ids, edges, sorter=order)].T
    single = np.bincount(first, minlength=len(ids))[first] == 1
    links = coo_array((np.ones(single.sum()), (first[single], last[single])), [len(ids)] * 2)
    _, track = connected_components(links, directed=False)
    step, size = _unit(axes.get("t"), "second"), _unit(axes.get("x"), "micrometer")
    rate_hz = rate_hz or (1 / step if step else None)
    rows = np.column_stack([track + 1, nodes["t"], nodes["x"], nodes["y"]])
    return rows, um_px or size, rate_hz


def _unit(axis: Any, unit: str) -> float | None:
    """Return the length of one step of an axis in a unit, None if it states none."""
    if axis is None:
        return None
    return axis.scale if axis.scaled_unit == unit else 1.0 if axis.unit == unit else None
