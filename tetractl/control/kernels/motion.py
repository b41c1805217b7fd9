"""Robots advanced by one signal: the compiled step of a problem's motion in a loop over particles.

Arguments are rows of arrays (N, P): position x, y; cos and sin of the heading, advanced by
rotation. Then cos and sin of the direction u (P,), the same for every robot. `lanes` are the
constants of a motion, whose class decides what is compiled.
"""

from typing import Any

from numba.extending import overload

from tetractl.control.kernels.options import PIECE, entries, inlined


def advance(lanes: Any, x: Any, y: Any, cos: Any, sin: Any, cos_u: Any, sin_u: Any, i: int) -> None:
    """Advance robot i of every particle by one signal."""


@overload(advance, jit_options=PIECE)
def _advance(lanes, x, y, cos, sin, cos_u, sin_u, i):
    kind = lanes.instance_class
    step, columns = inlined(kind.advance), tuple(range(kind.size))

    def advance(lanes, x, y, cos, sin, cos_u, sin_u, i):
        k = entries(lanes.rows, i, columns)
        for _ in range(lanes.pieces):
            for n in range(cos_u.size):
                x[i, n], y[i, n], cos[i, n], sin[i, n] = step(
                    x[i, n], y[i, n], cos[i, n], sin[i, n], cos_u[n], sin_u[n], k
                )

    return advance


def derivatives(lanes: Any, heading: Any, u: Any, a: Any, v: Any, t: Any) -> Any:
    """Return one step of one robot and its derivatives, by the motion of `lanes`."""


@overload(derivatives, jit_options=PIECE)
def _derivatives(lanes, heading, u, a, v, t):
    step = inlined(lanes.instance_class.differentiate)
    return lambda lanes, heading, u, a, v, t: step(heading, u, a, v, t)
