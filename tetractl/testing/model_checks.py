"""Checks of a motion: its step, hold, compiled step and derivatives agree; and of a shape: its
corners can be drawn, and do not cross.
"""

import math
from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.core.shape import meet, turn
from tetractl.experiment.shape_section import ShapeSection
from tetractl.model.motion.exact import rates
from tetractl.model.motion.motion import PARAMETERS, Held, Motion, XYHeading
from tetractl.testing.finding import COUNT, NEAR, SEED, Finding, Findings, near, same, true

STEP = 1e-6  # step of a central difference [rad]


def check_motion(motion: Motion) -> Findings:
    """Check the NumPy step, the plant's `hold`, the compiled step and its derivatives."""
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(-500, 500, (2, COUNT))
    heading, u = rng.uniform(-math.pi, math.pi, (2, COUNT))
    a, v, t = rng.uniform(0.5, 6, COUNT), rng.uniform(10, 300, COUNT), 0.2
    case = (x, y, heading, u, a, v)
    moved = motion.step(*case, t)
    yield true("step: finite", np.isfinite(moved), "a pose is not finite")
    yield same("step: repeats exactly", moved, motion.step(*case, t))
    gone = np.hypot(moved[0] - x, moved[1] - y)
    yield true("step: moves by <= v t", gone <= v * t * (1 + NEAR), "a robot moves further")
    still = motion.step(*case, 0.0)
    yield near("step: keeps x, y if t = 0", np.hypot(still[0] - x, still[1] - y), 0.0, v * t)
    turned = motion.step(x, y, heading + 1.0, u + 1.0, a, v, t)
    angle = np.arctan2(moved[1] - y, moved[0] - x) + 1.0
    yield near("step: turns with heading and u", turned[0] - x, gone * np.cos(angle), v * t)
    held = Held(u, rates(heading, u, a, v)[2], heading, np.ones(COUNT))
    whole = np.full(COUNT, t)
    driven = motion.hold(x, y, heading, held, a, v, whole)
    for name, one, other in zip("xy", driven, moved, strict=False):
        yield near(f"hold: same {name} as step", one, other, v * t)
    resting = Held(u, 0 * u, heading, np.zeros(COUNT))
    stood = motion.hold(x, y, heading, resting, a, 0 * v, whole)
    yield near("hold: does not move a stopped robot", np.hypot(stood[0] - x, stood[1] - y), 0, v)
    compiled = motion.lanes
    yield from _check_advance(compiled, case, moved, t)
    yield from _check_derivatives(motion, compiled, case, moved, t)


def _check_advance(compiled: Any, case: Any, moved: Any, t: float) -> Findings:
    x, y, heading, u, a, v = case
    constants = compiled.of(np.column_stack([a, v]), t)
    if constants.rows.shape != (COUNT, constants.size):
        yield Finding("advance: rows", f"have shape {constants.rows.shape}, not (N, size)")
        return
    found = []
    for i in range(COUNT):
        state = (x[i], y[i], math.cos(heading[i]), math.sin(heading[i]))
        for _ in range(constants.pieces):
            state = constants.advance(*state, math.cos(u[i]), math.sin(u[i]), constants.rows[i])
        found.append(state)
    ends = np.array(found, dtype=float).T
    yield near("advance: same x as step", ends[0], moved[0], v * t)
    yield near("advance: same y as step", ends[1], moved[1], v * t)
    yield near("advance: same cos(heading) as step", ends[2], np.cos(moved[2]), 1.0)
    yield near("advance: same sin(heading) as step", ends[3], np.sin(moved[2]), 1.0)


def _check_derivatives(motion: Motion, compiled: Any, case: Any, moved: Any, t: float) -> Findings:
    x, y, heading, u, a, v = case
    cos_sin = (np.cos(heading), np.sin(heading), np.cos(u), np.sin(u))
    cases = zip(*cos_sin, np.column_stack([a, v]), strict=True)
    answers = [compiled.differentiate(*one, t) for one in cases]
    found = np.array([(step, heading, u, *more) for step, heading, u, more in answers]).T
    change = np.remainder(moved[2] - heading + math.pi, math.tau) - math.pi
    (dx, *by_x), (dy, *by_y), (turned, *by_turn) = found
    turn = np.remainder(turned - change + math.pi, math.tau) - math.pi
    yield near("differentiate: same dx as step", dx, moved[0] - x, v * t)
    yield near("differentiate: same dy as step", dy, moved[1] - y, v * t)
    yield near("differentiate: same dheading as step", turn, 0.0, 1.0)
    names = [f"d(ln {each.name})" if each.positive else f"d{each.name}" for each in PARAMETERS]

    def moves(shift: Floats) -> XYHeading:
        pairs = zip(PARAMETERS, (a, v), shift[2:], strict=True)
        own = [one * math.exp(by) if each.positive else one + by for each, one, by in pairs]
        return motion.step(x, y, heading + shift[0], u + shift[1], own[0], own[1], t)

    for k, by in enumerate(("dheading", "du", *names)):
        shift = STEP / 2 * np.eye(2 + len(names))[k]
        ends = zip(moves(shift), moves(-shift), (by_x, by_y, by_turn), strict=True)
        scales = {"dx": v * t, "dy": v * t, "heading'": 1.0}
        for (name, scale), (one, other, ours) in zip(scales.items(), ends, strict=True):
            slope = (one - other) / STEP
            yield near(f"differentiate: d({name})/{by}", ours[k], slope, scale, 1e-4)


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
