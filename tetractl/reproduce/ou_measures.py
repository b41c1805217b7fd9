"""What the figures of Ou and others are of a trial: errors, searches, space, fields that turn."""

import numpy as np

from tetractl.core.poses import Floats, wrap
from tetractl.log.read.trial_log import TrialLog

REVERSAL = 0.3
"""A field that turns back by up to this angle [rad] has not changed its sense."""


def total_error(log: TrialLog) -> float:
    """Return the sum of the robots' distances to their targets at the end [length unit]."""
    assert log.result is not None, "a batch's trial has a result"
    return log.result.total_error


def entered(log: TrialLog) -> bool:
    """Return whether any robot's centre entered an obstacle."""
    return log.result is not None and log.result.entered_obstacle


def left(log: TrialLog) -> bool:
    """Return whether any robot's centre left the arena."""
    return log.result is not None and log.result.left_arena


def iterations(log: TrialLog) -> float:
    """Return the mean iteration at which criterion (20) ends a search."""
    found = [len(one.history) - 1 for step in log.steps for one in step.plan.searches]
    return float(np.mean(found))


def first_cost(log: TrialLog) -> float:
    """Return the cost J of the plan of step 0 [length unit]."""
    return log.steps[0].plan.cost


def warm_work(log: TrialLog) -> float:
    """Return the mean cost evaluations of a later step, of those of step 0."""
    each = [sum(one.evaluations for one in step.plan.searches) for step in log.steps]
    return float(np.mean(each[1:])) / each[0]


def off_start(log: TrialLog) -> float:
    """Return how far robots are from where they began when step 0 is sent, the mean of them."""
    assert log.truth is not None, "the trials are simulated"
    at = int(np.searchsorted(log.mocap_ns, log.steps[0].command.sent_ns)) - 1
    return float(np.hypot(*(log.truth[at] - log.truth[0])[:, :2].T).mean())


def chosen_history(log: TrialLog) -> Floats:
    """Return J after each iteration of the search whose plan step 0 took."""
    plan = log.steps[0].plan
    return plan.searches[plan.chosen].history


def early_share(log: TrialLog) -> float:
    """Return the share of a search's decrease of J that its first ten iterations bring."""
    j = chosen_history(log)
    return float((j[0] - j[10]) / (j[0] - j[-1]))


def exponential(log: TrialLog) -> float:
    """Return R^2 of a line through log J against the iteration, minus that of one through J."""
    j = chosen_history(log)
    z = np.arange(len(j))
    return float(np.corrcoef(z, np.log(j))[0, 1] ** 2 - np.corrcoef(z, j)[0, 1] ** 2)


def space(log: TrialLog) -> float:
    """Return the area of the box round all paths, in that of the box round starts and targets."""
    setup = log.start.setup
    assert log.truth is not None, "the trials are simulated"
    ends = np.concatenate([setup.starts.xy, setup.targets])
    return _box(log.truth[:, :, :2].reshape(-1, 2)) / _box(ends)


def _box(points: Floats) -> float:
    return float(np.prod(np.ptp(points[np.isfinite(points).all(axis=1)], axis=0)))


def spinning(log: TrialLog) -> float:
    """Return for how long the field turns in one sense through a whole turn or more, apart from
    reversals up to REVERSAL [s]."""
    sent = [step.plan.direction for step in log.steps]
    direction = np.array([np.nan if one is None else one for one in sent], dtype=float)
    time_s = np.array([log.elapsed_s(step.command.sent_ns) for step in log.steps])
    turned = wrap(np.diff(direction))
    on = np.isfinite(turned)
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return sum(
        _spinning(np.concatenate([[0.0], np.cumsum(turned[begin:end])]), time_s[begin : end + 1])
        for begin, end in bounds.reshape(-1, 2)
    )


def _spinning(angle: Floats, time_s: Floats) -> float:
    """Return how long a field spins [s] whose angle [rad], (K,), counts whole turns."""
    found, begin, far, sense = 0.0, 0, 0, 0.0
    for k in range(1, len(angle) + 1):
        ahead = sense * (angle[k] - angle[far]) if k < len(angle) else -np.inf
        if ahead < -REVERSAL:  # the sense changed at `far`
            if abs(angle[far] - angle[begin]) >= 2 * np.pi:
                found += float(time_s[far] - time_s[begin])
            begin, far, sense = far, k, -sense
        elif ahead >= 0:
            sense = sense or float(np.sign(angle[k] - angle[begin]))
            far = k
    return found
