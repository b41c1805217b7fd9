"""Measures of a trial what Ou and others claim: errors, searches, space, fields that turn."""

import numpy as np

from tetractl.core.plan import Plan
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.log.read.trial_log import TrialLog

REVERSAL = 0.3
"""A field that turns back by up to this angle [rad] has not changed its sense."""
EARLY = 10
"""Number of iterations in which J falls quickly."""


def total_error(log: TrialLog) -> float:
    """Return the sum of the robots' distances to their targets at the end [length unit]."""
    assert log.result is not None, "a batch's trial has a result"
    return log.result.total_error


def error_of_a_robot(log: TrialLog) -> float:
    """Return the mean distance of the robots to their targets at the end [length unit]."""
    return total_error(log) / len(log.start.setup.names)


def entered(log: TrialLog) -> bool:
    """Return whether any robot's centre entered an obstacle."""
    return log.result is not None and log.result.entered_obstacle


def left(log: TrialLog) -> bool:
    """Return whether any robot's centre left the arena."""
    return log.result is not None and log.result.left_arena


def iterations(log: TrialLog) -> float:
    """Return the mean iteration at which criterion (20) ends a search."""
    ends = [len(search.history) - 1 for step in log.steps for search in step.plan.searches]
    return float(np.mean(ends))


def first_cost(log: TrialLog) -> float:
    """Return the cost J of the plan of step 0 [length unit]."""
    return log.steps[0].plan.cost


def warm_gain(log: TrialLog) -> float:
    """Compare the cost of a warm-started plan with the cost of a plan from nothing [length unit].

    The result is J of the plan of the middle step, found from a warm start by three searches, minus
    J of the plan that a controller finds there if it searches all lengths from nothing, as in step
    0.
    """
    middle = len(log.steps) // 2
    step = log.steps[middle]
    from_nothing = log.experiment.controller.build(log.start.setup, key=middle)
    decision = from_nothing.plan(step.observation, log.steps[middle - 1].command)
    assert isinstance(decision, Plan), "amid a trial the robots have not arrived"
    return step.plan.cost - decision.cost


def off_start(log: TrialLog) -> float:
    """Return the mean distance of stopped robots from where they started."""
    assert log.truth is not None, "the trials are simulated"
    moved = (log.truth[-1] - log.truth[0])[:, :2]
    distances = np.hypot(moved[:, 0], moved[:, 1])
    return float(distances.mean())


def chosen_history(log: TrialLog) -> Floats:
    """Return J after each iteration of the search whose plan step 0 took."""
    plan = log.steps[0].plan
    return plan.searches[plan.chosen].history


def early_share(log: TrialLog) -> float:
    """Return the share of a search's decrease of J that its first EARLY iterations bring."""
    j = chosen_history(log)
    return float((j[0] - j[EARLY]) / (j[0] - j[-1]))


def exponential(log: TrialLog) -> float:
    """Compare lines through log J and through J against the iteration, as a difference of R^2."""
    j = chosen_history(log)
    return _straightness(np.log(j)) - _straightness(j)


def _straightness(values: Floats) -> float:
    """Return R^2 of a line through values (n,) against their index."""
    index = np.arange(len(values))
    correlation = np.corrcoef(index, values)[0, 1]
    return float(correlation**2)


def space(log: TrialLog) -> float:
    """Divide the area of the box around all paths by that around starts and targets."""
    setup = log.start.setup
    assert log.truth is not None, "the trials are simulated"
    ends = np.concatenate([setup.starts.xy, setup.targets])
    paths = log.truth[:, :, :2].reshape(-1, 2)
    return _box(paths) / _box(ends)


def _box(points: Floats) -> float:
    """Return the area of the box around points (n, 2), some of which may be unknown."""
    known_points = points[np.isfinite(points).all(axis=1)]
    width, height = np.ptp(known_points, axis=0)
    return float(width * height)


def spinning(log: TrialLog) -> float:
    """Measure how long the field turns in one sense, over at least a whole turn [s].

    Reversals up to REVERSAL [s] are ignored.
    """
    directions = [step.plan.direction for step in log.steps]
    angle = np.array([np.nan if u is None else u for u in directions], dtype=float)
    time_s = log.steps_s
    turned = wrap(np.diff(angle))  # NaN where robots stand
    total_s = 0.0
    for begin, end in _runs(np.isfinite(turned)):
        counted = np.concatenate([[0.0], np.cumsum(turned[begin:end])])
        total_s += spinning_time(counted, time_s[begin : end + 1])
    return total_s


def _runs(holds: Bools) -> Integers:
    """Return the beginning and the end (K, 2) of each run of entries that hold.

    The end is after the last entry.
    """
    bordered = np.concatenate([[False], holds, [False]])
    bounds = np.flatnonzero(np.diff(bordered.astype(int)))
    return bounds.reshape(-1, 2)


def spinning_time(angle: Floats, time_s: Floats) -> float:
    """Measure how long a field spins [s]. Its angles (K,) [rad] count whole turns.

    The angle is cut where its sense changes by more than REVERSAL; a piece counts from a whole turn
    on.
    """
    total_s = 0.0
    begin = 0  # of the present piece
    farthest = 0  # in the sense of the piece
    sense = 0.0
    for k in range(1, len(angle)):
        ahead = sense * (angle[k] - angle[farthest])
        if ahead < -REVERSAL:
            total_s += _if_whole_turn(angle, time_s, begin, farthest)
            begin = farthest
            farthest = k
            sense = -sense
        elif ahead >= 0:
            sense = sense or float(np.sign(angle[k] - angle[begin]))
            farthest = k
    return total_s + _if_whole_turn(angle, time_s, begin, farthest)


def _if_whole_turn(angle: Floats, time_s: Floats, begin: int, end: int) -> float:
    """Return the time of a piece [s] if it turns through a whole turn, else 0."""
    turns = abs(angle[end] - angle[begin]) >= 2 * np.pi
    return float(time_s[end] - time_s[begin]) if turns else 0.0
