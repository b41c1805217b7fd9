"""How the ends of a plan depend on what is sent, on the robots, and on their headings.

A step moves robot i by d(heading, u) and turns it by w(heading, u). With g_j, how its end depends
on its heading before signal j (g_L = 0), the chain rule backwards in time gives

    d end / d u_j = dd/du + g_{j+1} dw/du,      g_j = dd/dheading + g_{j+1} (1 + dw/dheading)

and likewise for its a and speed. The derivatives of a step are those that the optimiser's kernels
use, of the problem's motion; those by a and speed are central differences.
"""

import math
from dataclasses import dataclass

import numpy as np

from tetractl.control.cost import predict
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem
from tetractl.core.registries import MOTIONS

NUDGE = 1e-4  # relative change of a and speed for a central difference


@dataclass(frozen=True, slots=True)
class Linear:
    """A plan of L signals for N robots, linearised; lengths in the spec's unit.

    `miss` (N,) is the planned distance of each robot's end to its target. Derivatives of the ends:
    `by_signal` (2N, L), of x_1, y_1, x_2, ..., by the signals [1/rad]; `by_heading` (L + 1, N, 2)
    by the heading before each signal and at the end [1/rad]. `by_a` and `by_speed` (L, N, 2) are
    those by the logarithms of a and speed in force during each signal alone, and `turn_by_a` (L, N)
    how the turn of one signal depends on ln a [rad]. `onward` (2N, 1) is the displacement of the
    ends by one more signal of straight motion, and `seconds` (L,) how long each signal is held.
    """

    miss: Floats
    by_signal: Floats
    by_heading: Floats
    by_a: Floats
    by_speed: Floats
    turn_by_a: Floats
    onward: Floats
    seconds: Floats


def linearise(problem: Problem, signals: Floats) -> Linear:
    """Linearise the path under a sequence (L,)."""
    count, length = len(problem.a), len(signals)
    path = predict(problem, signals)
    heading = path[:-1, :, 2]
    seconds = np.full(length, problem.period)
    seconds[0] = problem.first_period
    by_turn, by_u, turn = _steps(problem, heading, signals, seconds)
    of_a, of_speed = (_by_logarithm(problem, heading, signals, seconds, which) for which in (0, 1))
    g = np.zeros((length + 1, count, 2))
    for j in reversed(range(length)):
        g[j] = by_turn[j] + g[j + 1] * turn[j, :, None]
    later = g[1:]
    by_signal = by_u + later * (1 - turn)[..., None]  # (L, N, 2)
    end = path[-1]
    onward = (
        problem.period
        * problem.speed[:, None]
        * np.stack([np.cos(end[:, 2]), np.sin(end[:, 2])], axis=-1)
    )
    return Linear(
        miss=np.hypot(*(end[:, :2] - problem.targets).T),
        by_signal=by_signal.transpose(1, 2, 0).reshape(2 * count, length),
        by_heading=g,
        by_a=of_a[..., :2] + later * of_a[..., 2:],
        by_speed=of_speed[..., :2] + later * of_speed[..., 2:],
        turn_by_a=of_a[..., 2],
        onward=onward.reshape(2 * count, 1),
        seconds=seconds,
    )


def _steps(
    problem: Problem, heading: Floats, signals: Floats, seconds: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return how each step depends on heading and signal, (L, N, 2) each, and its KEEP (L, N).

    KEEP is how the next heading depends on the one before; on the signal it depends by 1 - KEEP.
    """
    lanes = MOTIONS.load(problem.motion).lanes(problem.a, float(seconds.max()))
    robots = list(zip(problem.a.tolist(), problem.speed.tolist(), strict=True))
    steps = zip(np.exp(1j * heading).tolist(), signals.tolist(), seconds.tolist(), strict=True)
    rows = [
        [
            lanes.differentiate(at.real, at.imag, math.cos(u), math.sin(u), a, v, t)
            for at, (a, v) in zip(row, robots, strict=True)
        ]
        for row, u, t in steps
    ]
    found = np.array(rows)  # (L, N, 8)
    return found[..., 3:5], found[..., 5:7], found[..., 7]


def _by_logarithm(
    problem: Problem, heading: Floats, signals: Floats, seconds: Floats, which: int
) -> Floats:
    """Return how each step's dx, dy and turn depend on ln a (`which` 0) or ln speed, (L, N, 3)."""
    step, zero = MOTIONS.load(problem.motion).step, np.zeros_like(heading)

    def moved(factor: float) -> Floats:
        scale = [1.0, 1.0]
        scale[which] = factor
        a, v = problem.a * scale[0], problem.speed * scale[1]
        return np.stack(
            step(zero, zero, heading, signals[:, None], a, v, seconds[:, None]), axis=-1
        )

    return (moved(1 + NUDGE) - moved(1 - NUDGE)) / (2 * NUDGE)
