"""Checks of a shape: its corners can be drawn, and do not cross."""

import numpy as np

from tetractl.core.setup import Setup
from tetractl.core.shape import meet, turn
from tetractl.experiment.shape_section import ShapeSection
from tetractl.kind_checks.finding import Findings, near, true


def check_shape(section: ShapeSection, setup: Setup) -> Findings:
    """Check the corners and the radius of a shape; everything else is derived from them."""
    shape = section.shape()
    corners, count = shape.corners, len(shape.corners)
    right = corners.shape == (count, 2) and count > 0 and bool(np.isfinite(corners).all())
    yield true("corners: an array (K, 2) of finite numbers", right, "is something else")
    yield true("radius: finite, at least 0", 0 <= shape.radius < np.inf, f"is {shape.radius}")
    if not right:
        return
    ends = np.roll(corners, -1, axis=0)
    i, j = np.triu_indices(count, 2)
    apart = (j - i) % count < count - 1  # edges that do not share a corner
    crossed = meet(*corners[i].T, *ends[i].T, *corners[j].T, *ends[j].T) & apart
    yield true("corners: edges do not cross", ~crossed, "two edges cross or touch")
    left = turn(*corners.T, *ends.T, *np.roll(ends, -1, axis=0).T) >= 0
    yield true("corners: convex if there is a radius", left | (shape.radius == 0), "turns right")
    outline = shape.outline()
    rolled = np.roll(outline, -1, axis=0)
    area = 0.5 * float(np.sum(outline[:, 0] * rolled[:, 1] - rolled[:, 0] * outline[:, 1]))
    yield true("outline: anticlockwise", area > 0, "encloses no area, or runs clockwise")
    size = float(np.ptp(outline, axis=0).max())
    gap = shape.distance(*outline.T)
    yield near("outline: corners at distance 0", gap, 0.0, size)
