"""A search of `tetractl.control.optimizers.multistart`: random sequences, the best polished."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.levenberg import Integers, judge, polish
from tetractl.control.kernels.rollout import costs
from tetractl.control.kernels.update import drawn
from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.model.motion.motion import DIRECTION

BETWEEN_LOOKS = 130_000  # robot steps between two checks of the deadline, below 1 ms
WARM = 0.5  # largest distance of a scattered sequence from the warm start [rad]
UNDER_WAY, GOOD, SPENT, OVER = range(4)
"""What `search` returns: it was interrupted, or ended by the tolerance, the budget or the last
round."""
ROUND, STARTS, DONE, STEPS, BEGUN, KEPT, EVALUATIONS = range(7)
"""What `Rounds.at` counts: rounds begun; starts of the present one, and those that are done;
iterations of the last start, and its evaluations while it is under way; entries of the history; all
other evaluations."""

_wrap = inlined(polynomials.wrap)
HIGH = DIRECTION.high
S11 = np.uint64(11)


class Rounds(NamedTuple):
    """A search that polishes up to K of P scattered sequences of L signals in each round."""

    scattered: Floats  # (L, P)
    found: Floats  # (P,) their J
    draws: Floats  # (knots, P)
    order: Integers  # (K,) numbers of the best of them
    starts: Floats  # (K, L) sequences to polish, best first
    signals: Floats  # (L,) the sequence polished last, within [-pi, pi]
    merits: Floats  # (steps_max + 1,) its merit at first and after each iteration
    best: Floats  # (L,)
    costs: Floats  # (2,) J of the best sequence and of the last one
    history: Floats  # J before and after each polish, and merits on the way to a new best
    at: Integers  # (7,) counts

    def begin(self, starts: Floats) -> None:
        """Begin a search with the sequences (S, L), of which there are at most K."""
        self.at[:], self.costs[:] = 0, (math.inf, 0.0)
        self.go_on(starts)

    def go_on(self, starts: Floats) -> None:
        """Go on with other sequences (S, L)."""
        self.at[:KEPT] = 0
        self.at[STARTS] = len(starts)
        self.starts[: len(starts)] = starts


@lru_cache(maxsize=64)
def workspace(
    thread: int, count: int, particles: int, knots: int, length: int, steps_max: int, rounds: int
) -> Rounds:
    """Return the arrays of one thread."""
    return Rounds(
        scattered=np.empty((length, particles)),
        found=np.empty(particles),
        draws=np.empty((knots, particles)),
        order=np.empty(count, dtype=np.int64),
        starts=np.empty((count, length)),
        signals=np.empty(length),
        merits=np.empty(steps_max + 1),
        best=np.empty(length),
        costs=np.empty(2),
        history=np.empty(1 + (rounds + 1) * (1 + count * (steps_max + 2))),
        at=np.zeros(7, dtype=np.int64),
    )


@compiled(**ENTRY_FAST)
def search(work, rollout, key, warm, rounds, tolerance, slack, patience, budget, look, of):
    """Polish the starts of `of`, then the best scattered ones of each of `rounds`, until one costs
    at most `tolerance`, within `budget` evaluations; return how the search ended.

    `warm` (L,) is the first start if there is a warm start, else empty; its own J comes first.

    A positive `look` is a number of iterations after which the search is interrupted; the next call
    continues it. A negative one ends the start that is under way as it is; 0 is no limit.
    """
    at, u, used = of.at, of.signals, 0
    steps_max, particles = of.merits.size - 1, of.found.size
    while look <= 0 or used < look:
        if at[DONE] == at[STARTS]:
            if at[ROUND] == rounds:
                return OVER
            if at[EVALUATIONS] > 0 and at[EVALUATIONS] + particles > budget:
                return SPENT
            if not _scatter(rollout, drawn(key, at[ROUND]), warm, of):
                of.costs[1] = math.nan
                return SPENT
            at[ROUND] += 1
            used += particles // work.room.residual.size
        glance = at[EVALUATIONS] == 0 and warm.size > 0
        z = at[STEPS] if at[BEGUN] > 0 else 0
        if z == 0:
            if not glance and at[EVALUATIONS] + 2 > budget:
                return SPENT
            work.room.damping[0] = 0.0
            for j in range(u.size):
                u[j] = of.starts[at[DONE], j]
        pause = 2**62 if look == 0 else z + max(1, look - used)  # at z a polish has not begun
        pause = z if glance or look < 0 else pause
        left = budget - at[EVALUATIONS] - at[BEGUN] - 1
        now, more = polish(
            work, u, tolerance, slack, steps_max, patience, left, of.merits, z, pause
        )
        used += now - z + 1
        at[STEPS] = now
        if look > 0 and not glance and work.room.damping[0] < math.inf:
            at[BEGUN] += more
            return UNDER_WAY
        cost = judge(work, u)
        at[EVALUATIONS] += 1 if glance else at[BEGUN] + more + 1
        at[DONE] += 0 if glance else 1
        at[BEGUN], of.costs[1], before = 0, cost, of.costs[0]
        for m in range(now if cost < before else 0):
            _note(of, min(max(of.merits[m], cost), before))
        _keep(of, u, cost)
        if cost <= tolerance and not glance:
            return GOOD
        if look < 0 or not math.isfinite(cost):
            break
    return UNDER_WAY


@compiled(**INLINE_FAST)
def _note(of, cost):
    """Add an entry to the history."""
    of.history[of.at[KEPT]] = cost
    of.at[KEPT] += 1


@compiled(**INLINE_FAST)
def _keep(of, u, cost):
    """Keep the sequence u (L,) if it costs least, and add the least cost to the history."""
    if cost < of.costs[0]:
        of.costs[0] = cost
        for j in range(u.size):
            of.best[j] = u[j]
    _note(of, of.costs[0])


@compiled(**INLINE_FAST)
def _scatter(rollout, key, warm, of):
    """Scatter a round's sequences, of which the best become the starts; return whether all their J
    are finite.

    Each sequence is linear between knots, directions drawn uniformly within HIGH of the bearing of
    the targets. With a warm start (L,), every second sequence is the warm start plus such a curve
    within WARM of 0.
    """
    draws, signals, found, order = of.draws, of.scattered, of.found, of.order
    knots, particles = draws.shape
    east = north = 0.0
    for i in range(rollout.target.shape[1]):
        east += rollout.target[0, i] - rollout.start[0, i]
        north += rollout.target[1, i] - rollout.start[1, i]
    middle = math.atan2(north, east)
    for k in range(knots):
        for n in range(particles):
            draw = drawn(key, k * particles + n) >> S11
            draws[k, n] = 2 * (np.float64(draw) * 2.0**-53) - 1
    length, warmed = signals.shape[0], 1 if warm.size else 0
    for j in range(length):
        at = j * (knots - 1) / max(length - 1, 1)
        below = min(int(at), max(knots - 2, 0))
        after, share = min(below + 1, knots - 1), at - below
        start = warm[j] if warmed else middle
        for n in range(particles):
            curve, near = draws[below, n] * (1 - share) + draws[after, n] * share, warmed & ~n
            signals[j, n] = _wrap(start + WARM * curve if near else middle + HIGH * curve)
    if not costs(rollout, signals, found):
        return False
    count = 0
    for n in range(particles):
        if count < order.size:
            count += 1
        elif found[n] >= found[order[-1]]:
            continue
        k = count - 1
        while k > 0 and found[order[k - 1]] > found[n]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = n
    for k in range(count):
        for j in range(length):
            of.starts[k, j] = signals[j, order[k]]
    of.at[STARTS], of.at[DONE] = count, 0
    of.at[EVALUATIONS] += particles
    _keep(of, of.starts[0], found[order[0]])
    return True
