"""Compiled tests of whether robots are in obstacles: `Obstacles.contain` and `Obstacles.cross`.

`packs` is a tuple of `PackedShapes`, one per kind, see `tetractl.model.obstacles`; code is compiled
for each set of their classes. Loops over kinds are unrolled by recursion: a tuple of several types
has no loop in compiled code.
"""

import math
from typing import Any, NamedTuple

from numba.extending import overload

from tetractl.control.kernels.options import INLINE_FAST, entries, inlined


class SingleShape(NamedTuple):
    """A problem's only obstacle, tested at predicted positions in the loop that moves robots."""

    shape: Any  # PackedShapes of one row


def row(pack: Any, o: int) -> Any:
    """Return the numbers of obstacle o of a kind: a tuple, or an array if rows differ."""


@overload(row, jit_options=INLINE_FAST)
def _row(pack, o):
    size = pack.instance_class.size
    if size is None:
        return lambda pack, o: pack.rows[o]
    columns = tuple(range(size))
    return lambda pack, o: entries(pack.rows, o, columns)


def count_hits(
    packs: Any, x0: Any, y0: Any, x: Any, y: Any, i: int, swept: bool, gap: Any, hits: Any
) -> None:
    """Add 1 to hits[i, n] if robot i of particle n is in an obstacle or has passed through one.

    The robot is at x, y (N, P); if `swept`, it came there from x0, y0 (P,). gap (P,) is a scratch
    array, 1 before and after.
    """


@overload(count_hits, jit_options=INLINE_FAST)
def _count_hits(packs, x0, y0, x, y, i, swept, gap, hits):
    def count_hits(packs, x0, y0, x, y, i, swept, gap, hits):
        narrow(packs, x0, y0, x, y, i, swept, gap)
        for n in range(gap.size):
            hits[i, n] += 1.0 if gap[n] <= 0 else 0.0
            gap[n] = 1.0

    return count_hits


def narrow(packs: Any, x0: Any, y0: Any, x: Any, y: Any, i: int, swept: bool, gap: Any) -> None:
    """Reduce gap (P,) to the least gap of robot i to any obstacle; arguments are those of
    `count_hits`.
    """


@overload(narrow, jit_options=INLINE_FAST)
def _narrow(packs, x0, y0, x, y, i, swept, gap):
    if len(packs) == 0:
        return lambda packs, x0, y0, x, y, i, swept, gap: None
    kind = packs[-1].instance_class
    point, segment = inlined(kind.gap), inlined(kind.gap_between)

    def narrow_to_kind(packs, x0, y0, x, y, i, swept, gap):
        narrow(packs[:-1], x0, y0, x, y, i, swept, gap)
        rows = packs[-1].rows
        for o in range(rows.shape[0]):
            p = row(packs[-1], o)
            if swept:
                for n in range(gap.size):
                    gap[n] = min(gap[n], segment(x0[n], y0[n], x[i, n], y[i, n], p))
            else:
                for n in range(gap.size):
                    gap[n] = min(gap[n], point(x[i, n], y[i, n], p))

    return narrow_to_kind


def count_deepest(packs: Any, path: Any, length: int, depths: Any, where: Any) -> Any:
    """Find each robot's deepest position in each obstacle; return the number of obstacles.

    path (2, N, M): only the first `length` positions count. depths (N, O) [length unit] are at most
    0 if no position is inside; where (N, O) is the index of the first deepest position.
    """
    raise NotImplementedError("only compiled code can call this")


@overload(count_deepest, jit_options=INLINE_FAST)
def _count_deepest(packs, path, length, depths, where):
    if len(packs) == 0:
        return lambda packs, path, length, depths, where: 0
    depth_of = inlined(packs[-1].instance_class.depth)

    def count_deepest_in_kind(packs, path, length, depths, where):
        first = count_deepest(packs[:-1], path, length, depths, where)
        rows = packs[-1].rows
        for o in range(rows.shape[0]):
            p = row(packs[-1], o)
            for i in range(path.shape[1]):
                deepest, at = -math.inf, 0
                for j in range(length):
                    depth = depth_of(path[0, i, j], path[1, i, j], p)
                    if depth > deepest:
                        deepest, at = depth, j
                depths[i, first + o], where[i, first + o] = deepest, at
        return first + rows.shape[0]

    return count_deepest_in_kind


def outward(packs: Any, o: int, x: float, y: float) -> Any:
    """Return the unit vector from (x, y) out of obstacle o, numbered over all kinds."""


@overload(outward, jit_options=INLINE_FAST)
def _outward(packs, o, x, y):
    if len(packs) == 0:
        return lambda packs, o, x, y: (0.0, 0.0)
    direction = inlined(packs[0].instance_class.outward)

    def outward_of_kind(packs, o, x, y):
        count = packs[0].rows.shape[0]
        if o < count:
            return direction(x, y, row(packs[0], o))
        return outward(packs[1:], o - count, x, y)

    return outward_of_kind
