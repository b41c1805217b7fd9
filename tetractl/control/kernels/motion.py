"""Advances robots by one signal: the compiled step of a problem's motion in a loop over particles.

Arguments are rows of arrays (N, P): position x, y; cos and sin of the heading, advanced by
rotation. Then cos and sin of the direction u (P,), the same for every robot. `lanes` are the
constants of a motion; code is compiled for each class of them.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from tetractl.core.kernels.kernel_options import INLINE_FAST, entries, inlined, one_of
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.model.motion.motion import PARAMETERS
from tetractl.model.motion.polynomials import onwards
from tetractl.model.motion.turn_rate import TURNING, all_in_rows, by_turning, is_left, turning

parameters_of = entries(len(PARAMETERS) + len(TURNING))
rate, complete, left = inlined(turning), inlined(by_turning), inlined(is_left)


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
    p, parameters = problem.poses, all_in_rows(problem)
    times = problem.first_period, problem.period
    kind: Any = MOTIONS.load(problem.motion).lanes
    count, more, drift = len(parameters), np.exp(parameters[:, 2]), problem.drift
    both = np.concatenate([parameters[:, :2], parameters[:, :2]])
    both[:count, 0] *= more
    both[count:, 0] /= more
    rest = kind.of(both, times[1])
    first = rest if times[0] == times[1] else kind.of(both, times[0])
    displaced = np.empty((6, 0))
    if problem.bias is not None or problem.flow is not None:
        displaced = np.concatenate([drift[:2], drift[2:] * times[0], drift[2:] * times[1]])
    turned = np.array([p.x, p.y, np.cos(p.heading), np.sin(p.heading)])
    return Flat(p.array(), turned, parameters, first, rest, drift, displaced)


def advance(
    lanes: Any, x: Any, y: Any, cos: Any, sin: Any, cos_u: Any, sin_u: Any, i: int, own: Any, t: Any
) -> None:
    """Advance robot i of every particle by one signal, given its parameters and the time."""


@overload(advance, jit_options=INLINE_FAST)
def _advance(lanes, x, y, cos, sin, cos_u, sin_u, i, own, t):
    kind = lanes.instance_class
    step, constants_of, either = inlined(kind.advance), entries(kind.size), one_of(kind.size)
    whole, on = inlined(kind.differentiate), inlined(onwards)

    def advance(lanes, x, y, cos, sin, cos_u, sin_u, i, own, t):
        k, right = constants_of(lanes.rows[i]), constants_of(lanes.rows[i + x.shape[0]])
        if own[3] < 1:
            for n in range(cos_u.size):
                c, s, cu, su = cos[i, n], sin[i, n], cos_u[n], sin_u[n]
                a = rate(c, s, cu, su, own, t)[0]
                found = whole(c, s, cu, su, (a, own[1]), t)[0]
                x[i, n], y[i, n], cos[i, n], sin[i, n] = on(x[i, n], y[i, n], c, s, found)
        else:
            for _ in range(lanes.pieces):
                for n in range(cos_u.size):
                    c, s, cu, su = cos[i, n], sin[i, n], cos_u[n], sin_u[n]
                    side = either(left(c, s, cu, su), k, right)
                    x[i, n], y[i, n], cos[i, n], sin[i, n] = step(
                        x[i, n], y[i, n], c, s, cu, su, side
                    )

    return advance


def turned(lanes: Any, c: Any, s: Any, cu: Any, su: Any, i: int, own: Any, t: Any) -> Any:
    """Return cos and sin of the heading of robot i after one signal."""


@overload(turned, jit_options=INLINE_FAST)
def _turned(lanes, c, s, cu, su, i, own, t):
    kind = lanes.instance_class
    step, constants_of = inlined(kind.advance), entries(kind.size)
    whole, on = inlined(kind.differentiate), inlined(onwards)

    def turned(lanes, c, s, cu, su, i, own, t):
        x, y = 0.0, 0.0
        if own[3] < 1:
            a = rate(c, s, cu, su, own, t)[0]
            x, y, c, s = on(x, y, c, s, whole(c, s, cu, su, (a, own[1]), t)[0])
            return c, s
        k = constants_of(lanes.rows[i if left(c, s, cu, su) else i + len(lanes.rows) // 2])
        for _ in range(lanes.pieces):
            x, y, c, s = step(x, y, c, s, cu, su, k)
        return c, s

    return turned


def derivatives(lanes: Any, c: Any, s: Any, cu: Any, su: Any, own: Any, t: Any) -> Any:
    """Return one step of one robot with its own parameters and its derivatives, by the motion of
    `lanes`."""


@overload(derivatives, jit_options=INLINE_FAST)
def _derivatives(lanes, c, s, cu, su, own, t):
    step = inlined(lanes.instance_class.differentiate)

    def derivatives(lanes, c, s, cu, su, own, t):
        a, slopes = rate(c, s, cu, su, own, t)
        return complete(step(c, s, cu, su, (a, own[1]), t), slopes)

    return derivatives
