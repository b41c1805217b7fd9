"""Chooses between a detour and a stop if the plan no longer ends at the targets.

Algorithm 2 shortens its sequence from step to step. With few signals left, a late disturbance
cannot be corrected any more: three robots have six coordinates. If no length of H - 1, H, H + 1
ends within an accepted total error, longer sequences are searched from scratch, which lead the
robots round and back. The trial ends if stopping, at the best moment of the coming control period,
is as good as any plan. It also ends if neither a plan that keeps clear of all obstacles nor a way
out of the corner was found and a robot is about to enter an obstacle.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tetractl.control.cost import predict
from tetractl.control.delay import driven
from tetractl.control.lengths import GROWTH
from tetractl.control.margins import Margins
from tetractl.core.clock import SECOND
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, wrap

ENOUGH = 0.1  # share of the accepted error that ends the search for a longer sequence
ACCEPT_GROWTH = 0.1  # share by which the accepted error grows each time the robots go round
LATE_FROM, LATE_GROWTH = 0.5, 4.0  # from that part of the steps on it grows, up to that factor
LAST_S = 0.7  # last part of a plan, per robot, in which going round raises the accepted error [s]
LAST_LEAST_S = 2.0  # least length of that part, for few robots [s]
OUT_SIGNALS = 8  # signals of a way out of a corner
OUT_STARTS = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # its first directions [rad]
OUT_RATES = np.linspace(-6.0, 6.0, 13)  # its rates of change [rad/s]
FINAL_ROOM = 0.2  # weight of the final clearance relative to the least clearance on the path
MOMENTS = 40  # moments of the coming control period that are tried for the stop


@dataclass(frozen=True, slots=True)
class StopForecast:
    """A stop `delay_ns` from now, and the sum of distances to the targets that it is predicted to
    leave."""

    delay_ns: int
    error: float


def longer(count: int, most: int) -> Iterator[int]:
    """Yield growing lengths that exceed the present plan's by more than one, up to `most`
    signals.
    """
    length = count + 2
    while length <= most:
        yield length
        length = max(length + 1, round(GROWTH * length))


def growth(problem: Problem, count: int) -> float:
    """Return the factor of the accepted error for going round with `count` signals left."""
    nearly_done = count * problem.period <= max(LAST_LEAST_S, LAST_S * len(problem.a))
    return 1 + ACCEPT_GROWTH if nearly_done else 1.0


def late(part: float) -> float:
    """Return the factor by which the accepted error has grown when `part` of the steps is over, so
    that a trial ends at an acceptable stop before it has to end anywhere.
    """
    return LATE_GROWTH ** (max(part - LATE_FROM, 0) / (1 - LATE_FROM))


def best_stop(problem: Problem, direction: Floats, period_s: float) -> StopForecast:
    """Return the best moment of the coming control period for a stop.

    The robots are at the problem's poses when a stop sent now acts, and follow `direction` (N,)
    [rad], NaN for a robot that stands, until a later one does.
    """
    delays = np.arange(MOMENTS, dtype=np.float64) * (period_s / MOMENTS)
    x, y, _ = driven(problem, problem.poses, direction, delays[:, None])
    targets = problem.targets
    errors = np.hypot(x - targets[:, 0], y - targets[:, 1]).sum(axis=1)
    best = int(np.argmin(errors))
    return StopForecast(round(float(delays[best]) * SECOND), float(errors[best]))


def way_out(problem: Problem, margins: Margins, apart: float) -> Floats | None:
    """Return signals (OUT_SIGNALS,) that lead standing robots away from obstacles and walls, with
    at least the distance `apart` between two robots; None if no such sequence was found.

    Directions that change at a steady rate are tried, whatever the targets.
    """
    start, rate = (column.reshape(-1, 1) for column in np.meshgrid(OUT_STARTS, OUT_RATES))
    signals = wrap(start + rate * problem.period * np.arange(OUT_SIGNALS))
    path = predict(problem, signals)
    room = margins.room(path[..., 0], path[..., 1], apart)  # (OUT_SIGNALS + 1, B)
    least = room.min(axis=0)
    best = int(np.argmax(least + FINAL_ROOM * room[-1]))
    outside = room[0, best] < 0  # a robot already inside must not go deeper
    return signals[best] if least[best] > 0 or (outside and least[best] >= room[0, best]) else None
