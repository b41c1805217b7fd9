"""The turns of robots between frames, and by how much the motion misses them: for `identify`."""

import math
from typing import NamedTuple

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.motion import turn
from tetractl.control.kernels.options import PIECE, inlined
from tetractl.core.poses import Bools, Floats
from tetractl.model.motion.polynomials import wrap

_wrap = inlined(wrap)

HEADING_STD = 0.01  # of a measured heading [rad] ...
HEADING_WALK = 0.1  # ... and of its random walk [rad/sqrt(s)], before anything is seen
NUDGE = 1e-4  # of ln a and beta, for derivatives


class Data(NamedTuple):
    """`Intervals` and `Directions`, whose shapes are told there."""

    since: Floats
    until: Floats
    heading: Floats
    turned: Floats
    travelled: Floats
    usable: Bools
    when: Floats
    u: Floats


@compiled(**PIECE)
def find_first(data, tau, first):
    """Write to first (K,) which direction acts at the begin of each interval, the oldest before
    any does."""
    at, last = 0, data.when.size - 1
    for k in range(first.size):
        since = data.since[k]
        while at > 0 and data.when[at] + tau > since:
            at -= 1
        while at < last and data.when[at + 1] + tau <= since:
            at += 1
        first[k] = at


@compiled(**PIECE)
def residual(lanes, data, at, tau, k, i, a, beta):
    """Return r of robot i in interval k over the unscaled sigma; direction `at` acts first."""
    begin, until, last = data.since[k], data.until[k], data.when.size - 1
    heading = data.heading[k, i]
    while True:
        end = until if at == last else min(data.when[at + 1] + tau, until)
        if end > begin:
            heading = turn(lanes, heading, data.u[at] + beta, a, end - begin)
            begin = end
        if end == until:
            break
        at += 1
    return missed(data, k, i, heading)


@compiled(**PIECE)
def residuals(lanes, data, at, tau, k, i, a, more_a, beta):
    """Return r there, with more a and with more beta: what they share is computed once."""
    begin, until, last = data.since[k], data.until[k], data.when.size - 1
    more_beta = beta + NUDGE
    there = by_a = by_beta = data.heading[k, i]
    while True:
        end = until if at == last else min(data.when[at + 1] + tau, until)
        if end > begin:
            u, t = data.u[at], end - begin
            there = turn(lanes, there, u + beta, a, t)
            by_a = turn(lanes, by_a, u + beta, more_a, t)
            by_beta = turn(lanes, by_beta, u + more_beta, a, t)
            begin = end
        if end == until:
            break
        at += 1
    return missed(data, k, i, there), missed(data, k, i, by_a), missed(data, k, i, by_beta)


@compiled(**PIECE)
def missed(data, k, i, heading):
    """Return by how many unscaled sigma a heading predicted misses the turn measured."""
    missed = _wrap(data.turned[k, i] - (heading - data.heading[k, i]))
    t = data.until[k] - data.since[k]
    return missed / math.sqrt(2 * HEADING_STD**2 + HEADING_WALK**2 * t)
