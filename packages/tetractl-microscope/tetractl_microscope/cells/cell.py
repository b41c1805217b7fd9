"""A cell in one image, with its name and the place where it appeared."""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.kernels.helix_steps import STATES

POINT_UM = 1e-6  # length and width that stand for those of a blob without a size


class PathBlob(NamedTuple):
    """A blob on the path of a cell.

    Attributes:
        seconds: Time of the image [s].
        x: x of its centre [um].
        y: y of its centre [um].
        axis: Direction of its axis [rad].
        long: Its length [um]. NaN if the image's edge cuts it off.
        wide: Its width [um]. NaN if the image's edge cuts it off.
    """

    seconds: float
    x: float
    y: float
    axis: float
    long: float
    wide: float

    def moved(self, x: float, y: float) -> "PathBlob":
        """Return the cell moved by x, y [um]."""
        return self._replace(x=self.x + x, y=self.y + y)


class BodySize(NamedTuple):
    """Length and width of a body [um], as pictures show it."""

    long: float
    wide: float

    @property
    def area_um2(self) -> float:
        """Length times width, the measure by which bodies and blobs are compared."""
        return self.long * self.wide


def _unknown() -> Floats:
    """Return the state of a cell that the filter does not follow."""
    return np.full(STATES, np.nan)


@dataclass(frozen=True, slots=True)
class SeenCell:
    """One cell in one image. The defaults are those of a cell that no filter follows.

    Attributes:
        identity: Number of the cell.
        track: Number of its track.
        x: x of the middle of the body [um].
        y: y of the middle of the body [um].
        axis: Direction of the body [rad].
        heading: Direction of the helix's axis, which turns by equation (3) of the paper [rad].
        mean: The filter's state, shape (16,).
        sd: Its standard deviations, shape (16,).
        probability: Probability that this is the cell with the number `identity`.
        has_blob: Whether the image shows the cell.
        merged: Whether its blob also shows other cells.
        long_um: Length of the body [um].
        wide_um: Width of the body [um].
        blob_um: x, y [um], axis [rad], length and width [um] of the blob, shape (5,). Length and
            width are NaN if the image's edge cuts it off. None if the cell has no blob.
    """

    identity: int
    track: int
    x: float
    y: float
    axis: float
    heading: float
    mean: Floats = field(default_factory=_unknown)
    sd: Floats = field(default_factory=_unknown)
    probability: float = 1.0
    has_blob: bool = True
    merged: bool = False
    long_um: float = math.nan
    wide_um: float = math.nan
    blob_um: Floats | None = None

    def on_blob(self) -> "SeenCell":
        """Return the cell with its centre moved into the ellipse of its blob.

        If the centre was outside, it is moved straight to the edge. A blob that the image's edge
        cuts off has no size, and the cell is placed at its centre.
        """
        if self.blob_um is None:
            return self
        middle = self.blob_um[:2]
        off = np.array((self.x, self.y)) - middle
        away = float(to_edge(off, *np.nan_to_num(self.blob_um[2:], nan=POINT_UM)))
        if away <= 1.0:
            return self
        x, y = (middle + off / away).tolist()
        return replace(self, x=x, y=y)


def to_edge(off: Floats, axis: Floats, long: Floats, wide: Floats) -> Floats:
    """Compute how far points are from the centres of ellipses, relative to the ellipses' edges.

    Args:
        off: Offsets of the points from the centres, shape (..., 2).
        axis: Directions of the ellipses [rad].
        long: Lengths of the ellipses.
        wide: Widths of the ellipses.

    Returns:
        The distances (...), divided by the distances of the edges in the same directions.
    """
    along = off[..., 0] * np.cos(axis) + off[..., 1] * np.sin(axis)
    across = off[..., 1] * np.cos(axis) - off[..., 0] * np.sin(axis)
    return np.hypot(2 * along / long, 2 * across / wide)


@dataclass(frozen=True, slots=True)
class TrackName:
    """Which cell is on a track.

    Attributes:
        track: Number of the track.
        identity: Number of the cell.
        certainty: Probability that it is this cell.
        since_s: Since when it has been on the track [s].
    """

    track: int
    identity: int
    certainty: float
    since_s: float


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """Which cell is on which track after cells have met.

    Attributes:
        named: The tracks' names.
        probability: Probability of the most probable assignment.
        met: The cells that met.
    """

    named: tuple[TrackName, ...]
    probability: float
    met: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Born:
    """A cell that appears on a new track.

    `divided` is the number of the cell from whose blob it separated, if no other cell had entered
    that blob; otherwise None.
    """

    identity: int
    track: int
    divided: int | None
