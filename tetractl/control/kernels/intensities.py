"""The cost (7)-(9) of a whole swarm under signals with an intensity: as `kernels.rollout`, but the
a and speed of a robot differ from signal to signal and from particle to particle."""

from typing import Any

from numba.extending import overload

from tetractl.control.kernels.obstacles import count_hits
from tetractl.control.kernels.rollout import add_up, count_meetings
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.model.motion.polynomials import onwards, sincos

_sincos = inlined(sincos)


@compiled(**ENTRY_FAST, forceinline=True)
def costs(rollout, directions, a, speed, total):
    """Write J of each column of directions (L, P) to total (P,), for robots with a and speed
    (L, P, N); return whether all are finite."""
    lanes, scratch, start = rollout.lanes, rollout.scratch, rollout.start
    x, y, cos, sin, hits = lanes[0], lanes[1], lanes[2], lanes[3], lanes[4]
    cos_u, sin_u, x0, y0, gap, near = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    )  # fmt: skip
    for i in range(x.shape[0]):
        for n in range(total.size):
            x[i, n], y[i, n], hits[i, n] = start[0, i], start[1, i], 0.0
            cos[i, n], sin[i, n] = start[2, i], start[3, i]
    for j in range(directions.shape[0]):
        for n in range(total.size):
            sin_u[n], cos_u[n] = _sincos(directions[j, n])
        for i in range(x.shape[0]):
            if rollout.swept:
                for n in range(total.size):
                    x0[n], y0[n] = x[i, n], y[i, n]
            t = rollout.periods[min(j, 1)]
            advance(rollout.rest, x, y, cos, sin, cos_u, sin_u, i, a[j], speed[j], t)
            rows, walls, swept = rollout.rows, rollout.walls, rollout.swept
            count_hits(rows, walls, x0, y0, x, y, i, swept, gap, near, hits)
        if rollout.separation > 0:
            count_meetings(x, y, rollout.separation, hits)
    return add_up(rollout, x, y, hits, total)


def advance(
    lanes: Any, x: Any, y: Any, cos: Any, sin: Any, cu: Any, su: Any, i: int, a: Any, v: Any, t: Any
) -> None:
    """Advance robot i of every particle by one signal, given its a and v (P, N) and the time."""


@overload(advance, jit_options=INLINE_FAST)
def _advance(lanes, x, y, cos, sin, cu, su, i, a, v, t):
    whole, on = inlined(lanes.instance_class.differentiate), inlined(onwards)

    def advance(lanes, x, y, cos, sin, cu, su, i, a, v, t):
        for n in range(cu.size):
            c, s = cos[i, n], sin[i, n]
            found = whole(c, s, cu[n], su[n], (a[n, i], v[n, i]), t)[0]
            x[i, n], y[i, n], cos[i, n], sin[i, n] = on(x[i, n], y[i, n], c, s, found)

    return advance
