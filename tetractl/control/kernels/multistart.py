"""A round of `tetractl.control.optimizers.multistart`: random sequences, and the polish of some."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.levenberg import Integers, judge, polish
from tetractl.control.kernels.options import ENTRY_FAST, inlined
from tetractl.control.kernels.rollout import costs
from tetractl.control.kernels.update import drawn
from tetractl.core.poses import Floats
from tetractl.model.motion import polynomials

BETWEEN_LOOKS = 130_000  # robot steps between two checks of the deadline, below 1 ms
WARM = 0.5  # largest distance of a scattered sequence from the warm start [rad]

_wrap = inlined(polynomials.wrap)
S11 = np.uint64(11)


class Polished(NamedTuple):
    """The result of each of up to K starts."""

    signals: Floats  # (K, L), within [-pi, pi]
    costs: Floats  # (K,) J
    steps: Integers  # (K,) iterations
    evaluations: Integers  # (K,) evaluations of the polish and of J
    merits: Floats  # (K, steps_max + 1) merit at first and after each iteration


@lru_cache(maxsize=64)
def workspace(thread: int, count: int, length: int, steps_max: int) -> Polished:
    """Return the arrays of one thread for a number of starts."""
    return Polished(
        signals=np.empty((count, length)),
        costs=np.empty(count),
        steps=np.zeros(count, dtype=np.int64),
        evaluations=np.zeros(count, dtype=np.int64),
        merits=np.empty((count, steps_max + 1)),
    )


@compiled(**ENTRY_FAST)
def improve(work, starts, done, tolerance, slack, patience, budget, look, polished):
    """Polish starts (K, L) from number `done` until one costs at most `tolerance`, within `budget`
    evaluations; return how many starts are polished.

    A positive `look` is a number of iterations after which the polish is interrupted; the next call
    continues it. A negative one ends the start that was begun as it is; 0 is no limit.
    """
    iterations, used = polished.merits.shape[1] - 1, 0
    while done < starts.shape[0] and (look <= 0 or used < look):
        u, z, merits = polished.signals[done], polished.steps[done], polished.merits[done]
        if z == 0:
            if budget < 2:
                break
            work.room.damping[0], polished.evaluations[done] = 0.0, 0
            for j in range(u.size):
                u[j] = starts[done, j]
        pause = 2**62 if look == 0 else max(z, z + look - used)
        now, more = polish(
            work, u, tolerance, slack, iterations, patience, budget - 1, merits, z, pause
        )
        polished.steps[done] = now
        polished.evaluations[done] += more
        used, budget = used + now - z + 1, budget - more
        if look > 0 and work.room.damping[0] < math.inf:
            break
        polished.costs[done] = judge(work, u)
        polished.evaluations[done] += 1
        budget, done = budget - 1, done + 1
        if look < 0 or not polished.costs[done - 1] > tolerance:
            break
    return done


@compiled(**ENTRY_FAST)
def scatter(rollout, key, middle, warm, draws, signals, total):
    """Fill signals (L, P) with smooth random sequences, and total (P,) with their J; return whether
    all are finite.

    Each sequence is linear between knots, directions drawn uniformly within pi of `middle`. With a
    warm start (L,), every second sequence is the warm start plus such a curve within WARM of 0;
    without one, `warm` is empty. draws (knots, P) is a scratch array.
    """
    knots, particles = draws.shape
    for k in range(knots):
        for n in range(particles):
            draw = drawn(key, k * particles + n) >> S11
            draws[k, n] = 2 * (np.float64(draw) * 2.0**-53) - 1
    length, every = signals.shape[0], 2 if warm.size else 1
    for j in range(length):
        at = j * (knots - 1) / max(length - 1, 1)
        below = min(int(at), max(knots - 2, 0))
        after, share = min(below + 1, knots - 1), at - below
        for n in range(every - 1, particles, every):
            curve = draws[below, n] * (1 - share) + draws[after, n] * share
            signals[j, n] = _wrap(middle + math.pi * curve)
        for n in range(0, particles if warm.size else 0, every):
            curve = draws[below, n] * (1 - share) + draws[after, n] * share
            signals[j, n] = _wrap(warm[j] + WARM * curve)
    return costs(rollout, signals, total)
