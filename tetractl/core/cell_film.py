"""Crops of a microscope's pictures, logged together with the poses of the cells found in them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, Grey

Integers = NDArray[np.int64]
SURE = 0.9
"""Least probability of a cell's identity; below it the cell counts as unknown."""


@dataclass(frozen=True, slots=True)
class CellFilm:
    """One picture of a camera that tracks cells, as stored in a log.

    `crops` (K, T, T) are cut out of the picture minus its background, so that the search for
    contours can be repeated; the upper left pixel of each is at `corners` (K, 2), column and row.
    `blobs` (K, 6) are the blobs found in the crops: x, y [px], axis [rad], length, width [px],
    strength [grey levels]. `robots` (K,) are the indices of the robots, -1 for a cell that is no
    robot; `merged` (K,) is True for a cell that shares its blob with another cell. `limits` (4,)
    are the search's low and high threshold [grey levels] and least and greatest area [px^2].
    `sure` (N,) is the probability that the cell followed as each robot is still the robot's cell,
    NaN if the cell is not seen. `whole` is the picture itself and `background` the picture
    subtracted from it, both None except in some frames.
    """

    sampled_ns: int
    crops: Grey
    corners: Integers
    blobs: Floats
    robots: Integers
    merged: Bools
    limits: tuple[float, ...]
    sure: Floats
    whole: Grey | None = None
    background: Grey | None = None


def cut(picture: Grey, column: int, row: int, side: int) -> NDArray[np.uint8]:
    """Return the square of `side` pixels whose upper left pixel is at `column` and `row`; pixels
    outside the picture are 0."""
    found = np.zeros((side, side), np.uint8)
    left, top = max(column, 0), max(row, 0)
    part = picture[top : max(row + side, 0), left : max(column + side, 0)]
    found[top - row : top - row + part.shape[0], left - column : left - column + part.shape[1]] = (
        part
    )
    return found
