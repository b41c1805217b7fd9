"""Polishes the starts of a round of `tetractl.control.optimizers.multistart`."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.levenberg import Integers, Polish, polish
from tetractl.control.kernels.rollout import Rollout, costs
from tetractl.core.plan import never
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials

BETWEEN_LOOKS = 130_000  # robot steps between two checks of the deadline, below 1 ms


class Polished(NamedTuple):
    """The result of each of up to K starts, updated in place."""

    signals: Floats  # (K, L), within [-pi, pi]
    costs: Floats  # (K,) J
    steps: Integers  # (K,) iterations
    evaluations: Integers  # (K,) evaluations of the polish, without the one of J
    merits: Floats  # (K, steps_max + 1) merit after each iteration


def workspace(count: int, length: int, steps_max: int) -> Polished:
    """Return the arrays for a number of starts."""
    return Polished(
        signals=np.empty((count, length)),
        costs=np.empty(count),
        steps=np.empty(count, dtype=np.int64),
        evaluations=np.empty(count, dtype=np.int64),
        merits=np.empty((count, steps_max + 1)),
    )


def polish_each(
    work: Polish,
    one: Rollout,
    starts: Floats,
    tolerance: float,
    slack: float,
    patience: int,
    budget: int,
    factor: Floats,
    polished: Polished,
    expired: Callable[[int], bool] = never,
) -> int:
    """Polish starts (K, L) until one costs at most `tolerance`, within `budget` evaluations.

    `one` is a rollout of one particle. Returns how many starts were polished; `polished` holds
    their results. `expired`, given the evaluations that a start would have taken if it ended now,
    may end its polish early. This loop is not compiled: two kernels compile in half the time of one
    that calls both, and run as fast.
    """
    iterations, spent = polished.merits.shape[1] - 1, 0
    stride = max(1, BETWEEN_LOOKS // (work.residual.size * work.a.size * starts.shape[1]))
    for done, start in enumerate(starts):
        if spent + 2 > budget:
            return done
        u, cost = polished.signals[done], polished.costs[done : done + 1]
        u[:] = start
        left, merits, z, evaluations = budget - spent - 1, polished.merits[done], 0, 0
        work.damping[0] = 0.0
        while work.damping[0] < math.inf and not (evaluations and expired(evaluations + 1)):
            rest, pause = left - evaluations, 2**62 if expired is never else z + stride
            _, z, more = polish(
                work, u, tolerance, slack, iterations, patience, rest, factor, merits, z, pause
            )
            evaluations += more
        u[:] = polynomials.wrap(u)
        costs(one, u.reshape(-1, 1), cost)
        polished.steps[done], polished.evaluations[done] = z, evaluations
        spent += evaluations + 1
        if cost[0] <= tolerance:
            return done + 1
    return len(starts)
