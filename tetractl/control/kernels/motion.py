"""Advances robots by one signal: the compiled step of a problem's motion in a loop over particles.

Arguments are rows of arrays (N, P): position x, y; cos and sin of the heading, advanced by
rotation. Then cos and sin of the direction u (P,), the same for every robot. `lanes` are the
constants of a motion; code is compiled for each class of them.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.model.motion.motion import PARAMETERS
from tetractl.model.motion.polynomials import onwards
from tetractl.model.motion.turn_rate import TURNING, all_in_rows, by_turning, is_left, turning
from tetractl.tools.kernels.kernel_options import INLINE_FAST, entries, inlined, one_of

parameters_of = entries(len(PARAMETERS) + len(TURNING))
rate = inlined(turning)
with_turning = inlined(by_turning)
turns_left = inlined(is_left)


class Flat(NamedTuple):
    """The arrays of a problem of N robots that do not depend on a sequence."""

    start: Floats  # (N, 3) x, y, heading
    turned: Floats  # (4, N) x, y, cos and sin of the heading
    parameters: Floats  # (N, 4) PARAMETERS and TURNING
    first: Any  # `Lanes` for the first signal, of robots that turn left, then of those right
    rest: Any  # `Lanes`, the same for the other signals; both have the same class
    drift: Floats  # (4, N) cos and sin of the bias, flow
    # (6, N): cos and sin of the bias, then x and y of the displacement by the flow in the first
    # period, then in each other one; (6, 0) without bias and flow
    displaced: Floats


@lru_cache(maxsize=2)  # the searches of one control step need the same arrays
def flat(problem: Problem) -> Flat:
    """Return a problem's arrays. Every call returns the same ones, which must not be changed."""
    poses = problem.poses
    parameters = all_in_rows(problem)
    times = problem.first_period, problem.period
    kind: Any = MOTIONS.load(problem.motion).lanes
    count = len(parameters)
    left_factor = np.exp(parameters[:, 2])  # of side
    drift = problem.drift
    twice = np.concatenate([parameters[:, :2], parameters[:, :2]])
    twice[:count, 0] *= left_factor
    twice[count:, 0] /= left_factor
    rest = kind.of(twice, times[1])
    first = rest if times[0] == times[1] else kind.of(twice, times[0])
    displaced = np.empty((6, 0))
    if problem.bias is not None or problem.flow is not None:
        displaced = np.concatenate([drift[:2], drift[2:] * times[0], drift[2:] * times[1]])
    turned = np.array([poses.x, poses.y, np.cos(poses.heading), np.sin(poses.heading)])
    return Flat(poses.array(), turned, parameters, first, rest, drift, displaced)


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
    """Advance robot i of every particle by one signal, given its parameters and the time."""


@overload(advance, jit_options=INLINE_FAST)
def _advance(lanes, x, y, cos, sin, cos_u, sin_u, i, robot, t):
    kind = lanes.instance_class
    step = inlined(kind.advance)
    constants_of = entries(kind.size)
    either = one_of(kind.size)
    whole = inlined(kind.differentiate)
    onwards_by = inlined(onwards)

    def advance(lanes, x, y, cos, sin, cos_u, sin_u, i, robot, t):
        k = constants_of(lanes.rows[i])
        right = constants_of(lanes.rows[i + x.shape[0]])
        if robot[3] < 1:
            for n in range(cos_u.size):
                c = cos[i, n]
                s = sin[i, n]
                cu = cos_u[n]
                su = sin_u[n]
                a = rate(c, s, cu, su, robot, t)[0]
                way = whole(c, s, cu, su, (a, robot[1]), t)[0]
                x[i, n], y[i, n], cos[i, n], sin[i, n] = onwards_by(x[i, n], y[i, n], c, s, way)
        else:
            for _ in range(lanes.pieces):
                for n in range(cos_u.size):
                    c = cos[i, n]
                    s = sin[i, n]
                    cu = cos_u[n]
                    su = sin_u[n]
                    side = either(turns_left(c, s, cu, su), k, right)
                    x[i, n], y[i, n], cos[i, n], sin[i, n] = step(
                        x[i, n], y[i, n], c, s, cu, su, side
                    )

    return advance


def turned(lanes: Any, c: Any, s: Any, cu: Any, su: Any, i: int, robot: Any, t: Any) -> Any:
    """Return cos and sin of the heading of robot i after one signal."""


@overload(turned, jit_options=INLINE_FAST)
def _turned(lanes, c, s, cu, su, i, robot, t):
    kind = lanes.instance_class
    step = inlined(kind.advance)
    constants_of = entries(kind.size)
    whole = inlined(kind.differentiate)
    onwards_by = inlined(onwards)

    def turned(lanes, c, s, cu, su, i, robot, t):
        x = 0.0
        y = 0.0
        if robot[3] < 1:
            a = rate(c, s, cu, su, robot, t)[0]
            x, y, c, s = onwards_by(x, y, c, s, whole(c, s, cu, su, (a, robot[1]), t)[0])
            return c, s
        k = constants_of(lanes.rows[i if turns_left(c, s, cu, su) else i + len(lanes.rows) // 2])
        for _ in range(lanes.pieces):
            x, y, c, s = step(x, y, c, s, cu, su, k)
        return c, s

    return turned


def derivatives(lanes: Any, c: Any, s: Any, cu: Any, su: Any, robot: Any, t: Any) -> Any:
    """Return one step of one robot with its own parameters and its derivatives, by the motion of
    `lanes`."""


@overload(derivatives, jit_options=INLINE_FAST)
def _derivatives(lanes, c, s, cu, su, robot, t):
    step = inlined(lanes.instance_class.differentiate)

    def derivatives(lanes, c, s, cu, su, robot, t):
        a, slopes = rate(c, s, cu, su, robot, t)
        return with_turning(step(c, s, cu, su, (a, robot[1]), t), slopes)

    return derivatives
