"""Checks of a shape: its geometry in NumPy agrees with its outline and its compiled functions."""

from typing import Any

import numpy as np

from tetractl.core.setup import Setup
from tetractl.experiment.shape_section import ShapeSection
from tetractl.kind_checks.finding import COUNT, NEAR, SEED, Finding, Findings, near, true


def check_shape(shape: ShapeSection, setup: Setup) -> Findings:
    """Check the NumPy geometry of a shape against its outline and its compiled functions."""
    corners = shape.outline()
    size = float(np.ptp(corners, axis=0).max())
    rng = np.random.default_rng(SEED)
    low, high = corners.min(axis=0) - size / 2, corners.max(axis=0) + size / 2
    x, y, x1, y1 = (rng.uniform(low[i % 2], high[i % 2], COUNT) for i in range(4))
    rolled = np.roll(corners, -1, axis=0)
    area = 0.5 * float(np.sum(corners[:, 0] * rolled[:, 1] - rolled[:, 0] * corners[:, 1]))
    yield true("outline: anticlockwise", area > 0, "encloses no area, or runs clockwise")
    yield near("outline: corners at distance 0", shape.distance(*corners.T), 0.0, size)
    for margin in (0.0, size / 10):
        grown = shape.grown(margin)
        what = "grown: " if margin else ""
        inside, gap = grown.contain(x, y), grown.distance(x, y)
        clear = np.abs(gap) > NEAR * size  # closer to the edge, rounding decides
        yield true(
            f"{what}contain: true where distance <= 0", (inside == (gap <= 0)) | ~clear, "differs"
        )
        met = grown.cross(x, y, x1, y1)
        ends = inside | grown.contain(x1, y1)
        yield true(f"{what}cross: true for segments with an end inside", met | ~ends, "false")
        along = np.linspace(0, 1, 50)[:, None]
        seen = grown.distance(x + along * (x1 - x), y + along * (y1 - y)).min(axis=0)
        yield true(
            f"{what}cross: true for segments through the shape",
            met | (seen > -NEAR * size),
            "false",
        )
        length = np.hypot(x1 - x, y1 - y)
        yield true(f"{what}cross: false for segments outside", ~met | (seen < length / 50), "true")
        yield from _check_packed(what, grown, size, (x, y, x1, y1), gap, met, clear)
    margin = size / 10
    gap, nearer = (one.distance(x, y) for one in (shape, shape.grown(margin)))
    fits = np.abs(gap - nearer - margin) <= margin / 2  # a grown corner may be sharp
    yield true("grown: edge moved by the margin", (gap < 2 * margin) | fits, "differs")


def _check_packed(
    what: str, shape: Any, size: float, points: Any, gap: Any, met: Any, clear: Any
) -> Findings:
    packed, row = shape.packed, tuple(map(float, shape.row()))
    rows = np.asarray(row) if packed.size is None else row
    if packed.size not in (None, len(row)):
        yield Finding(f"{what}packed: size", f"is {packed.size}, but row has {len(row)} numbers")
        return
    cases = [tuple(map(float, case)) for case in zip(*points, strict=True)]
    inside = np.array([packed.gap(px, py, rows) <= 0 for px, py, _, _ in cases])
    yield true(f"{what}packed.gap: at most 0 inside", (inside == (gap <= 0)) | ~clear, "differs")
    between = np.array([packed.gap_between(*case, rows) <= 0 for case in cases])
    yield true(f"{what}packed.gap_between: <= 0 where cross is true", between == met, "differs")
    deep = gap < -NEAR * size
    depth = np.array([packed.depth(px, py, rows) for px, py, _, _ in cases])
    yield near(f"{what}packed.depth: equals -distance inside", depth[deep], -gap[deep], size)
    out = np.array([packed.outward(px, py, rows) for px, py, _, _ in cases])
    yield near(f"{what}packed.outward: a unit vector", np.hypot(*out.T)[deep], 1.0, 1.0)
