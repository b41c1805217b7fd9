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
from tetractl.core.shape import segments_meet, signed_double_area
from tetractl.model.motion.exact import rates
from tetractl.model.motion.motion import PARAMETERS, Held, Motion, XYHeading
from tetractl.spec.experiment import ShapeSection
from tetractl_testing.expect import (
    COUNT,
    SEED,
    TOLERANCE,
    expect,
    expect_near,
    expect_same,
    expect_true,
)

DIFFERENCE = 1e-6
"""Step of a central difference: of an angle [rad], or relative of a parameter."""
SLOPE_ERROR_MAX = 1e-4
"""Maximum relative error of a derivative against a central difference."""
STEP_S = 0.2
"""Duration of a step [s]."""
TURNED_BY = 1.0
"""Angle by which headings and signals are turned together [rad]."""


@dataclass(frozen=True, slots=True)
class RandomRobots:
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

    def step(self, motion: Motion, turned: float = 0.0, seconds: float = STEP_S) -> XYHeading:
        """Compute the robots' poses after a step.

        Args:
            motion: The motion.
            turned: Angle by which headings and signals are turned [rad].
            seconds: Duration of the step [s].
        """
        heading = self.heading + turned
        return motion.step(self.x, self.y, heading, self.u + turned, self.a, self.v, seconds)

    def distance(self, poses: XYHeading) -> Floats:
        """Compute the distance from each robot to its pose after a step [length unit]."""
        return np.hypot(poses[0] - self.x, poses[1] - self.y)


def _random_robots() -> RandomRobots:
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(-500, 500, (2, COUNT))
    heading, u = rng.uniform(-math.pi, math.pi, (2, COUNT))
    a = rng.uniform(0.5, 6, COUNT)
    v = rng.uniform(10, 300, COUNT)
    return RandomRobots(x, y, heading, u, a, v)


def check_motion(motion: Motion) -> None:
    """Check the NumPy step, the `hold` of the simulation, the compiled step and its derivatives."""
    robots = _random_robots()
    stepped = robots.step(motion)
    _check_step(motion, robots, stepped)
    _check_hold(motion, robots, stepped)
    _check_advance(motion.lanes, robots, stepped)
    _check_derivatives(motion, robots, stepped)


def _check_step(motion: Motion, robots: RandomRobots, stepped: XYHeading) -> None:
    """Check the NumPy step of a motion, which moved the robots to the poses `stepped`."""
    expect_true("step: finite", np.isfinite(stepped), "a pose is not finite")
    expect_same("step: repeats exactly", stepped, robots.step(motion))
    distance = robots.distance(stepped)
    in_reach = distance <= robots.reach * (1 + TOLERANCE)
    expect_true(
        "step: moves a robot by at most v t",
        in_reach,
        "a robot moves further than its speed allows",
    )
    unmoved_poses = robots.step(motion, seconds=0.0)
    expect_near(
        "step: leaves x and y unchanged if t = 0", robots.distance(unmoved_poses), 0.0, robots.reach
    )
    turned_poses = robots.step(motion, turned=TURNED_BY)
    turned_course = np.arctan2(stepped[1] - robots.y, stepped[0] - robots.x) + TURNED_BY
    dx = distance * np.cos(turned_course)
    expect_near(
        "step: the motion turns with heading and u", turned_poses[0] - robots.x, dx, robots.reach
    )


def _check_hold(motion: Motion, robots: RandomRobots, stepped: XYHeading) -> None:
    """Check that `hold` moves driven robots like the step, and no stationary robot."""
    _, _, turning = rates(robots.heading, robots.u, robots.a, robots.v)
    seconds = np.full(COUNT, STEP_S)
    driving = Held(robots.u, turning, robots.heading, np.ones(COUNT))
    driven_poses = motion.hold(
        robots.x, robots.y, robots.heading, driving, robots.a, robots.v, seconds
    )
    expect_near("hold: gives the same x as step", driven_poses[0], stepped[0], robots.reach)
    expect_near("hold: gives the same y as step", driven_poses[1], stepped[1], robots.reach)
    standing = Held(robots.u, 0 * robots.u, robots.heading, np.zeros(COUNT))
    standing_poses = motion.hold(
        robots.x, robots.y, robots.heading, standing, robots.a, 0 * robots.v, seconds
    )
    expect_near("hold: does not move a stopped robot", robots.distance(standing_poses), 0, robots.v)


def _check_advance(compiled: Any, robots: RandomRobots, stepped: XYHeading) -> None:
    """Check that the compiled step gives the same poses as the NumPy step, `stepped`."""
    constants = compiled.of(robots.parameters, STEP_S)
    if constants.rows.shape != (COUNT, constants.size):
        expect("advance: rows", f"have the shape {constants.rows.shape} instead of (N, size)")
        return
    states = [_compiled_step(constants, robots, i) for i in range(COUNT)]
    x, y, cos_heading, sin_heading = np.array(states, dtype=float).T
    expect_near("advance: gives the same x as step", x, stepped[0], robots.reach)
    expect_near("advance: gives the same y as step", y, stepped[1], robots.reach)
    expect_near(
        "advance: gives the same cos(heading) as step", cos_heading, np.cos(stepped[2]), 1.0
    )
    expect_near(
        "advance: gives the same sin(heading) as step", sin_heading, np.sin(stepped[2]), 1.0
    )


def _compiled_step(
    constants: Any, robots: RandomRobots, i: int
) -> tuple[float, float, float, float]:
    """Compute x, y, cos and sin of robot i's heading after all pieces of the compiled step."""
    cos_u = math.cos(robots.u[i])
    sin_u = math.sin(robots.u[i])
    heading = robots.heading[i]
    state = (robots.x[i], robots.y[i], math.cos(heading), math.sin(heading))
    for _ in range(constants.pieces):
        state = constants.advance(*state, cos_u, sin_u, constants.rows[i])
    return state


def _check_derivatives(motion: Motion, robots: RandomRobots, stepped: XYHeading) -> None:
    """Compare the compiled step and its derivatives with the NumPy step and its differences."""
    step, *derivatives = _compiled_derivatives(motion.lanes, robots)
    turns = wrap(stepped[2] - robots.heading)
    expect_near(
        "differentiate: gives the same dx as step", step[0], stepped[0] - robots.x, robots.reach
    )
    expect_near(
        "differentiate: gives the same dy as step", step[1], stepped[1] - robots.y, robots.reach
    )
    expect_near("differentiate: gives the same dheading as step", wrap(step[2] - turns), 0.0, 1.0)
    variables = ("dheading", "du", *(f"d(ln {name})" for name in PARAMETERS))
    for k, derivative in enumerate(derivatives):
        shift = DIFFERENCE / 2 * np.eye(len(variables))[k]
        raised = _step_of_shifted(motion, robots, shift)
        lowered = _step_of_shifted(motion, robots, -shift)
        scales = {"dx": robots.reach, "dy": robots.reach, "heading'": 1.0}
        for axis, (name, scale) in enumerate(scales.items()):
            slope = (raised[axis] - lowered[axis]) / DIFFERENCE
            check = f"differentiate: d({name})/{variables[k]}"
            expect_near(check, derivative[axis], slope, scale, SLOPE_ERROR_MAX)


def _compiled_derivatives(compiled: Any, robots: RandomRobots) -> Floats:
    """Compute dx, dy, dheading of the compiled step and their derivatives, shape (4, 3, COUNT).

    The derivatives are with respect to the heading, u and each of PARAMETERS.
    """
    parameters = robots.parameters
    rows: list[Any] = []
    for i in range(COUNT):
        cos_heading = np.cos(robots.heading[i])
        sin_heading = np.sin(robots.heading[i])
        cos_u = np.cos(robots.u[i])
        sin_u = np.sin(robots.u[i])
        step, by_heading, by_u, by_parameters = compiled.differentiate(
            cos_heading, sin_heading, cos_u, sin_u, parameters[i], STEP_S
        )
        rows.append((step, by_heading, by_u, *by_parameters))
    return np.array(rows).transpose(1, 2, 0)


def _step_of_shifted(motion: Motion, robots: RandomRobots, shift: Floats) -> XYHeading:
    """Compute the step of cases with a shifted heading, u and each of PARAMETERS.

    The logarithms of the parameters are shifted.
    """
    heading = robots.heading + shift[0]
    u = robots.u + shift[1]
    a = robots.a * math.exp(shift[2])
    v = robots.v * math.exp(shift[3])
    return motion.step(robots.x, robots.y, heading, u, a, v, STEP_S)


def check_shape(section: ShapeSection, setup: Setup) -> None:
    """Check the corners and the radius of a shape, and the outline and distances derived from them.

    If the corners are not an array (K, 2) of finite numbers, nothing further is checked.
    """
    shape = section.shape()
    corners = shape.corners
    count = len(corners)
    is_array = corners.shape == (count, 2) and count > 0 and bool(np.isfinite(corners).all())
    expect_true("corners: an array (K, 2) of finite numbers", is_array, "is something else")
    expect_true("radius: finite, at least 0", 0 <= shape.radius < np.inf, f"is {shape.radius}")
    if not is_array:
        return
    expect_true(
        "corners: edges do not cross", ~_find_crossing_edges(corners), "two edges cross or touch"
    )
    next_corners = np.roll(corners, -1, axis=0)
    corners_after_next = np.roll(next_corners, -1, axis=0)
    is_anticlockwise = signed_double_area(*corners.T, *next_corners.T, *corners_after_next.T) >= 0
    is_convex = is_anticlockwise | (shape.radius == 0)
    expect_true("corners: are convex if there is a radius", is_convex, "turns right")
    outline = shape.outline()
    message = "the outline encloses no area, or runs clockwise"
    next_points = np.roll(outline, -1, axis=0)
    twice_area = np.sum(outline[:, 0] * next_points[:, 1] - next_points[:, 0] * outline[:, 1])
    expect_true("outline: anticlockwise", twice_area > 0, message)
    largest_extent = float(np.ptp(outline, axis=0).max())
    gap = shape.distance(*outline.T)
    expect_near("outline: has the corners at distance 0", gap, 0.0, largest_extent)


def _find_crossing_edges(corners: Floats) -> Bools:
    """Check for each pair of edges between corners (K, 2) whether they cross.

    Edges that share a corner do not cross.
    """
    count = len(corners)
    next_corners = np.roll(corners, -1, axis=0)
    i, j = np.triu_indices(count, 2)
    has_no_common_corner = (j - i) % count < count - 1
    return (
        segments_meet(*corners[i].T, *next_corners[i].T, *corners[j].T, *next_corners[j].T)
        & has_no_common_corner
    )
