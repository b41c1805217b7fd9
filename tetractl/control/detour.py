"""Chooses between a detour and a stop if the plan no longer ends at the targets.

Algorithm 2 shortens its sequence from step to step. The few signals left near its end cannot
correct the 2N coordinates of N robots. If no sequence of length H - 1, H or H + 1, with H the
length of the present plan, ends within the accepted total error, longer sequences are searched from
scratch; these lead the robots away from their targets and back. The trial ends if stopping at the
best moment of the coming control period is as good as any plan. If every plan for standing robots
touches an obstacle, they drive along a way out of the corner; if none keeps clear, they first turn
on the spot. If that gives none either and a robot is about to enter an obstacle, the trial ends.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.cost import predict
from tetractl.control.delay import driven
from tetractl.control.lengths import GROWTH
from tetractl.control.margins import Margins
from tetractl.core.clock import SECOND
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Poses, wrap
from tetractl.model.motion.exact import step as exact

ENOUGH = 0.1  # the search for a detour ends at a cost of this fraction of the accepted error
ACCEPT_GROWTH = 0.1  # fraction by which the accepted error grows with each detour
# after a fraction LATE_FROM of the steps the accepted error grows, up to LATE_GROWTH times
LATE_FROM, LATE_GROWTH = 0.5, 4.0
LAST_S = 0.7  # time per robot before a plan's end in which a detour raises the accepted error [s]
LAST_LEAST_S = 2.0  # least value of that time, for all robots together [s]
OUT_SIGNALS = 8  # number of signals of a way out of a corner
OUT_ROOM_S, OUT_SHARE = 0.1, 0.8  # clearance kept on a way out, see `way_out`
OUT_STARTS = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # first directions tried [rad]
OUT_RATES = np.linspace(-6.0, 6.0, 13)  # rates of change of the direction tried [rad/s]
TURN_TO = np.linspace(-np.pi, np.pi, 24, endpoint=False)  # directions tried for a turn [rad]
TURN_S = 1.5  # time of turning after which robots must have a way out [s]
FINAL_ROOM = 0.2  # weight of the final clearance relative to the least clearance on the path
MOMENTS = 40  # number of moments of the coming control period that are tried for the stop


@dataclass(frozen=True, slots=True)
class StopForecast:
    """A stop `delay_ns` from now, and the predicted sum of distances to the targets after it."""

    delay_ns: int
    error: float


def longer(count: int, most: int) -> Iterator[int]:
    """Yield growing lengths [signals] from `count` + 2 to `most`; `count` is the plan's length."""
    length = count + 2
    while length <= most:
        yield length
        length = max(length + 1, round(GROWTH * length))


def growth(problem: Problem, count: int) -> float:
    """Return the factor by which a detour raises the accepted error: 1 unless few signals are left
    (`count`) of the plan that the detour replaces."""
    nearly_done = count * problem.period <= max(LAST_LEAST_S, LAST_S * len(problem.a))
    return 1 + ACCEPT_GROWTH if nearly_done else 1.0


def late(part: float) -> float:
    """Return the factor by which the accepted error is multiplied after a fraction `part` of the
    steps. The factor grows, so that a trial ends with a good stop before its last step.
    """
    return LATE_GROWTH ** (max(part - LATE_FROM, 0) / (1 - LATE_FROM))


def best_stop(problem: Problem, direction: Floats, period_s: float) -> StopForecast:
    """Return the stop within the coming control period that leaves the least sum of distances.

    The problem's poses are those at which a stop sent now acts. Until a later stop acts, robots
    follow `direction` (N,) [rad], NaN for a robot that stands still.
    """
    delays = np.arange(MOMENTS, dtype=np.float64) * (period_s / MOMENTS)
    x, y, _ = driven(problem, problem.poses, direction, delays[:, None])
    targets = problem.targets
    errors = np.hypot(x - targets[:, 0], y - targets[:, 1]).sum(axis=1)
    best = int(np.argmin(errors))
    return StopForecast(round(float(delays[best]) * SECOND), float(errors[best]))


def way_out(
    problem: Problem, margins: Margins, apart: float, keep_s: float = OUT_ROOM_S
) -> Floats | None:
    """Return signals (OUT_SIGNALS,) that lead standing robots away from obstacles and walls, with
    at least the distance `apart` between two robots; None if none was found.

    Sequences whose direction changes at a constant rate are tried; targets are ignored. The
    clearance is at least the way that the fastest robot drives in `keep_s` [s], or the fraction
    OUT_SHARE of the present clearance if that is less.
    """
    signals, least, _ = _roomiest(problem, margins, apart, keep_s)
    return signals if least > -np.inf else None


def away(
    problem: Problem, margins: Margins, apart: float, may_turn: bool
) -> tuple[Floats | None, float | None]:
    """Return a way out for standing robots or, if none keeps clear and robots `may_turn`, the
    direction [rad] to which they turn first; otherwise the best way out that enters nothing."""
    out = way_out(problem, margins, apart)
    facing = turn_away(problem, margins, apart) if out is None and may_turn else None
    if out is None and facing is None:
        out = way_out(problem, margins, apart, 0.0)
    return out, facing


def turn_away(problem: Problem, margins: Margins, apart: float) -> float | None:
    """Return the direction [rad] towards which standing robots turn on the spot so that they have a
    way out after TURN_S; None if no direction gives one.
    """
    x, y, heading = problem.poses.x, problem.poses.y, problem.poses.heading
    bias, found = 0.0 if problem.bias is None else problem.bias, []
    for facing in TURN_TO.tolist():
        towards = facing + bias + np.zeros_like(heading)
        turned = Poses(x, y, exact(x, y, heading, towards, problem.a, problem.speed, TURN_S)[2])
        _, *room = _roomiest(replace(problem, poses=turned), margins, apart, OUT_ROOM_S)
        found.append((*room, facing))
    least, _, facing = max(found)
    return facing if least > -np.inf else None


def _roomiest(
    problem: Problem, margins: Margins, apart: float, keep_s: float
) -> tuple[Floats, float, float]:
    """Return the best signals for `way_out`; the least clearance on their path [length unit], -inf
    for an unsafe path; and that clearance plus FINAL_ROOM times the clearance at the path's end."""
    start, rate = (column.reshape(-1, 1) for column in np.meshgrid(OUT_STARTS, OUT_RATES))
    signals = wrap(start + rate * problem.period * np.arange(OUT_SIGNALS))
    path = predict(problem, signals)
    room = margins.room(path[..., 0], path[..., 1], apart)  # (OUT_SIGNALS + 1, B)
    least = room.min(axis=0)
    total = least + FINAL_ROOM * room[-1]
    best = int(np.argmax(total))
    now = float(room[0, best])  # below 0 inside an obstacle: robots must not go deeper
    safe = least[best] >= (min(keep_s * problem.speed.max(), OUT_SHARE * now) if now > 0 else now)
    return signals[best], float(least[best]) if safe else -np.inf, float(total[best])
