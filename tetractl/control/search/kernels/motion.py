"""Access of compiled code to a control problem and to the robots' motion.

A problem's objects become arrays (`FlatProblem`), which compiled code can read. How robots move is
defined by the problem's motion (`tetractl.model.motion`). Its constants have a class of their own,
which is a type to the compiler: code is compiled for each. `advance`, `turned` and `derivatives`
are the three ways to ask a motion; Python sees only these three names. In place of each, the
compiler uses the function below it, which has the same name with an underscore.

Directions and headings are given by their cosine and sine: c, s of the heading, cu, su of the
direction u.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from tetractl.control.search.kernels.obstacles import ObstacleArrays, arrays_of
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.model.motion.polynomials import onwards
from tetractl.model.motion.turn_rate import (
    RobotParameters,
    add_turning_derivatives,
    compute_turning_rate,
    is_left,
    parameters_in_rows,
)
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import (
    INLINE_FAST,
    create_entry_reader,
    create_selector,
    inlined,
)

turning_rate = inlined(compute_turning_rate)
with_turning = inlined(add_turning_derivatives)
turns_left = inlined(is_left)


class FlatProblem(NamedTuple):
    """The problem of one control step as plain arrays and numbers, lengths in the spec's unit."""

    poses: Floats
    """x, y [length unit] and heading [rad] of the robots at the start, shape (N, 3)."""
    cos: Floats
    """Cosines of the headings at the start, shape (N,)."""
    sin: Floats
    """Sines of the headings at the start, shape (N,)."""
    targets: Floats
    """x and y of each robot's target [length unit], shape (N, 2)."""
    robots: Floats
    """`RobotParameters` of each robot, one row each, shape (N, 4)."""
    drifts: bool
    """Whether the problem has a bias or a flow."""
    bias_cos: Floats
    """Cosine of the bias that is added to each direction for each robot, shape (N,)."""
    bias_sin: Floats
    """Sine of that bias, shape (N,)."""
    flow: Floats
    """Flow that carries each robot, along x and y [length unit/s], shape (N, 2)."""
    first_period: float
    """How long the first signal is held [s]."""
    period: float
    """How long each later signal is held [s]."""
    first_lanes: Any
    """Constants of the motion during the first signal, as the motion's `Lanes`.

    They have 2N rows: the robots when they turn left, then the same robots turning right.
    """
    later_lanes: Any
    """Constants of the motion during the later signals, as an object of the same class."""
    obstacles: ObstacleArrays
    obstacle_weight: float
    """Weight omega_p of contacts in the paper's equation (7) [length unit]."""
    swept: bool
    """Whether paths between predicted positions must also be clear of obstacles."""
    separation: float
    """Minimum distance of two robots [length unit]. 0 if robots may meet."""


@lru_cache(maxsize=2)  # the searches of one control step need the same arrays
def flatten(problem: Problem) -> FlatProblem:
    """Convert a problem to arrays for compiled code.

    Repeated calls share them: do not change them.
    """
    heading = problem.poses.heading
    robots = parameters_in_rows(problem)
    count = len(robots)
    lanes_class: Any = MOTIONS.load(problem.motion).lanes
    side_factor = elementwise.exp(robots[:, 2])
    left_and_right = np.concatenate([robots[:, :2], robots[:, :2]])
    left_and_right[:count, 0] *= side_factor
    left_and_right[count:, 0] /= side_factor
    later_lanes = lanes_class.of(left_and_right, problem.period)
    first_lanes = later_lanes
    if problem.first_period != problem.period:
        first_lanes = lanes_class.of(left_and_right, problem.first_period)
    bias_cos, bias_sin, flow_x, flow_y = problem.drift
    return FlatProblem(
        poses=problem.poses.array(),
        cos=elementwise.cos(heading),
        sin=elementwise.sin(heading),
        targets=np.ascontiguousarray(problem.targets),
        robots=robots,
        drifts=problem.bias is not None or problem.flow is not None,
        bias_cos=bias_cos,
        bias_sin=bias_sin,
        flow=np.column_stack([flow_x, flow_y]),
        first_period=float(problem.first_period),
        period=float(problem.period),
        first_lanes=first_lanes,
        later_lanes=later_lanes,
        obstacles=arrays_of(problem.obstacles),
        obstacle_weight=float(problem.obstacle_weight),
        swept=problem.swept,
        separation=float(problem.separation),
    )


@compiled(**INLINE_FAST)
def robot_of(robots, i):
    """Return the parameters of robot i: its turning rate a, speed, side and saturation.

    They are row i of `robots`, shape (N, 4).
    """
    return RobotParameters(robots[i, 0], robots[i, 1], robots[i, 2], robots[i, 3])


@compiled(**INLINE_FAST)
def saturates(robot):
    """Check whether a robot's motors limit how fast it turns, so that equation (3) may not hold."""
    return robot.saturation < 1


def advance(
    lanes: Any,
    x: Any,
    y: Any,
    cos: Any,
    sin: Any,
    cos_u: Any,
    sin_u: Any,
    i: int,
    robot: Any,
    t: Any,
) -> None:
    """Move robot i of every particle by one signal.

    A particle is one of many sequences tried at once.

    Args:
        lanes: Constants of the motion.
        x: x of the robots, shape (N, P), changed in place.
        y: y of the robots, shape (N, P), changed in place.
        cos: Cosine of their headings, shape (N, P), changed in place.
        sin: Sine of their headings, shape (N, P), changed in place.
        cos_u: Cosine of each particle's direction, shape (P,).
        sin_u: Sine of each particle's direction, shape (P,).
        i: Index of the robot.
        robot: Its parameters.
        t: Duration of the signal [s].
    """


@overload(advance, jit_options=INLINE_FAST)
def _advance(lanes, x, y, cos, sin, cos_u, sin_u, i, robot, t):
    kind = lanes.instance_class
    step = inlined(kind.advance)
    constants_of = create_entry_reader(kind.size)
    either = create_selector(kind.size)
    whole_step = inlined(kind.differentiate)
    moved_by = inlined(onwards)

    def advance(lanes, x, y, cos, sin, cos_u, sin_u, i, robot, t):
        if saturates(robot):
            for n in range(cos_u.size):
                c = cos[i, n]
                s = sin[i, n]
                cu = cos_u[n]
                su = sin_u[n]
                a = turning_rate(c, s, cu, su, robot, t)[0]
                way = whole_step(c, s, cu, su, (a, robot.speed), t)[0]
                x[i, n], y[i, n], cos[i, n], sin[i, n] = moved_by(x[i, n], y[i, n], c, s, way)
            return
        left = constants_of(lanes.rows[i])
        right = constants_of(lanes.rows[i + x.shape[0]])
        for _ in range(lanes.pieces):
            for n in range(cos_u.size):
                c = cos[i, n]
                s = sin[i, n]
                cu = cos_u[n]
                su = sin_u[n]
                side = either(turns_left(c, s, cu, su), left, right)
                x[i, n], y[i, n], cos[i, n], sin[i, n] = step(x[i, n], y[i, n], c, s, cu, su, side)

    return advance


def turned(lanes: Any, c: Any, s: Any, cu: Any, su: Any, i: int, robot: Any, t: Any) -> Any:
    """Compute the heading of a robot after one signal.

    Args:
        lanes: Constants of the motion.
        c: Cosine of the heading.
        s: Sine of the heading.
        cu: Cosine of the direction.
        su: Sine of the direction.
        i: Index of the robot.
        robot: Its parameters.
        t: Duration of the signal [s].

    Returns:
        Cosine and sine of the heading.
    """


@overload(turned, jit_options=INLINE_FAST)
def _turned(lanes, c, s, cu, su, i, robot, t):
    kind = lanes.instance_class
    step = inlined(kind.advance)
    constants_of = create_entry_reader(kind.size)
    whole_step = inlined(kind.differentiate)
    moved_by = inlined(onwards)

    def turned(lanes, c, s, cu, su, i, robot, t):
        x = 0.0
        y = 0.0
        if saturates(robot):
            a = turning_rate(c, s, cu, su, robot, t)[0]
            way = whole_step(c, s, cu, su, (a, robot.speed), t)[0]
            x, y, c, s = moved_by(x, y, c, s, way)
            return c, s
        side = i if turns_left(c, s, cu, su) else i + len(lanes.rows) // 2
        constants = constants_of(lanes.rows[side])
        for _ in range(lanes.pieces):
            x, y, c, s = step(x, y, c, s, cu, su, constants)
        return c, s

    return turned


def derivatives(lanes: Any, c: Any, s: Any, cu: Any, su: Any, robot: Any, t: Any) -> Any:
    """Compute the `Derivatives` of one signal for one robot.

    Args:
        lanes: Constants of the motion.
        c: Cosine of the heading.
        s: Sine of the heading.
        cu: Cosine of the direction.
        su: Sine of the direction.
        robot: The robot's parameters.
        t: Duration of the signal [s].
    """


@overload(derivatives, jit_options=INLINE_FAST)
def _derivatives(lanes, c, s, cu, su, robot, t):
    step = inlined(lanes.instance_class.differentiate)

    def derivatives(lanes, c, s, cu, su, robot, t):
        a, slopes = turning_rate(c, s, cu, su, robot, t)
        return with_turning(step(c, s, cu, su, (a, robot.speed), t), slopes)

    return derivatives
