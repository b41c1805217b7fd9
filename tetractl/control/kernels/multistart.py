"""A search of `tetractl.control.optimizers.multistart`: random sequences, the best polished."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.levenberg import Integers, judge, polish
from tetractl.control.kernels.rollout import costs
from tetractl.control.kernels.update import drawn
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.model.motion.motion import UPPER
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, inlined

BETWEEN_LOOKS = 130_000
"""Robot steps between two checks of the deadline: they take less than 1 ms."""
WARM = 0.5
"""Largest distance of a scattered sequence from the warm start [rad]."""
"""Greatest signal ub, (12) [rad]."""
S11 = np.uint64(11)
"""Shift that leaves the 53 bits of a random number that a float64 holds."""

# How `search` ends.
UNDER_WAY = 0
"""It was interrupted, and can be continued."""
GOOD = 1
"""A start costs at most the tolerance."""
SPENT = 2
"""The budget allows no further evaluation."""
OVER = 3
"""All starts of the last round are polished."""

# Numbers of `Rounds.counts`.
ROUNDS_BEGUN = 0
"""Rounds that were scattered."""
STARTS_NOW = 1
"""Starts of the present round."""
STARTS_DONE = 2
"""Those that are polished."""
ITERATIONS = 3
"""Iterations of the polish under way, or of the last one."""
POLISH_EVALUATIONS = 4
"""Evaluations of the polish under way; 0 if none is."""
HISTORY_ENTRIES = 5
"""Entries of the history."""
EVALUATIONS = 6
"""All evaluations but those of the polish under way."""
COUNTS = 7
"""Number of them."""

_wrap = inlined(polynomials.wrap)


class Rounds(NamedTuple):
    """A search that polishes up to K of P scattered sequences of L signals in each round."""

    scattered: Floats
    """(L, P)"""
    scattered_costs: Floats
    """(P,) their J."""
    draws: Floats
    """(knots, P) of the scattered curves, from -1 to 1."""
    order: Integers
    """(K,) numbers of the best of them."""
    starts: Floats
    """(K, L) sequences to polish, best first."""
    signals: Floats
    """(L,) the sequence polished last, within [-pi, pi]."""
    merits: Floats
    """(steps_max + 1,) its merit at first and after each iteration."""
    best: Floats
    """(L,) the best sequence."""
    costs: Floats
    """(2,) J of the best sequence, and of the last one."""
    history: Floats
    """J before and after each polish, and merits on the way to a new best."""
    counts: Integers
    """(COUNTS,)"""

    def begin(self, starts: Floats) -> None:
        """Begin a search with the sequences (S, L), of which there are at most K."""
        self.counts[:] = 0
        self.counts[STARTS_NOW] = len(starts)
        self.costs[0] = math.inf
        self.costs[1] = 0.0
        self.starts[: len(starts)] = starts


@lru_cache(maxsize=64)
def workspace(
    thread: int, count: int, particles: int, knots: int, length: int, steps_max: int, rounds: int
) -> Rounds:
    """Return the arrays of one thread."""
    return Rounds(
        scattered=np.empty((length, particles)),
        scattered_costs=np.empty(particles),
        draws=np.empty((knots, particles)),
        order=np.empty(count, dtype=np.int64),
        starts=np.empty((count, length)),
        signals=np.empty(length),
        merits=np.empty(steps_max + 1),
        best=np.empty(length),
        costs=np.empty(2),
        history=np.empty(1 + (rounds + 1) * (1 + count * (steps_max + 2))),
        counts=np.zeros(COUNTS, dtype=np.int64),
    )


@compiled(**ENTRY_FAST)
def search(
    work, rollout, key, warm, rounds, tolerance, slack, patience, budget, look, search_rounds
):
    """Polish the starts of `search_rounds`, then the best scattered ones of each of `rounds`, until
    one costs at most `tolerance`, within `budget` evaluations; return how the search ended.

    `warm` (L,) is the first start if there is a warm start, else empty; its own J comes first.

    A positive `look` is a number of iterations after which the search is interrupted; the next call
    continues it. A negative one ends the start that is under way as it is; 0 is no limit.
    """
    counts = search_rounds.counts
    u = search_rounds.signals
    steps_max = search_rounds.merits.size - 1
    particles = search_rounds.scattered_costs.size
    used = 0  # iterations of this call
    while look <= 0 or used < look:
        if counts[STARTS_DONE] == counts[STARTS_NOW]:
            if counts[ROUNDS_BEGUN] == rounds:
                return OVER
            if counts[EVALUATIONS] > 0 and counts[EVALUATIONS] + particles > budget:
                return SPENT
            if not _scatter(rollout, drawn(key, counts[ROUNDS_BEGUN]), warm, search_rounds):
                search_rounds.costs[1] = math.nan
                return SPENT
            counts[ROUNDS_BEGUN] += 1
            used += particles // work.room.residual.size
        # the warm start is evaluated as it is, before its polish
        only_evaluates = counts[EVALUATIONS] == 0 and warm.size > 0
        z = counts[ITERATIONS] if counts[POLISH_EVALUATIONS] > 0 else 0
        if z == 0:
            if not only_evaluates and counts[EVALUATIONS] + 2 > budget:
                return SPENT
            work.room.damping[0] = 0.0
            for j in range(u.size):
                u[j] = search_rounds.starts[counts[STARTS_DONE], j]
        if only_evaluates or look < 0:
            pause = z
        elif look == 0:
            pause = 2**62
        else:
            pause = z + max(1, look - used)  # at z a polish has not begun
        remaining = budget - counts[EVALUATIONS] - counts[POLISH_EVALUATIONS] - 1
        iterations, evaluations = polish(
            work,
            u,
            tolerance,
            slack,
            steps_max,
            patience,
            remaining,
            search_rounds.merits,
            z,
            pause,
        )
        used += iterations - z + 1
        counts[ITERATIONS] = iterations
        if look > 0 and not only_evaluates and work.room.damping[0] < math.inf:
            counts[POLISH_EVALUATIONS] += evaluations
            return UNDER_WAY
        cost = judge(work, u)
        if only_evaluates:
            counts[EVALUATIONS] += 1
        else:
            counts[EVALUATIONS] += counts[POLISH_EVALUATIONS] + evaluations + 1
            counts[STARTS_DONE] += 1
        counts[POLISH_EVALUATIONS] = 0
        search_rounds.costs[1] = cost
        best_before = search_rounds.costs[0]
        if cost < best_before:
            for m in range(iterations):
                _note(search_rounds, min(max(search_rounds.merits[m], cost), best_before))
        _keep(search_rounds, u, cost)
        if cost <= tolerance and not only_evaluates:
            return GOOD
        if look < 0 or not math.isfinite(cost):
            break
    return UNDER_WAY


@compiled(**INLINE_FAST)
def _note(search_rounds, cost):
    """Add an entry to the history."""
    search_rounds.history[search_rounds.counts[HISTORY_ENTRIES]] = cost
    search_rounds.counts[HISTORY_ENTRIES] += 1


@compiled(**INLINE_FAST)
def _keep(search_rounds, u, cost):
    """Keep the sequence u (L,) if it costs least, and add the least cost to the history."""
    if cost < search_rounds.costs[0]:
        search_rounds.costs[0] = cost
        for j in range(u.size):
            search_rounds.best[j] = u[j]
    _note(search_rounds, search_rounds.costs[0])


@compiled(**INLINE_FAST)
def _scatter(rollout, key, warm, search_rounds):
    """Scatter a round's sequences, of which the best become the starts; return whether all their J
    are finite.

    Each sequence is linear between knots, directions drawn uniformly within UPPER of the bearing of
    the targets. With a warm start (L,), every second sequence is the warm start plus such a curve
    within WARM of 0.
    """
    draws = search_rounds.draws
    signals = search_rounds.scattered
    scattered_costs = search_rounds.scattered_costs
    order = search_rounds.order
    knots, particles = draws.shape
    bearing = _bearing(rollout)
    for k in range(knots):
        for n in range(particles):
            draw = drawn(key, k * particles + n) >> S11
            draws[k, n] = 2 * (np.float64(draw) * 2.0**-53) - 1
    length = signals.shape[0]
    warmed = 1 if warm.size else 0
    for j in range(length):
        place = j * (knots - 1) / max(length - 1, 1)  # among the knots
        below = min(int(place), max(knots - 2, 0))
        above = min(below + 1, knots - 1)
        share = place - below
        middle = warm[j] if warmed else bearing
        for n in range(particles):
            curve = draws[below, n] * (1 - share) + draws[above, n] * share
            near_warm = warmed & ~n  # for even n: vector code needs a number
            u = middle + WARM * curve if near_warm else bearing + UPPER * curve
            signals[j, n] = _wrap(u)
    if not costs(rollout, signals, scattered_costs):
        return False
    count = _sort(scattered_costs, order)
    for k in range(count):
        for j in range(length):
            search_rounds.starts[k, j] = signals[j, order[k]]
    search_rounds.counts[STARTS_NOW] = count
    search_rounds.counts[STARTS_DONE] = 0
    search_rounds.counts[EVALUATIONS] += particles
    _keep(search_rounds, search_rounds.starts[0], scattered_costs[order[0]])
    return True


@compiled(**INLINE_FAST)
def _bearing(rollout):
    """Return the mean direction from the robots to their targets [rad]."""
    east = 0.0
    north = 0.0
    for i in range(rollout.target.shape[1]):
        east += rollout.target[0, i] - rollout.start[0, i]
        north += rollout.target[1, i] - rollout.start[1, i]
    return math.atan2(north, east)


@compiled(**INLINE_FAST)
def _sort(scattered_costs, order):
    """Fill order (K,) with the numbers of the least costs, least first, of equal ones the first
    first; return how many there are. It inserts each into those sorted before."""
    count = 0
    for n in range(scattered_costs.size):
        if count < order.size:
            count += 1
        elif scattered_costs[n] >= scattered_costs[order[-1]]:
            continue
        k = count - 1
        while k > 0 and scattered_costs[order[k - 1]] > scattered_costs[n]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = n
    return count
