"""The compiled search of the optimiser `multistart`: try random sequences, and improve the best.

To polish a sequence of signals is to improve it by the Levenberg-Marquardt method (`levenberg`).
The sequences that a search polishes, one after the other, are its *starts*. A search passes through
these stages:

    WARM     the warm start, which is the previous plan, is evaluated as it is; it becomes the first
             start. A search without a warm start skips this stage
    POLISH   a start is polished, and the result is evaluated
    SCATTER  no start is left: many random sequences are generated, which is a *round*. The best of
             them become the next starts

`search` continues a search as far as the caller allows, and returns whether it has ended:

    UNDER_WAY   not ended: the iterations that were allowed are done
    GOOD        a start costs at most the tolerance
    SPENT       the budget allows no further evaluation
    OVER        all starts of the last round are polished
    NOT_FINITE  a cost is not a finite number
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tetractl.control.search.kernels.elementary import atan2
from tetractl.control.search.kernels.levenberg import (
    POLISH_STATE,
    Integers,
    PolishSettings,
    Workspace,
    polish,
    wrap_and_evaluate,
)
from tetractl.control.search.kernels.motion import FlatProblem
from tetractl.control.search.kernels.rollout import Rollouts, compute_costs
from tetractl.control.search.kernels.update import random_bits
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials
from tetractl.model.motion.motion import UPPER
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, INLINE_FAST, PART_FAST, inlined

ROBOT_STEPS_PER_CHECK = 130_000
"""Number of robot steps between two checks of the deadline. They take less than 1 ms."""
NEAR_WARM = 0.5
"""Maximum difference of a random sequence around the warm start from the warm start [rad]."""
FRACTION_SHIFT = np.uint64(11)
"""Shift of a random number [bits] that leaves the 53 bits of a float64's fraction."""
UNLIMITED = 2**62
"""A number of evaluations, or of iterations, that no search reaches."""

WARM = 0
POLISH = 1
SCATTER = 2

UNDER_WAY = 0
GOOD = 1
SPENT = 2
OVER = 3
NOT_FINITE = 4

_wrap = inlined(polynomials.wrap)

SEARCH_STATE = np.dtype(
    [
        ("stage", np.int64),  # WARM, POLISH or SCATTER, which is to begin or under way
        ("rounds_begun", np.int64),  # that were scattered
        ("starts", np.int64),  # of the present round
        ("starts_done", np.int64),  # those of them that are polished
        ("evaluations", np.int64),  # all but those of the polish under way
        ("history_entries", np.int64),
        ("best_cost", np.float64),  # J of the best sequence
    ]
)
"""The progress of a search, from which it continues after a check of the deadline."""


class SearchTask(NamedTuple):
    """The task of one search: the problem, the working arrays, the settings and the limits."""

    problem: FlatProblem
    rollouts: Rollouts
    workspace: Workspace
    settings: PolishSettings
    key: np.uint64
    """Key that determines all random numbers of the search."""
    warm: Floats
    """The warm start [rad], shape (L,). Empty if there is none."""
    rounds: int
    """Maximum number of rounds of random sequences."""
    budget: int
    """Maximum number of cost evaluations."""


class Rounds(NamedTuple):
    """The arrays and the state of a search that polishes K of P random sequences in a round."""

    scattered: Floats
    """The random sequences of the present round [rad], one per column, shape (L, P)."""
    scattered_costs: Floats
    """The cost J of each random sequence, shape (P,)."""
    draws: Floats
    """Random numbers from -1 to 1 for the knots of the random sequences, shape (knots, P)."""
    order: Integers
    """Indices of the best random sequences, lowest cost first, shape (K,)."""
    starts: Floats
    """The sequences to polish [rad], best first, shape (K, L)."""
    signals: Floats
    """The sequence under polish, or the last one [rad], shape (L,).

    When its polish has ended, all its signals are within [-pi, pi].
    """
    merits: Floats
    """The merit of this sequence at first and after each iteration, shape (steps_max + 1,)."""
    best: Floats
    """The best sequence found so far [rad], shape (L,)."""
    history: Floats
    """Lowest cost J before and after each polish, and the merits on the way to a new best one.

    Only the first `history_entries` are in use.
    """
    polish: Any
    """The progress of the polish under way, or of the last one (`POLISH_STATE`)."""
    state: Any
    """The progress of the search (`SEARCH_STATE`)."""

    def begin(self, stage: int, starts: Floats) -> None:
        """Set the search to its beginning: a stage, and up to K starts of shape (S, L)."""
        self.starts[: len(starts)] = starts
        self.polish.evaluations = 0
        self.state.stage = stage
        self.state.rounds_begun = 0
        self.state.starts = len(starts)
        self.state.starts_done = 0
        self.state.evaluations = 0
        self.state.history_entries = 0
        self.state.best_cost = math.inf

    def evaluations_if_finished(self) -> int:
        """Return the number of evaluations that the search will have used if it is ended now.

        This includes the evaluations that are needed to end it properly.
        """
        if self.state.stage == WARM:
            return 1
        if self.polish.evaluations > 0:
            return int(self.state.evaluations + self.polish.evaluations) + 1
        if self.state.evaluations > 0:
            return int(self.state.evaluations)
        return self.scattered_costs.size + 2


@lru_cache(maxsize=64)
def rounds_for(
    thread: int, count: int, particles: int, knots: int, length: int, steps_max: int, rounds: int
) -> Rounds:
    """Allocate the arrays of one thread for searches of the given sizes.

    Args:
        thread: Id of the thread.
        count: Maximum number of starts that are polished in a round.
        particles: Number of scattered sequences in a round.
        knots: Number of random directions in a scattered sequence.
        length: Number of signals in a sequence.
        steps_max: Maximum number of iterations for a start.
        rounds: Maximum number of rounds.
    """
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
def search(task, rounds, iterations):
    """Continue a search for about a given number of iterations.

    The search pauses between two iterations of a polish, or when a start is done, so that the
    caller can check the deadline.

    Args:
        task: What to search.
        rounds: The arrays and state of the search.
        iterations: Number of iterations.

    Returns:
        Whether the search has ended, and why.
    """
    state = rounds.state
    iterations_left = iterations
    while iterations_left > 0:
        if state.stage == SCATTER:
            end = _scatter(task, rounds)
            if end != UNDER_WAY:
                return end
            iterations_left -= rounds.scattered_costs.size // task.workspace.residual.size
        if rounds.polish.evaluations == 0:
            _load_start(rounds)
        if state.stage == POLISH:
            if state.evaluations + 2 > task.budget:
                return SPENT
            iterations_before = rounds.polish.iterations
            is_paused = polish(
                task.problem,
                task.workspace,
                rounds.signals,
                task.settings,
                task.budget - state.evaluations - 1,
                rounds.merits,
                rounds.polish,
                iterations_before + max(1, iterations_left),
            )
            if is_paused:
                return UNDER_WAY
            iterations_left -= rounds.polish.iterations - iterations_before
        end = _end_start(task, rounds)
        iterations_left -= 1
        if end != UNDER_WAY:
            return end
    return UNDER_WAY


def finish(task: SearchTask, rounds: Rounds) -> int:
    """End a search at its deadline: evaluate the sequence under polish as it is now.

    If no sequence is under polish, the next one is evaluated instead.

    Returns:
        Whether the search has ended by itself, and why: UNDER_WAY, GOOD, SPENT, OVER, NOT_FINITE.
    """
    settings = task.settings._replace(iterations_max=0)
    return search(task._replace(settings=settings), rounds, 1)


@compiled(**PART_FAST)
def _scatter(task, rounds):
    """Generate the random sequences of the next round, and take the best of them as starts.

    Returns:
        Whether the search has ended, so that no round was begun.
    """
    state = rounds.state
    signals = rounds.scattered
    length, particles = signals.shape
    if state.rounds_begun == task.rounds:
        return OVER
    if state.evaluations > 0 and state.evaluations + particles > task.budget:
        return SPENT
    _draw_sequences(task, random_bits(task.key, state.rounds_begun), rounds)
    if not compute_costs(task.problem, task.rollouts, signals, rounds.scattered_costs):
        return NOT_FINITE
    count = _find_lowest(rounds.scattered_costs, rounds.order)
    for k in range(count):
        for j in range(length):
            rounds.starts[k, j] = signals[j, rounds.order[k]]
    state.stage = POLISH
    state.rounds_begun += 1
    state.starts = count
    state.starts_done = 0
    state.evaluations += particles
    _keep_if_best(rounds, rounds.starts[0], rounds.scattered_costs[rounds.order[0]])
    return UNDER_WAY


@compiled(**PART_FAST)
def _draw_sequences(task, key, rounds):
    """Fill `scattered` with random sequences that change smoothly.

    Each sequence interpolates linearly between a few random directions, its knots, which are
    uniform within UPPER of the mean direction to the targets. With a warm start, every second
    sequence is the warm start plus such a curve within NEAR_WARM of 0.
    """
    draws = rounds.draws
    signals = rounds.scattered
    warm = task.warm
    knots, particles = draws.shape
    bearing = _compute_mean_bearing(task.problem)
    for k in range(knots):
        for n in range(particles):
            bits = random_bits(key, k * particles + n) >> FRACTION_SHIFT
            draws[k, n] = 2 * (np.float64(bits) * 2.0**-53) - 1
    length = signals.shape[0]
    has_warm_start = 1 if warm.size else 0
    for j in range(length):
        knot_position = j * (knots - 1) / max(length - 1, 1)  # among the knots
        knot_below = min(int(knot_position), max(knots - 2, 0))
        knot_above = min(knot_below + 1, knots - 1)
        fraction = knot_position - knot_below
        center = warm[j] if has_warm_start else bearing
        for n in range(particles):
            curve = draws[knot_below, n] * (1 - fraction) + draws[knot_above, n] * fraction
            near_warm = has_warm_start & ~n  # for even n: vector code needs a number
            u = center + NEAR_WARM * curve if near_warm else bearing + UPPER * curve
            signals[j, n] = _wrap(u)


@compiled(**PART_FAST)
def _load_start(rounds):
    """Make the next start the sequence to polish."""
    rounds.polish.iterations = 0
    u = rounds.signals
    for j in range(u.size):
        u[j] = rounds.starts[rounds.state.starts_done, j]


@compiled(**PART_FAST)
def _end_start(task, rounds):
    """Compute the cost of a polished sequence, and keep the sequence if it is the best so far.

    Returns:
        Whether the search has ended with it: GOOD, NOT_FINITE or UNDER_WAY.
    """
    state = rounds.state
    cost = wrap_and_evaluate(task.problem, task.workspace, rounds.signals)
    if not math.isfinite(cost):
        return NOT_FINITE
    state.evaluations += rounds.polish.evaluations + 1
    rounds.polish.evaluations = 0
    _append_merits(rounds, cost)
    _keep_if_best(rounds, rounds.signals, cost)
    if state.stage == WARM:
        state.stage = POLISH
        return UNDER_WAY
    state.starts_done += 1
    if state.starts_done == state.starts:
        state.stage = SCATTER
    return GOOD if cost <= task.settings.tolerance else UNDER_WAY


@compiled(**PART_FAST)
def _append_merits(rounds, cost):
    """Add the merits of a polish to the history if the polish has found a better sequence.

    They are limited to the range between the best cost so far and the new cost.
    """
    best_cost = rounds.state.best_cost
    if cost < best_cost:
        for z in range(rounds.polish.iterations):
            _append_to_history(rounds, min(max(rounds.merits[z], cost), best_cost))


@compiled(**PART_FAST)
def _keep_if_best(rounds, u, cost):
    """Keep the sequence u (L,) if it costs the least so far, and add its cost to the history."""
    if cost < rounds.state.best_cost:
        rounds.state.best_cost = cost
        for j in range(u.size):
            rounds.best[j] = u[j]
    _append_to_history(rounds, rounds.state.best_cost)


@compiled(**PART_FAST)
def _append_to_history(rounds, cost):
    """Append a cost to the history of the search."""
    rounds.history[rounds.state.history_entries] = cost
    rounds.state.history_entries += 1


@compiled(**INLINE_FAST)
def _compute_mean_bearing(problem):
    """Compute the mean direction from the robots to their targets [rad]."""
    east = 0.0
    north = 0.0
    for i in range(len(problem.robots)):
        east += problem.targets[i, 0] - problem.poses[i, 0]
        north += problem.targets[i, 1] - problem.poses[i, 1]
    return atan2(north, east)


@compiled(**PART_FAST)
def _find_lowest(scattered_costs, order):
    """Find the K lowest costs, and fill `order` (K,) with their indices in ascending order of cost.

    Of equal costs, the first comes first. The function inserts each cost into those already sorted.
    It returns their number.
    """
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
