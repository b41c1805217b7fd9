"""A search of `tetractl.control.optimizers.multistart`: random sequences, the best polished.

A search has *starts*, sequences that it polishes one after the other: at first the warm start, if
there is one; and then *rounds*, in each of which many random sequences are scattered, and the best
of them become the next starts. `search` goes on with a search as far as it is allowed to, and says
how it ended:

    PAUSED      not yet: the iterations that were allowed are done
    GOOD        a start costs at most the tolerance
    SPENT       the budget allows no further evaluation
    OVER        all starts of the last round are polished
    NOT_FINITE  a cost is no finite number
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tetractl.control.kernels.levenberg import POLISH_STATE, Integers, judge, polish
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
S11 = np.uint64(11)
"""Shift that leaves the 53 bits of a random number that a float64 holds."""
UNLIMITED = 2**62
"""A number of evaluations, or of iterations, that no search reaches."""

PAUSED = 0
GOOD = 1
SPENT = 2
OVER = 3
NOT_FINITE = 4

_wrap = inlined(polynomials.wrap)

SEARCH_STATE = np.dtype(
    [
        ("rounds_begun", np.int64),  # that were scattered
        ("starts", np.int64),  # of the present round
        ("starts_done", np.int64),  # those of them that are polished
        ("evaluations", np.int64),  # all but those of the polish under way
        ("history_entries", np.int64),
        ("best_cost", np.float64),  # J of the best sequence
    ]
)
"""How far a search has come."""


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
    """(L,) the sequence that is polished, or was last; then it is within [-pi, pi]."""
    merits: Floats
    """(steps_max + 1,) its merit at first and after each iteration."""
    best: Floats
    """(L,) the best sequence."""
    history: Floats
    """J before and after each polish, and merits on the way to a new best."""
    polish: Any
    """The `POLISH_STATE` of the polish under way, or of the last one."""
    state: Any
    """The `SEARCH_STATE`."""

    def begin(self, starts: Floats) -> None:
        """Begin a search with the sequences (S, L), of which there are at most K."""
        self.starts[: len(starts)] = starts
        self.polish.evaluations = 0
        self.state.rounds_begun = 0
        self.state.starts = len(starts)
        self.state.starts_done = 0
        self.state.evaluations = 0
        self.state.history_entries = 0
        self.state.best_cost = math.inf


@lru_cache(maxsize=64)
def rounds_for(
    thread: int, count: int, particles: int, knots: int, length: int, steps_max: int, rounds: int
) -> Rounds:
    """Return the arrays of a thread for searches of these sizes."""
    return Rounds(
        scattered=np.empty((length, particles)),
        scattered_costs=np.empty(particles),
        draws=np.empty((knots, particles)),
        order=np.empty(count, dtype=np.int64),
        starts=np.empty((count, length)),
        signals=np.empty(length),
        merits=np.empty(steps_max + 1),
        best=np.empty(length),
        history=np.empty(1 + (rounds + 1) * (1 + count * (steps_max + 2))),
        polish=np.recarray(1, POLISH_STATE)[0],
        state=np.recarray(1, SEARCH_STATE)[0],
    )


@compiled(**ENTRY_FAST)
def search(
    problem, rollouts, room, key, warm, rounds_max, settings, budget, iterations, cut_short, rounds
):
    """Go on with a search, within `budget` evaluations in all; return how it ended.

    `warm` (L,) is the first start if there is a warm start, else empty; its own J comes first, as
    it is. `rounds_max` rounds are scattered. The search is paused after about so many `iterations`,
    and at the latest one polish later; or, to be `cut_short`, it ends the start under way as it is.
    """
    state = rounds.state
    u = rounds.signals
    particles = rounds.scattered_costs.size
    iterations_left = iterations
    while iterations_left > 0:
        if state.starts_done == state.starts:
            if state.rounds_begun == rounds_max:
                return OVER
            if state.evaluations > 0 and state.evaluations + particles > budget:
                return SPENT
            draws_key = drawn(key, state.rounds_begun)
            if not _scatter(problem, rollouts, draws_key, warm, rounds):
                return NOT_FINITE
            iterations_left -= particles // room.residual.size
        is_begun = rounds.polish.evaluations > 0
        only_evaluates = warm.size > 0 and state.evaluations == 0
        if not is_begun:
            if not only_evaluates and state.evaluations + 2 > budget:
                return SPENT
            rounds.polish.iterations = 0
            for j in range(u.size):
                u[j] = rounds.starts[state.starts_done, j]
        if only_evaluates:
            iterations_left -= 1
        else:
            done = rounds.polish.iterations
            pause = done if cut_short else done + max(1, iterations_left)  # not before it begins
            polish_budget = budget - state.evaluations - 1
            is_paused = polish(
                problem, room, u, settings, polish_budget, rounds.merits, rounds.polish, pause
            )
            iterations_left -= rounds.polish.iterations - done + 1
            if is_paused and not cut_short:
                return PAUSED
        cost = judge(problem, room, u)
        if not math.isfinite(cost):
            return NOT_FINITE
        state.evaluations += rounds.polish.evaluations + 1
        rounds.polish.evaluations = 0
        if not only_evaluates:
            state.starts_done += 1
            _note_merits(rounds, cost)
        _keep(rounds, u, cost)
        if cost <= settings.tolerance and not only_evaluates:
            return GOOD
        if cut_short:
            return PAUSED
    return PAUSED


@compiled(**INLINE_FAST)
def _note_merits(rounds, cost):
    """Add the merits of a polish to the history, between the best cost so far and its own, if it
    has found a better one."""
    best_cost = rounds.state.best_cost
    if cost < best_cost:
        for z in range(rounds.polish.iterations):
            _note(rounds, min(max(rounds.merits[z], cost), best_cost))


@compiled(**INLINE_FAST)
def _note(rounds, cost):
    """Add an entry to the history."""
    rounds.history[rounds.state.history_entries] = cost
    rounds.state.history_entries += 1


@compiled(**INLINE_FAST)
def _keep(rounds, u, cost):
    """Keep the sequence u (L,) if it costs least, and add the least cost to the history."""
    if cost < rounds.state.best_cost:
        rounds.state.best_cost = cost
        for j in range(u.size):
            rounds.best[j] = u[j]
    _note(rounds, rounds.state.best_cost)


@compiled(**INLINE_FAST)
def _scatter(problem, rollouts, key, warm, rounds):
    """Scatter a round's sequences, of which the best become the starts; return whether all their J
    are finite.

    Each sequence is linear between knots, directions drawn uniformly within UPPER of the bearing of
    the targets. With a warm start (L,), every second sequence is the warm start plus such a curve
    within WARM of 0.
    """
    draws = rounds.draws
    signals = rounds.scattered
    knots, particles = draws.shape
    bearing = _bearing(problem)
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
    if not costs(problem, rollouts, signals, rounds.scattered_costs):
        return False
    count = _sort(rounds.scattered_costs, rounds.order)
    for k in range(count):
        for j in range(length):
            rounds.starts[k, j] = signals[j, rounds.order[k]]
    rounds.state.rounds_begun += 1
    rounds.state.starts = count
    rounds.state.starts_done = 0
    rounds.state.evaluations += particles
    _keep(rounds, rounds.starts[0], rounds.scattered_costs[rounds.order[0]])
    return True


@compiled(**INLINE_FAST)
def _bearing(problem):
    """Return the mean direction from the robots to their targets [rad]."""
    east = 0.0
    north = 0.0
    for i in range(len(problem.robots)):
        east += problem.targets[i, 0] - problem.poses[i, 0]
        north += problem.targets[i, 1] - problem.poses[i, 1]
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
