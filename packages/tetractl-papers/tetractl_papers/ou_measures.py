"""Measures of one trial for the claims of the paper by Ou and others.

The measures concern the final errors, the searches for plans, the space that robots use, and the
rotation of the field.
"""

import numpy as np

from tetractl.core.plan import Plan
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.log.read.trial_log import TrialLog

REVERSAL_MAX_RAD = 0.3
"""Maximum angle by which a field may turn back without changing its sense of rotation [rad]."""
EARLY_ITERATIONS = 10
"""Number of iterations at the start of a search in which the cost J should fall quickly."""


def get_total_error(log: TrialLog) -> float:
    """Return the sum of the robots' distances to their targets at the end of a trial [length unit].

    The log must have a result.
    """
    assert log.result is not None, "a batch's trial has a result"
    return log.result.total_error


def mean_robot_error(log: TrialLog) -> float:
    """Compute the robots' mean distance to their targets at the end of a trial [length unit].

    The log must have a result.
    """
    return get_total_error(log) / len(log.start.setup.names)


def entered_obstacle(log: TrialLog) -> bool:
    """Check whether any robot's centre entered an obstacle during a trial.

    The result is False if the log has no result.
    """
    return log.result is not None and log.result.entered_obstacle


def left_arena(log: TrialLog) -> bool:
    """Check whether any robot's centre left the arena during a trial.

    The result is False if the log has no result.
    """
    return log.result is not None and log.result.left_arena


def mean_iterations(log: TrialLog) -> float:
    """Compute the mean number of iterations until criterion (20) ended a search of a trial."""
    iteration_counts = [
        len(search.history) - 1 for step in log.steps for search in step.plan.searches
    ]
    return float(np.mean(iteration_counts))


def first_cost(log: TrialLog) -> float:
    """Return the cost J of the plan of a trial's step 0 [length unit]."""
    return log.steps[0].plan.cost


def warm_start_cost_change(log: TrialLog) -> float:
    """Compute how much a warm start changes the cost J of the plan in the middle of a trial.

    Returns:
        J of the logged plan, which three searches found from a warm start, minus J of the plan that
        a new controller finds if it searches all lengths without a warm start, as in step 0 [length
        unit].
    """
    middle_step = len(log.steps) // 2
    step = log.steps[middle_step]
    new_controller = log.experiment.controller.build(log.start.setup, key=middle_step)
    decision = new_controller.plan(step.observation, log.steps[middle_step - 1].command)
    assert isinstance(decision, Plan), "amid a trial the robots have not arrived"
    return step.plan.cost - decision.cost


def mean_displacement(log: TrialLog) -> float:
    """Compute the robots' mean distance between their first and last true positions [length unit].

    The trial must be simulated.
    """
    assert log.truth is not None, "the trials are simulated"
    displacements = (log.truth[-1] - log.truth[0])[:, :2]
    distances = np.hypot(displacements[:, 0], displacements[:, 1])
    return float(distances.mean())


def chosen_cost_history(log: TrialLog) -> Floats:
    """Return the cost J after each iteration of the search that found the plan of step 0.

    The costs are in the length unit. The first value is J before the first iteration.
    """
    plan = log.steps[0].plan
    return plan.searches[plan.chosen].history


def early_decrease_fraction(log: TrialLog) -> float:
    """Compute which fraction of the decrease of J in step 0 happens in EARLY_ITERATIONS."""
    costs = chosen_cost_history(log)
    return float((costs[0] - costs[EARLY_ITERATIONS]) / (costs[0] - costs[-1]))


def exponential_fit_advantage(log: TrialLog) -> float:
    """Compare an exponential and a linear fit of the cost J in the search of step 0.

    Returns:
        R^2 of a line through log J against the iteration, minus R^2 of a line through J.
    """
    costs = chosen_cost_history(log)
    return _linear_r_squared(np.log(costs)) - _linear_r_squared(costs)


def _linear_r_squared(values: Floats) -> float:
    """Compute R^2 of a line through values (n,) against their indices."""
    index = np.arange(len(values))
    correlation = np.corrcoef(index, values)[0, 1]
    return float(correlation**2)


def relative_space(log: TrialLog) -> float:
    """Compute the area that robots use, relative to the area of their starts and targets.

    Each area is the area of a bounding box.

    The paths are the true ones, so the trial must be simulated.
    """
    setup = log.start.setup
    assert log.truth is not None, "the trials are simulated"
    starts_and_targets = np.concatenate([setup.starts.xy, setup.targets])
    paths = log.truth[:, :, :2].reshape(-1, 2)
    return _bounding_box_area(paths) / _bounding_box_area(starts_and_targets)


def _bounding_box_area(points: Floats) -> float:
    """Compute the area of the bounding box of points (n, 2). Points with NaN are ignored."""
    known_points = points[np.isfinite(points).all(axis=1)]
    width, height = np.ptp(known_points, axis=0)
    return float(width * height)


def rotation_duration_s(log: TrialLog) -> float:
    """Compute for how long the field of a trial rotates, by at least a whole turn at a time [s].

    Reversals up to REVERSAL_MAX_RAD are ignored.
    """
    directions = [step.plan.direction for step in log.steps]
    angles_rad = np.array([np.nan if u is None else u for u in directions], dtype=float)
    time_s = log.steps_s
    turns_rad = wrap(np.diff(angles_rad))  # NaN while the robots stand still
    total_s = 0.0
    for start, stop in _find_true_runs(np.isfinite(turns_rad)):
        unwrapped_rad = np.concatenate([[0.0], np.cumsum(turns_rad[start:stop])])
        total_s += sum_rotation_time_s(unwrapped_rad, time_s[start : stop + 1])
    return total_s


def _find_true_runs(flags: Bools) -> Integers:
    """Find each run of consecutive True values in an array.

    Returns:
        Index of the first value and index after the last value of each run, shape (K, 2).
    """
    bordered = np.concatenate([[False], flags, [False]])
    bounds = np.flatnonzero(np.diff(bordered.astype(int)))
    return bounds.reshape(-1, 2)


def sum_rotation_time_s(angles_rad: Floats, time_s: Floats) -> float:
    """Compute for how long an angle turns in one sense through at least a whole turn [s].

    The angle is split into pieces where it turns back by more than REVERSAL_MAX_RAD. Only pieces of
    at least a whole turn count.

    Args:
        angles_rad: Unwrapped angle of the field, shape (K,) [rad].
        time_s: Times of the angles, shape (K,) [s].
    """
    total_s = 0.0
    piece_start = 0  # index of the first sample of the present piece
    farthest = 0  # index of the sample that is farthest in the sense of the piece
    sense = 0.0
    for k in range(1, len(angles_rad)):
        advance_rad = sense * (angles_rad[k] - angles_rad[farthest])
        if advance_rad < -REVERSAL_MAX_RAD:
            total_s += _whole_turn_duration_s(angles_rad, time_s, piece_start, farthest)
            piece_start = farthest
            farthest = k
            sense = -sense
        elif advance_rad >= 0:
            sense = sense or float(np.sign(angles_rad[k] - angles_rad[piece_start]))
            farthest = k
    return total_s + _whole_turn_duration_s(angles_rad, time_s, piece_start, farthest)


def _whole_turn_duration_s(angles_rad: Floats, time_s: Floats, begin: int, end: int) -> float:
    """Return the duration of a piece of rotation [s], or 0 if it is less than a whole turn.

    `begin` and `end` are the indices of the first and the last sample of the piece.
    """
    is_whole_turn = abs(angles_rad[end] - angles_rad[begin]) >= 2 * np.pi
    return float(time_s[end] - time_s[begin]) if is_whole_turn else 0.0
