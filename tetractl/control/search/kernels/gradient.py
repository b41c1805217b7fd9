"""Predict the path of robots under a sequence of signals, and how each signal changes that path.

A signal u turns a robot and moves it by a displacement d(heading, u), called a step. `trace` stores
the partial derivatives of each step: the derivatives of d with respect to the heading and to u, and
`heading_kept`, the derivative of the next heading with respect to the heading. Because a robot's
turn depends only on u - heading, the derivative of the next heading with respect to u is 1 -
heading_kept. From these, `backpropagate` computes the derivatives of one position with respect to
all signals before it, with the chain rule backwards in time.

Only the headings depend on the step before. They are computed first. Then the steps of a robot are
independent of each other, and the loop over them becomes vector code. For this purpose, arrays over
the L signals are padded to M = padded_length(L) entries; the entries beyond the last signal have no
meaning. Each quantity is a separate array (N, M), because the compiler could not exclude an overlap
within a common array.
"""

from typing import NamedTuple

import numpy as np

from tetractl.control.search.kernels.motion import derivatives, robot_of, saturates, turned
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import sincos, wrap
from tetractl.model.motion.turn_rate import RobotParameters
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, PART_FAST, VECTOR_SIZE, inlined

NEVER_SATURATES = 1.0
"""The `saturation` of motors that always reach the turning rate of equation (3)."""

_sincos = inlined(sincos)
_wrap = inlined(wrap)


class Trace(NamedTuple):
    """The path of N robots under L signals, with the derivatives of its steps. `trace` fills it.

    Each array has M = padded_length(L) entries along the signals, M >= L, so that loops become
    vector code.
    """

    cos_u: Floats
    """Cosines of the signals, shape (M,)."""
    sin_u: Floats
    """Sines of the signals, shape (M,)."""
    cos: Floats
    """Cosines of the headings before each signal, shape (N, M)."""
    sin: Floats
    """Sines of the headings before each signal, shape (N, M)."""
    x: Floats
    """x of the robots after each signal [length unit], shape (N, M)."""
    y: Floats
    """y of the robots after each signal [length unit], shape (N, M)."""
    x_by_heading: Floats
    """Derivative of dx of each step with respect to the heading before it, shape (N, M)."""
    y_by_heading: Floats
    """Derivative of dy of each step with respect to the heading before it, shape (N, M)."""
    x_by_u: Floats
    """Derivative of dx of each step with respect to its signal [length unit/rad], shape (N, M)."""
    y_by_u: Floats
    """Derivative of dy of each step with respect to its signal [length unit/rad], shape (N, M)."""
    heading_kept: Floats
    """Derivative of the heading after each step with respect to the one before, shape (N, M)."""

    @classmethod
    def allocate(cls, robots: int, length: int) -> "Trace":
        """Allocate the arrays of a `Trace`, without a path, for numbers of robots and signals."""
        across = padded_length(length)
        shape = (robots, across)
        return cls(
            cos_u=np.ones(across),
            sin_u=np.zeros(across),
            cos=np.ones(shape),
            sin=np.zeros(shape),
            x=np.empty(shape),
            y=np.empty(shape),
            x_by_heading=np.empty(shape),
            y_by_heading=np.empty(shape),
            x_by_u=np.empty(shape),
            y_by_u=np.empty(shape),
            heading_kept=np.empty(shape),
        )


def padded_length(length: int) -> int:
    """Return the length of arrays for `length` signals: the next multiple of VECTOR_SIZE."""
    return -(-length // VECTOR_SIZE) * VECTOR_SIZE


@compiled(**PART_FAST)
def trace(u, problem, path):
    """Predict the path of robots under a sequence of signals, and the derivatives of its steps.

    Args:
        u: The signals [rad], shape (L,).
        problem: The problem, a `FlatProblem`.
        path: The `Trace` to fill.
    """
    for j in range(u.size):
        path.sin_u[j], path.cos_u[j] = _sincos(_wrap(u[j]))
    _compute_headings(u.size, problem, path)
    for i in range(len(problem.robots)):
        robot = robot_of(problem.robots, i)
        if saturates(robot):
            _compute_displacements(i, robot, problem, path)
        else:  # with a constant, so that the compiler leaves out what it does not need
            unsaturated = RobotParameters(robot.a, robot.speed, robot.side, NEVER_SATURATES)
            _compute_displacements(i, unsaturated, problem, path)
        _sum_displacements(i, u.size, problem, path)


@compiled(**INLINE_FAST)
def _compute_headings(length, problem, path):
    """Compute cosine and sine of each robot's heading before each of `length` signals."""
    first_lanes = problem.first_lanes
    later_lanes = problem.later_lanes
    robots = problem.robots
    bias_cos = problem.bias_cos
    bias_sin = problem.bias_sin
    cos_u = path.cos_u
    sin_u = path.sin_u
    cos = path.cos
    sin = path.sin
    for i in range(len(robots)):
        cos[i, 0] = problem.cos[i]
        sin[i, 0] = problem.sin[i]
    for j in range(length - 1):
        seconds = problem.first_period if j == 0 else problem.period
        for i in range(len(robots)):
            lanes = first_lanes if j == 0 else later_lanes
            robot = robot_of(robots, i)
            direction_cos = cos_u[j] * bias_cos[i] - sin_u[j] * bias_sin[i]
            direction_sin = sin_u[j] * bias_cos[i] + cos_u[j] * bias_sin[i]
            cos[i, j + 1], sin[i, j + 1] = turned(
                lanes, cos[i, j], sin[i, j], direction_cos, direction_sin, i, robot, seconds
            )


@compiled(**INLINE_FAST)
def _compute_displacements(i, robot, problem, path):
    """Compute the displacement of robot i by each signal, in x and y, and its derivatives.

    All signals are first computed as if each were held for a whole signal period, because vector
    code needs equal steps. The first signal is then computed again if it is held for another time.
    """
    n_recomputed = 0 if problem.first_period == problem.period else 1
    all_signals = (problem.period, path.cos.shape[1])
    first_signal = (problem.first_period, n_recomputed)
    bias_cos = problem.bias_cos[i]
    bias_sin = problem.bias_sin[i]
    cos_u = path.cos_u
    sin_u = path.sin_u
    cos = path.cos[i]
    sin = path.sin[i]
    x = path.x[i]
    y = path.y[i]
    x_by_heading = path.x_by_heading[i]
    y_by_heading = path.y_by_heading[i]
    x_by_u = path.x_by_u[i]
    y_by_u = path.y_by_u[i]
    heading_kept = path.heading_kept[i]
    for seconds, n_signals in (all_signals, first_signal):
        for j in range(n_signals):
            direction_cos = cos_u[j] * bias_cos - sin_u[j] * bias_sin
            direction_sin = sin_u[j] * bias_cos + cos_u[j] * bias_sin
            step, by_heading, by_u, _ = derivatives(
                problem.later_lanes, cos[j], sin[j], direction_cos, direction_sin, robot, seconds
            )
            x[j], y[j], _ = step
            x_by_heading[j], y_by_heading[j], heading_kept[j] = by_heading
            x_by_u[j], y_by_u[j], _ = by_u


@compiled(**INLINE_FAST)
def _sum_displacements(i, length, problem, path):
    """Turn the displacements of robot i into positions after each signal, including the flow."""
    x = path.x
    y = path.y
    flow_x = problem.flow[i, 0]
    flow_y = problem.flow[i, 1]
    x[i, 0] = problem.poses[i, 0] + x[i, 0] + flow_x * problem.first_period
    y[i, 0] = problem.poses[i, 1] + y[i, 0] + flow_y * problem.first_period
    for j in range(1, length):
        x[i, j] = x[i, j - 1] + x[i, j] + flow_x * problem.period
        y[i, j] = y[i, j - 1] + y[i, j] + flow_y * problem.period


@compiled(**PART_FAST)
def backpropagate(path, i, signal, east, north, row):
    """Add to `row` how much each signal moves a robot's later position along a given vector.

    Signal j moves the robot in its own step. It also turns the robot, by 1 - heading_kept.
    `by_heading` is the effect of the heading before step j + 1 on all later steps. It is known when
    the loop reaches j, because the loop runs backwards in time.

    Args:
        path: A filled `Trace`.
        i: Index of the robot.
        signal: The position after this signal counts.
        east: x of the vector.
        north: y of the vector.
        row: The derivatives are added to it, shape (L,).
    """
    by_heading = 0.0
    for j in range(signal, -1, -1):
        heading_kept = path.heading_kept[i, j]
        step_by_u = east * path.x_by_u[i, j] + north * path.y_by_u[i, j]
        step_by_heading = east * path.x_by_heading[i, j] + north * path.y_by_heading[i, j]
        row[j] += step_by_u + by_heading * (1 - heading_kept)
        by_heading = step_by_heading + by_heading * heading_kept
