"""Measures of one trial for the claims of Ou and others.

They are errors, searches, the space that robots use, and fields that rotate.
"""

import numpy as np

from tetractl.core.plan import Plan
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.log.read.trial_log import TrialLog

REVERSAL = 0.3
"""Maximum angle by which a field may turn back without changing its sense of rotation [rad]."""
EARLY = 10
"""Number of iterations in which J falls quickly."""


def total_error(log: TrialLog) -> float:
    """Return the sum of the robots' final distances to their targets [length unit].

    The log must have a result.
    """
    assert log.result is not None, "a batch's trial has a result"
    return log.result.total_error


def error_of_a_robot(log: TrialLog) -> float:
    """Return the mean of the robots' final distances to their targets [length unit].

    The log must have a result.
    """
    return total_error(log) / len(log.start.setup.names)


def entered(log: TrialLog) -> bool:
    """Return whether any robot's centre entered an obstacle during the trial.

    The result is False if the log has no result.
    """
    return log.result is not None and log.result.entered_obstacle


def left(log: TrialLog) -> bool:
    """Return whether any robot's centre left the arena during the trial.

    The result is False if the log has no result.
    """
    return log.result is not None and log.result.left_arena


def iterations(log: TrialLog) -> float:
    """Return the mean number of iterations, over all searches of a trial, until (20) ended them."""
    ends = [len(search.history) - 1 for step in log.steps for search in step.plan.searches]
    return float(np.mean(ends))


def first_cost(log: TrialLog) -> float:
    """Return the cost J of the plan of step 0 [length unit]."""
    return log.steps[0].plan.cost


def warm_gain(log: TrialLog) -> float:
    """Compute how much a warm start changes the cost of the plan in the middle of a trial.

    Returns:
        J of the logged plan, which three searches found from a warm start, minus J of the plan that
        a new controller finds if it searches all lengths without a warm start, as in step 0 [length
        unit].
    """
    middle = len(log.steps) // 2
    step = log.steps[middle]
    from_nothing = log.experiment.controller.build(log.start.setup, key=middle)
    decision = from_nothing.plan(step.observation, log.steps[middle - 1].command)
    assert isinstance(decision, Plan), "amid a trial the robots have not arrived"
    return step.plan.cost - decision.cost


def off_start(log: TrialLog) -> float:
    """Return the robots' mean distance between first and last true position [length unit].

    The trial must be simulated.
    """
    assert log.truth is not None, "the trials are simulated"
    moved = (log.truth[-1] - log.truth[0])[:, :2]
    distances = np.hypot(moved[:, 0], moved[:, 1])
    return float(distances.mean())


def chosen_history(log: TrialLog) -> Floats:
    """Return J after each iteration of the search that found the plan of step 0 [length unit].

    The first value is J before the first iteration.
    """
    plan = log.steps[0].plan
    return plan.searches[plan.chosen].history


def early_share(log: TrialLog) -> float:
    """Return the fraction of J's decrease in the search of step 0 that EARLY iterations achieve."""
    j = chosen_history(log)
    return float((j[0] - j[EARLY]) / (j[0] - j[-1]))


def exponential(log: TrialLog) -> float:
    """Compare how well J falls exponentially and linearly in the search of step 0.

    Returns:
        R^2 of a line through log J against the iteration, minus R^2 of a line through J.
    """
    j = chosen_history(log)
    return _straightness(np.log(j)) - _straightness(j)


def _straightness(values: Floats) -> float:
    """Compute R^2 of a line through values (n,) against their indices."""
    index = np.arange(len(values))
    correlation = np.corrcoef(index, values)[0, 1]
    return float(correlation**2)


def space(log: TrialLog) -> float:
    """Compute the area of the paths' bounding box, relative to that of all starts and targets.

    The paths are the true ones, so the trial must be simulated.
    """
    setup = log.start.setup
    assert log.truth is not None, "the trials are simulated"
    ends = np.concatenate([setup.starts.xy, setup.targets])
    paths = log.truth[:, :, :2].reshape(-1, 2)
    return _box(paths) / _box(ends)


def _box(points: Floats) -> float:
    """Compute the area of the bounding box of points (n, 2). Points with NaN are ignored."""
    known_points = points[np.isfinite(points).all(axis=1)]
    width, height = np.ptp(known_points, axis=0)
    return float(width * height)


def spinning(log: TrialLog) -> float:
    """Compute for how long the field turns in one sense through at least a whole turn [s].

    Reversals up to REVERSAL [rad] are ignored.
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
    """Find each run of consecutive True values.

    Returns:
        The first index and the index after the last one of each run, shape (K, 2).
    """
    bordered = np.concatenate([[False], holds, [False]])
    bounds = np.flatnonzero(np.diff(bordered.astype(int)))
    return bounds.reshape(-1, 2)


def spinning_time(angle: Floats, time_s: Floats) -> float:
    """Compute for how long a field turns in one sense through at least a whole turn [s].

    The angle is split into pieces where it turns back by more than REVERSAL. Only pieces of at
    least a whole turn count.

    Args:
        angle: Unwrapped angle of the field, shape (K,) [rad].
        time_s: Times of the angles, shape (K,) [s].
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
    """Return the duration of a piece [s], or 0 if the angle [rad] changes by less than a turn.

    `begin` and `end` are the indices of its first and last sample.
    """
    turns = abs(angle[end] - angle[begin]) >= 2 * np.pi
    return float(time_s[end] - time_s[begin]) if turns else 0.0
