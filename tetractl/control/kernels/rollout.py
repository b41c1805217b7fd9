"""The cost (7)-(9) of a whole swarm: `tetractl.control.cost.evaluate`, compiled.

All particles are simulated together, signal by signal: `begin`, `follow` for each signal, `add_up`.
A swarm's signals can then be updated one row at a time, while the row is in the processor's cache.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.motion import advance, constants
from tetractl.control.kernels.obstacles import SingleShape, count_hits, row
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST, entries, inlined
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion.polynomials import sincos

LINE = 64  # bytes in a cache line


class Rollout(NamedTuple):
    """A problem laid out for N robots of P particles, with the scratch arrays of its rollouts."""

    start: Floats  # (4, N): x, y, cos and sin of the heading
    target: Floats  # (2, N)
    first: Any  # `Lanes`, constants of the motion for the first signal
    rest: Any  # `Lanes`, the same for the other signals
    obstacles: Any  # `SingleShape`, or a tuple of `PackedShapes`
    weight: float
    swept: bool
    separation: float
    # (6, N): cos and sin of the bias, then x and y of the displacement by the flow in the first
    # period, then in each other one; (6, 0) without bias and flow
    drift: Floats
    lanes: Floats  # (5, N, P): x, y, cos, sin, hits
    # (7, P): cos and sin of the signal; x, y before the step; gap; cos and sin of the direction
    # that one robot turns towards, the signal plus its bias
    scratch: Floats


def aligned(shape: tuple[int, ...]) -> Floats:
    """Return an array aligned to cache lines: a vector across two lines takes twice the time."""
    size, line = math.prod(shape), LINE // 8
    raw = np.empty(size + line)
    first = -raw.ctypes.data // raw.itemsize % line
    return raw[first : first + size].reshape(shape)


def lay_out(problem: Problem, particles: int) -> Rollout:
    """Prepare a problem for rollouts of a number of particles at once."""
    p, packs = problem.poses, problem.obstacles.packed()
    first, rest = constants(problem)
    filled = [pack for pack in packs if len(pack.rows)]
    sole = len(filled) == len(filled[0].rows) == 1 if filled else False
    drifts = problem.bias is not None or problem.flow is not None
    if sole and not (problem.swept or problem.separation or drifts):
        packs = SingleShape(filled[0])
    return Rollout(
        start=np.array([p.x, p.y, np.cos(p.heading), np.sin(p.heading)]),
        target=np.ascontiguousarray(problem.targets.T),
        first=first,
        rest=rest,
        obstacles=packs,
        weight=float(problem.obstacle_weight),
        swept=problem.swept,
        separation=float(problem.separation),
        drift=_drift(problem) if drifts else np.empty((6, 0)),
        lanes=aligned((5, problem.a.size, particles)),
        scratch=aligned((7, particles)),
    )


def _drift(problem: Problem) -> Floats:
    drift = problem.drift
    ways = drift[2:] * problem.first_period, drift[2:] * problem.period
    return np.concatenate([drift[:2], *ways])


@compiled(**ENTRY_FAST)
def costs(rollout, signals, total):
    """Write J of each column of signals (L, P) to total (P,); return whether all are finite."""
    lanes, scratch = views(rollout)
    begin(rollout, lanes, scratch)
    for j in range(signals.shape[0]):
        follow(rollout, lanes, scratch, signals, j)
    return add_up(rollout, lanes, total)


@compiled(**INLINE_FAST)
def views(rollout):
    """Return (x, y, cos, sin, hits) and (cos_u, sin_u, x0, y0, gap, own_cos_u, own_sin_u).

    Call it outside of loops: each view costs a reference count in compiled code.
    """
    a, b = rollout.lanes, rollout.scratch
    return (a[0], a[1], a[2], a[3], a[4]), (b[0], b[1], b[2], b[3], b[4], b[5], b[6])


@compiled(**INLINE_FAST)
def begin(rollout, lanes, scratch):
    """Set the robots of every particle to their starts."""
    x, y, cos, sin, hits = lanes
    gap, start = scratch[4], rollout.start
    for n in range(gap.size):
        gap[n] = 1.0
    for i in range(x.shape[0]):
        for n in range(gap.size):
            x[i, n], y[i, n], hits[i, n] = start[0, i], start[1, i], 0.0
            cos[i, n], sin[i, n] = start[2, i], start[3, i]


def follow(rollout: Any, lanes: Any, scratch: Any, signals: Any, j: int) -> None:
    """Move every robot by signal j of every particle, and count the robots in an obstacle."""


@overload(follow, jit_options=INLINE_FAST)
def _follow(rollout, lanes, scratch, signals, j):
    fields = dict(zip(rollout.fields, rollout.types, strict=True))
    if getattr(fields["obstacles"], "instance_class", None) is SingleShape:
        return _follow_past_one(fields["rest"], fields["obstacles"])
    sincos_of = inlined(sincos)

    def follow(rollout, lanes, scratch, signals, j):
        x, y, cos, sin, hits = lanes
        cos_u, sin_u, x0, y0, gap, own_cos, own_sin = scratch
        constants, drift = rollout.first if j == 0 else rollout.rest, rollout.drift
        east = 2 if j == 0 else 4
        for n in range(gap.size):
            sin_u[n], cos_u[n] = sincos_of(signals[j, n])
        for i in range(x.shape[0]):
            if rollout.swept:
                for n in range(gap.size):
                    x0[n], y0[n] = x[i, n], y[i, n]
            if drift.shape[1] == 0:
                advance(constants, x, y, cos, sin, cos_u, sin_u, i)
            else:
                c, s = drift[0, i], drift[1, i]
                for n in range(gap.size):
                    own_cos[n] = cos_u[n] * c - sin_u[n] * s
                    own_sin[n] = sin_u[n] * c + cos_u[n] * s
                advance(constants, x, y, cos, sin, own_cos, own_sin, i)
                for n in range(gap.size):
                    x[i, n], y[i, n] = x[i, n] + drift[east, i], y[i, n] + drift[east + 1, i]
            count_hits(rollout.obstacles, x0, y0, x, y, i, rollout.swept, gap, hits)
        if rollout.separation > 0:
            count_meetings(x, y, rollout.separation, hits)

    return follow


def _follow_past_one(constants, obstacles):
    """Return the `follow` for a single obstacle tested at samples: one loop moves and tests."""
    kind, shape = constants.instance_class, obstacles[0].instance_class
    step, gap_of = inlined(kind.advance), inlined(shape.gap)
    ends_early = hasattr(kind, "finish")
    finish: Any = inlined(kind.finish) if ends_early else None
    sincos_of, columns = inlined(sincos), tuple(range(kind.size))

    def follow(rollout, lanes, scratch, signals, j):
        x, y, cos, sin, hits = lanes
        cos_u, sin_u = scratch[0], scratch[1]
        constants = rollout.first if j == 0 else rollout.rest
        p = row(rollout.obstacles.shape, 0)
        last = ends_early and j == signals.shape[0] - 1
        if not last:
            for n in range(cos_u.size):
                sin_u[n], cos_u[n] = sincos_of(signals[j, n])
        for i in range(x.shape[0]):
            k = entries(constants.rows, i, columns)
            for _ in range(constants.pieces - 1):
                for n in range(cos_u.size):
                    x[i, n], y[i, n], cos[i, n], sin[i, n] = step(
                        x[i, n], y[i, n], cos[i, n], sin[i, n], cos_u[n], sin_u[n], k
                    )
            if last:
                for n in range(cos_u.size):
                    new_x, new_y = finish(x[i, n], y[i, n], cos[i, n], sin[i, n], k)
                    x[i, n], y[i, n] = new_x, new_y
                    hits[i, n] += 1.0 if gap_of(new_x, new_y, p) <= 0 else 0.0
            else:
                for n in range(cos_u.size):
                    new_x, new_y, c, s = step(
                        x[i, n], y[i, n], cos[i, n], sin[i, n], cos_u[n], sin_u[n], k
                    )
                    x[i, n], y[i, n], cos[i, n], sin[i, n] = new_x, new_y, c, s
                    hits[i, n] += 1.0 if gap_of(new_x, new_y, p) <= 0 else 0.0

    return follow


@compiled(**INLINE_FAST)
def count_meetings(x, y, separation, hits):
    """Add 1 to hits[i, n] for each robot before i that is nearer to i than the separation."""
    least = separation * separation
    for i in range(x.shape[0]):
        for k in range(i):
            for n in range(x.shape[1]):
                dx, dy = x[i, n] - x[k, n], y[i, n] - y[k, n]
                hits[i, n] += 1.0 if dx * dx + dy * dy <= least else 0.0


@compiled(**INLINE_FAST)
def add_up(rollout, lanes, total):
    """Write (7) of each particle to total (P,); return whether all are finite."""
    x, y, hits, target, weight = lanes[0], lanes[1], lanes[4], rollout.target, rollout.weight
    for n in range(total.size):
        total[n] = 0.0
    for i in range(x.shape[0]):
        for n in range(total.size):
            dx, dy = x[i, n] - target[0, i], y[i, n] - target[1, i]
            total[n] += math.sqrt(dx * dx + dy * dy) + weight * hits[i, n]  # (8), (9)
    finite = True
    for n in range(total.size):
        finite &= math.isfinite(total[n])
    return finite
