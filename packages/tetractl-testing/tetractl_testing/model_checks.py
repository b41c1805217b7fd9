"""Checks of a motion and of a shape.

The different forms of a motion must agree: its step, hold, compiled step and derivatives. The
corners of a shape must be drawable, and its edges must not cross.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats, wrap
from tetractl.core.setup import Setup
from tetractl.core.shape import meet, turn
from tetractl.model.motion.exact import rates
from tetractl.model.motion.motion import PARAMETERS, Held, Motion, XYHeading
from tetractl.spec.experiment import ShapeSection
from tetractl_testing.expect import COUNT, NEAR, SEED, expect, near, same, true

STEP = 1e-6
"""Step of a central difference: of an angle [rad], or relative of a parameter."""
SLOPE = 1e-4
"""Maximum relative error of a derivative against a central difference."""
STEP_S = 0.2
"""Duration of a step [s]."""
TURNED = 1.0
"""Angle by which headings and signals are turned together [rad]."""


@dataclass(frozen=True, slots=True)
class Cases:
    """COUNT random robots, each with a signal to follow.

    Attributes:
        x: x [length unit].
        y: y [length unit].
        heading: Headings [rad].
        u: Signals [rad].
        a: Turning rates [rad/s].
        v: Speeds [length unit/s].
    """

    x: Floats
    y: Floats
    heading: Floats
    u: Floats
    a: Floats
    v: Floats

    @property
    def reach(self) -> Floats:
        """Maximum distance that each robot can move in a step [length unit]."""
        return self.v * STEP_S

    @property
    def parameters(self) -> Floats:
        """The values of PARAMETERS for each robot, shape (COUNT, 2)."""
        return np.column_stack([self.a, self.v])

    def moved(self, motion: Motion, turned: float = 0.0, seconds: float = STEP_S) -> XYHeading:
        """Return the poses after a step.

        Args:
            motion: The motion.
            turned: Angle by which headings and signals are turned [rad].
            seconds: Duration of the step [s].
        """
        heading = self.heading + turned
        return motion.step(self.x, self.y, heading, self.u + turned, self.a, self.v, seconds)

    def distance(self, poses: XYHeading) -> Floats:
        """Return the distance that each robot has moved [length unit]."""
        return np.hypot(poses[0] - self.x, poses[1] - self.y)


def _random_cases() -> Cases:
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(-500, 500, (2, COUNT))
    heading, u = rng.uniform(-math.pi, math.pi, (2, COUNT))
    a = rng.uniform(0.5, 6, COUNT)
    v = rng.uniform(10, 300, COUNT)
    return Cases(x, y, heading, u, a, v)


def check_motion(motion: Motion) -> None:
    """Check the NumPy step, the `hold` of the simulation, the compiled step and its derivatives."""
    cases = _random_cases()
    moved = cases.moved(motion)
    _check_step(motion, cases, moved)
    _check_hold(motion, cases, moved)
    _check_advance(motion.lanes, cases, moved)
    _check_derivatives(motion, cases, moved)


def _check_step(motion: Motion, cases: Cases, moved: XYHeading) -> None:
    """Check the NumPy step, with which the robots have `moved`."""
    true("step: finite", np.isfinite(moved), "a pose is not finite")
    same("step: repeats exactly", moved, cases.moved(motion))
    distance = cases.distance(moved)
    in_reach = distance <= cases.reach * (1 + NEAR)
    true(
        "step: moves a robot by at most v t",
        in_reach,
        "a robot moves further than its speed allows",
    )
    in_no_time = cases.moved(motion, seconds=0.0)
    near("step: leaves x and y unchanged if t = 0", cases.distance(in_no_time), 0.0, cases.reach)
    turned = cases.moved(motion, turned=TURNED)
    towards = np.arctan2(moved[1] - cases.y, moved[0] - cases.x) + TURNED
    dx = distance * np.cos(towards)
    near("step: the motion turns with heading and u", turned[0] - cases.x, dx, cases.reach)


def _check_hold(motion: Motion, cases: Cases, moved: XYHeading) -> None:
    """Check that `hold` moves driven robots like the step, and no stationary robot."""
    _, _, turning = rates(cases.heading, cases.u, cases.a, cases.v)
    seconds = np.full(COUNT, STEP_S)
    driving = Held(cases.u, turning, cases.heading, np.ones(COUNT))
    driven = motion.hold(cases.x, cases.y, cases.heading, driving, cases.a, cases.v, seconds)
    near("hold: gives the same x as step", driven[0], moved[0], cases.reach)
    near("hold: gives the same y as step", driven[1], moved[1], cases.reach)
    standing = Held(cases.u, 0 * cases.u, cases.heading, np.zeros(COUNT))
    stood = motion.hold(cases.x, cases.y, cases.heading, standing, cases.a, 0 * cases.v, seconds)
    near("hold: does not move a stopped robot", cases.distance(stood), 0, cases.v)


def _check_advance(compiled: Any, cases: Cases, moved: XYHeading) -> None:
    """Check that the compiled step gives the same poses as `moved`, those of the NumPy step."""
    constants = compiled.of(cases.parameters, STEP_S)
    if constants.rows.shape != (COUNT, constants.size):
        expect("advance: rows", f"have the shape {constants.rows.shape} instead of (N, size)")
        return
    states = [_advanced(constants, cases, i) for i in range(COUNT)]
    x, y, cos_heading, sin_heading = np.array(states, dtype=float).T
    near("advance: gives the same x as step", x, moved[0], cases.reach)
    near("advance: gives the same y as step", y, moved[1], cases.reach)
    near("advance: gives the same cos(heading) as step", cos_heading, np.cos(moved[2]), 1.0)
    near("advance: gives the same sin(heading) as step", sin_heading, np.sin(moved[2]), 1.0)


def _advanced(constants: Any, cases: Cases, i: int) -> tuple[float, float, float, float]:
    """Return x, y, cos and sin of a robot's heading after all pieces of the compiled step."""
    cos_u = math.cos(cases.u[i])
    sin_u = math.sin(cases.u[i])
    heading = cases.heading[i]
    state = (cases.x[i], cases.y[i], math.cos(heading), math.sin(heading))
    for _ in range(constants.pieces):
        state = constants.advance(*state, cos_u, sin_u, constants.rows[i])
    return state


def _check_derivatives(motion: Motion, cases: Cases, moved: XYHeading) -> None:
    """Compare the compiled step and its derivatives with the NumPy step and its differences."""
    step, *derivatives = _differentiated(motion.lanes, cases)
    turned = wrap(moved[2] - cases.heading)
    near("differentiate: gives the same dx as step", step[0], moved[0] - cases.x, cases.reach)
    near("differentiate: gives the same dy as step", step[1], moved[1] - cases.y, cases.reach)
    near("differentiate: gives the same dheading as step", wrap(step[2] - turned), 0.0, 1.0)
    variables = ("dheading", "du", *(f"d(ln {name})" for name in PARAMETERS))
    for k, derivative in enumerate(derivatives):
        shift = STEP / 2 * np.eye(len(variables))[k]
        above = _shifted(motion, cases, shift)
        below = _shifted(motion, cases, -shift)
        scales = {"dx": cases.reach, "dy": cases.reach, "heading'": 1.0}
        for axis, (name, scale) in enumerate(scales.items()):
            slope = (above[axis] - below[axis]) / STEP
            what = f"differentiate: d({name})/{variables[k]}"
            near(what, derivative[axis], slope, scale, SLOPE)


def _differentiated(compiled: Any, cases: Cases) -> Floats:
    """Compute dx, dy, dheading of the compiled step and their derivatives, shape (4, 3, COUNT).

    The derivatives are with respect to the heading, u and each of PARAMETERS.
    """
    parameters = cases.parameters
    rows: list[Any] = []
    for i in range(COUNT):
        cos_heading = np.cos(cases.heading[i])
        sin_heading = np.sin(cases.heading[i])
        cos_u = np.cos(cases.u[i])
        sin_u = np.sin(cases.u[i])
        step, by_heading, by_u, by_parameters = compiled.differentiate(
            cos_heading, sin_heading, cos_u, sin_u, parameters[i], STEP_S
        )
        rows.append((step, by_heading, by_u, *by_parameters))
    return np.array(rows).transpose(1, 2, 0)


def _shifted(motion: Motion, cases: Cases, shift: Floats) -> XYHeading:
    """Compute the step of cases with a shifted heading, u and each of PARAMETERS.

    The logarithms of the parameters are shifted.
    """
    heading = cases.heading + shift[0]
    u = cases.u + shift[1]
    a = cases.a * math.exp(shift[2])
    v = cases.v * math.exp(shift[3])
    return motion.step(cases.x, cases.y, heading, u, a, v, STEP_S)


def check_shape(section: ShapeSection, setup: Setup) -> None:
    """Check the corners and the radius of a shape, and the outline and distances derived from them.

    If the corners are not an array (K, 2) of finite numbers, nothing further is checked.
    """
    shape = section.shape()
    corners = shape.corners
    count = len(corners)
    right = corners.shape == (count, 2) and count > 0 and bool(np.isfinite(corners).all())
    true("corners: an array (K, 2) of finite numbers", right, "is something else")
    true("radius: finite, at least 0", 0 <= shape.radius < np.inf, f"is {shape.radius}")
    if not right:
        return
    true("corners: edges do not cross", ~_crossed(corners), "two edges cross or touch")
    ends = np.roll(corners, -1, axis=0)
    onward = np.roll(ends, -1, axis=0)
    anticlockwise = turn(*corners.T, *ends.T, *onward.T) >= 0
    convex = anticlockwise | (shape.radius == 0)
    true("corners: are convex if there is a radius", convex, "turns right")
    outline = shape.outline()
    clockwise = "the outline encloses no area, or runs clockwise"
    after = np.roll(outline, -1, axis=0)
    twice_area = np.sum(outline[:, 0] * after[:, 1] - after[:, 0] * outline[:, 1])
    true("outline: anticlockwise", twice_area > 0, clockwise)
    size = float(np.ptp(outline, axis=0).max())
    gap = shape.distance(*outline.T)
    near("outline: has the corners at distance 0", gap, 0.0, size)


def _crossed(corners: Floats) -> Bools:
    """Check for each pair of edges between corners (K, 2) whether they cross.

    Edges that share a corner do not cross.
    """
    count = len(corners)
    ends = np.roll(corners, -1, axis=0)
    i, j = np.triu_indices(count, 2)
    apart = (j - i) % count < count - 1
    return meet(*corners[i].T, *ends[i].T, *corners[j].T, *ends[j].T) & apart
