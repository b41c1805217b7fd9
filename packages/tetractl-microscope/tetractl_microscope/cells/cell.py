"""A tracked cell in one image, its identity, and the events in which identities change."""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.kernels.helix_steps import STATE_SIZE

POINT_UM = 1e-6  # length and width that stand for those of a blob without a size


class PathBlob(NamedTuple):
    """The blob of a cell in one image of its path.

    Attributes:
        seconds: Time of the image [s].
        x: x of the blob's centre [um].
        y: y of the blob's centre [um].
        axis: Direction of its long axis, mod pi [rad].
        length: Its length [um]. NaN if the image's edge cuts it off.
        width: Its width [um]. NaN if the image's edge cuts it off.
    """

    seconds: float
    x: float
    y: float
    axis: float
    length: float
    width: float

    def moved(self, x: float, y: float) -> "PathBlob":
        """Return a copy of the blob, moved by x and y [um]."""
        return self._replace(x=self.x + x, y=self.y + y)


class BodySize(NamedTuple):
    """Length and width of a cell's body as measured in images [um]."""

    length: float
    width: float

    @property
    def area_um2(self) -> float:
        """Length times width [um^2], a measure for comparing the sizes of bodies and blobs."""
        return self.length * self.width


def _unknown_state() -> Floats:
    """Return a state (16,) of NaN, for a cell that the filter does not track."""
    return np.full(STATE_SIZE, np.nan)


@dataclass(frozen=True, slots=True)
class SeenCell:
    """The estimate of one tracked cell in one image.

    The default values describe a cell that no filter tracks.

    Attributes:
        identity: Number of the cell.
        track: Number of the cell's track.
        x: x of the centre of its body [um].
        y: y of the centre of its body [um].
        axis: Direction of its body [rad].
        heading: Direction of its helix's axis [rad], which turns by equation (3) of the paper.
        mean: Mean of the filter's state, shape (16,), in the order of `cells.helix`. NaN without a
            filter.
        sd: Standard deviations of the filter's state, shape (16,). NaN without a filter.
        probability: Probability that this is the cell with the number `identity`.
        has_blob: Whether a blob in the image belongs to the cell.
        merged: Whether that blob also contains other cells.
        long_um: Length of the body [um]. NaN if unknown.
        wide_um: Width of the body [um]. NaN if unknown.
        blob_um: x, y [um], axis [rad], length and width [um] of the blob, shape (5,). Length and
            width are NaN if the image's edge cuts the blob off. None if the cell has no blob.
    """

    identity: int
    track: int
    x: float
    y: float
    axis: float
    heading: float
    mean: Floats = field(default_factory=_unknown_state)
    sd: Floats = field(default_factory=_unknown_state)
    probability: float = 1.0
    has_blob: bool = True
    merged: bool = False
    long_um: float = math.nan
    wide_um: float = math.nan
    blob_um: Floats | None = None

    def on_blob(self) -> "SeenCell":
        """Return the cell with its centre moved onto its blob.

        If the centre is outside the blob's ellipse, it is moved towards the ellipse's centre, as
        far as the edge. If the image's edge cuts the blob off, the blob has no size, and the cell
        is placed at the blob's centre.
        """
        if self.blob_um is None:
            return self
        centre = self.blob_um[:2]
        offset = np.array((self.x, self.y)) - centre
        relative_distance = float(
            compute_distances_to_edge(offset, *np.nan_to_num(self.blob_um[2:], nan=POINT_UM))
        )
        if relative_distance <= 1.0:
            return self
        x, y = (centre + offset / relative_distance).tolist()
        return replace(self, x=x, y=y)


def compute_distances_to_edge(
    offsets: Floats, axes: Floats, lengths: Floats, widths: Floats
) -> Floats:
    """Compute the distances of points from the centres of ellipses, relative to the edges.

    Args:
        offsets: Offsets of the points from the centres, shape (..., 2).
        axes: Directions of the ellipses' long axes [rad].
        lengths: Lengths of the ellipses, in the unit of `offsets`.
        widths: Widths of the ellipses, in the unit of `offsets`.

    Returns:
        Each distance divided by the distance of the edge in the same direction: 1 on the edge, and
        less inside.
    """
    along = offsets[..., 0] * np.cos(axes) + offsets[..., 1] * np.sin(axes)
    across = offsets[..., 1] * np.cos(axes) - offsets[..., 0] * np.sin(axes)
    return np.hypot(2 * along / lengths, 2 * across / widths)


@dataclass(frozen=True, slots=True)
class TrackIdentity:
    """The identity of the cell on a track.

    Attributes:
        track: Number of the track.
        identity: Number of the cell.
        certainty: Probability that the track shows this cell.
        since_s: Time since when the cell has been on the track [s].
    """

    track: int
    identity: int
    certainty: float
    since_s: float


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """The most likely assignment of cells to tracks after cells have met.

    Attributes:
        tracks: The identity of the cell on each track.
        probability: Probability of this assignment.
        met_identities: Numbers of the cells that met.
    """

    tracks: tuple[TrackIdentity, ...]
    probability: float
    met_identities: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class CellBirth:
    """The first appearance of a cell, on a new track.

    Attributes:
        identity: Number of the cell.
        track: Number of the track.
        mother: Number of the cell from whose blob the new cell separated, if no other cell had
            entered that blob. Otherwise None.
    """

    identity: int
    track: int
    mother: int | None
