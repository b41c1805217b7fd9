"""The cost (7)-(9) of a whole swarm: `tetractl.control.cost.evaluate`, compiled.

All particles are simulated together, signal by signal.
"""

import math
from functools import lru_cache
from threading import get_ident
from typing import Any, NamedTuple

import numpy as np

from tetractl.control.kernels.gradient import VECTOR
from tetractl.control.kernels.motion import advance, flat, parameters_of
from tetractl.control.kernels.obstacles import count_hits
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import sincos
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined

_sincos = inlined(sincos)


class Rollout(NamedTuple):
    """A problem laid out for N robots of P particles, with the scratch arrays of its rollouts."""

    start: Floats  # (4, N): x, y, cos and sin of the heading
    target: Floats  # (2, N)
    first: Any  # `Lanes`, constants of the motion for the first signal
    rest: Any  # `Lanes`, the same for the other signals
    parameters: Floats  # (N, 4) PARAMETERS and TURNING
    periods: Floats  # (2,) of the first signal and of the others [s]
    rows: Floats  # `Obstacles.rows`
    walls: Floats  # `Obstacles.walls`
    weight: float
    swept: bool
    separation: float
    drift: Floats  # `Flat.displaced`
    lanes: Floats  # (5, N, P): x, y, cos, sin, hits
    # (8, P): cos and sin of the signal; x, y before the step; two for `count_hits`; cos and sin of
    # the direction that one robot turns towards, the signal plus its bias
    scratch: Floats


def aligned(shape: tuple[int, ...]) -> Floats:
    """Return an array aligned to cache lines: a vector across two lines takes twice the time."""
    size = math.prod(shape)
    line = VECTOR
    raw = np.empty(size + line)
    first = -raw.ctypes.data // raw.itemsize % line
    return raw[first : first + size].reshape(shape)


@lru_cache(maxsize=4)  # the rounds of one control step need the same arrays
def lay_out(problem: Problem, particles: int) -> Rollout:
    """Prepare a problem for rollouts of a number of particles at once; every call returns the same
    arrays. The scratch arrays are those of all problems of this shape in this thread."""
    flattened = flat(problem)
    return Rollout(
        start=flattened.turned,
        target=np.ascontiguousarray(problem.targets.T),
        first=flattened.first,
        rest=flattened.rest,
        parameters=flattened.parameters,
        periods=np.array([problem.first_period, problem.period]),
        rows=problem.obstacles.rows,
        walls=problem.obstacles.walls,
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        separation=float(problem.separation),
        drift=flattened.displaced,
        **_scratch(get_ident(), problem.a.size, particles),
    )


@lru_cache(maxsize=64)
def _scratch(thread: int, count: int, particles: int) -> dict[str, Floats]:
    """Return the scratch arrays of one thread for robots and particles of these numbers."""
    return {"lanes": aligned((5, count, particles)), "scratch": aligned((8, particles))}


@compiled(**ENTRY_FAST, forceinline=True)
def costs(rollout, signals, total):
    """Write J of each column of signals (L, P) to total (P,); return whether all are finite."""
    lanes = rollout.lanes
    scratch = rollout.scratch
    drift = rollout.drift
    x = lanes[0]
    y = lanes[1]
    cos = lanes[2]
    sin = lanes[3]
    hits = lanes[4]
    cos_u = scratch[0]
    sin_u = scratch[1]
    x0 = scratch[2]
    y0 = scratch[3]
    gap = scratch[4]
    near = scratch[5]
    own_cos = scratch[6]
    own_sin = scratch[7]
    start = rollout.start
    drifts = drift.shape[1] > 0
    towards = (own_cos, own_sin) if drifts else (cos_u, sin_u)
    for i in range(x.shape[0]):
        for n in range(total.size):
            x[i, n] = start[0, i]
            y[i, n] = start[1, i]
            hits[i, n] = 0.0
            cos[i, n] = start[2, i]
            sin[i, n] = start[3, i]
    for j in range(signals.shape[0]):
        constants, east = (rollout.first, 2) if j == 0 else (rollout.rest, 4)
        for n in range(total.size):
            sin_u[n], cos_u[n] = _sincos(signals[j, n])
        for i in range(x.shape[0]):
            if rollout.swept:
                for n in range(total.size):
                    x0[n] = x[i, n]
                    y0[n] = y[i, n]
            if drifts:
                c = drift[0, i]
                s = drift[1, i]
                for n in range(total.size):
                    own_cos[n] = cos_u[n] * c - sin_u[n] * s
                    own_sin[n] = sin_u[n] * c + cos_u[n] * s
            robot = parameters_of(rollout.parameters[i])
            t = rollout.periods[min(j, 1)]
            advance(constants, x, y, cos, sin, towards[0], towards[1], i, robot, t)
            if drifts:
                for n in range(total.size):
                    x[i, n] = x[i, n] + drift[east, i]
                    y[i, n] = y[i, n] + drift[east + 1, i]
            rows = rollout.rows
            walls = rollout.walls
            swept = rollout.swept
            count_hits(rows, walls, x0, y0, x, y, i, swept, gap, near, hits)
        if rollout.separation > 0:
            count_meetings(x, y, rollout.separation, hits)
    return add_up(rollout, x, y, hits, total)


@compiled(**INLINE_FAST)
def count_meetings(x, y, separation, hits):
    """Add 1 to hits[i, n] for each robot before i that is nearer to i than the separation."""
    least = separation * separation
    for i in range(x.shape[0]):
        for k in range(i):
            for n in range(x.shape[1]):
                dx = x[i, n] - x[k, n]
                dy = y[i, n] - y[k, n]
                hits[i, n] += 1.0 if dx * dx + dy * dy <= least else 0.0


@compiled(**INLINE_FAST)
def add_up(rollout, x, y, hits, total):
    """Write (7) of each particle to total (P,); return whether all are finite."""
    target = rollout.target
    weight = rollout.weight
    for n in range(total.size):
        total[n] = 0.0
    for i in range(x.shape[0]):
        for n in range(total.size):
            dx = x[i, n] - target[0, i]
            dy = y[i, n] - target[1, i]
            total[n] += math.sqrt(dx * dx + dy * dy) + weight * hits[i, n]  # (8), (9)
    finite = True
    for n in range(total.size):
        finite &= math.isfinite(total[n])
    return finite
