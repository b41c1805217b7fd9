"""Writes the tracks of a film in GEFF, the graph exchange file format for tracks
(live-image-tracking-tools.github.io/geff), which TrackMate, napari, ultrack and traccuracy read.
"""

from pathlib import Path
from typing import Any

import numpy as np

from tetractl.tools.table.table import Table

ABOUT = {
    "cell": "number of the cell",
    "heading": "direction of swimming, from +x towards +y, which points down [rad]",
    "axis": "direction of the body, likewise [rad]",
    "sure": "whether the node surely is the cell that had this number at first",
}


def write_geff(
    path: Path,
    poses: Table,
    tracks: Table,
    rate_hz: float | None,
    um_px: float,
) -> None:
    """Write a node for each row of the tables that `pose_tables` of `film` returns: t [pictures],
    or [s] without a rate, since pictures are at uneven times, y and x [pixels], and what ABOUT
    lists; an edge between successive nodes of a cell.
    """
    from geff import GeffMetadata
    from geff.core_io import write_arrays
    from geff_spec import Axis, PropMetadata

    pixels = tracks.as_dict()
    um = poses.as_dict()
    cell = np.array(pixels["id"], np.int64)
    frame = np.array(pixels["t"], np.int64)
    values = {
        "t": np.array(um["time_s"], float) if rate_hz is None else frame,
        "y": np.array(pixels["y"], float),
        "x": np.array(pixels["x"], float),
        "cell": cell,
        "heading": -np.array(um["heading_rad"], float),
        "axis": -np.array(um["axis_rad"], float),
        "sure": np.array(um["sure"], bool),
    }
    space = {"type": "space", "unit": "pixel", "scale": um_px, "scaled_unit": "micrometer"}
    time: dict[str, Any] = {"type": "time", "unit": "second"}
    if rate_hz is not None:
        time = {"type": "time", "unit": "frame", "scale": 1 / rate_hz, "scaled_unit": "second"}
    order = np.lexsort((frame, cell))
    goes_on = np.diff(cell[order]) == 0
    about = {
        name: PropMetadata(identifier=name, dtype=str(values[name].dtype), description=text)
        for name, text in ABOUT.items()
    }
    write_arrays(
        path,
        np.arange(len(cell), dtype=np.uint64),
        {name: {"values": array, "missing": None} for name, array in values.items()},
        np.column_stack([order[:-1], order[1:]])[goes_on].astype(np.uint64),
        {},
        GeffMetadata(
            directed=True,
            axes=[Axis(name="t", **time), Axis(name="y", **space), Axis(name="x", **space)],
            node_props_metadata=about,
            edge_props_metadata={},
        ),
    )
