"""Upright prisms as triangles: how obstacles of any outline are drawn."""

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats

Indices = NDArray[np.int64]


def prism(outline: Floats, height: float) -> tuple[Floats, Indices]:
    """Return corners (2 M, 3) and triangles (T, 3) of the walls and top over an outline (M, 2).

    The outline is simple and anticlockwise; the triangles are anticlockwise seen from outside.
    """
    count = len(outline)
    low, high = np.zeros((count, 1)), np.full((count, 1), height)
    corners = np.vstack([np.hstack([outline, low]), np.hstack([outline, high])])
    at, after = np.arange(count), np.roll(np.arange(count), -1)
    walls = np.vstack(
        [
            np.column_stack([at, after, after + count]),
            np.column_stack([at, after + count, at + count]),
        ]
    )
    return corners, np.vstack([walls, triangulate(outline) + count])


def triangulate(outline: Floats) -> Indices:
    """Return triangles (M - 2, 3) of a simple anticlockwise polygon (M, 2), by ear clipping.

    An ear is a corner that turns left and whose triangle holds no other corner.
    """
    left = list(range(len(outline)))
    triangles = []
    while len(left) > 3:
        ears = (i for i in range(len(left)) if _is_ear(outline, left, i))
        i = next(ears, 0)  # none only where rounding blurs nearly collinear corners: any may go
        triangles.append((left[i - 1], left[i], left[i + 1 - len(left)]))
        del left[i]
    return np.array([*triangles, left], dtype=np.int64)


def _is_ear(outline: Floats, left: list[int], i: int) -> bool:
    corner = [left[i - 1], left[i], left[i + 1 - len(left)]]
    a, b, c = outline[corner]
    if _turn(a, b, c) <= 0:
        return False
    others = outline[[k for k in left if k not in corner]]
    inside = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    return not inside.any()


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the signed area of triangles a, b, c (..., 2): positive if anticlockwise."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
