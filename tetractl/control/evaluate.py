"""Compiled functions for optimisers: J of many sequences at once, and the path of one sequence."""

from collections.abc import Callable

import numpy as np

from tetractl.control.cost import Foreseen, require_finite
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


def compiled_costs(problem: Problem, count: int) -> Callable[[Floats], Floats]:
    """Return a function that maps `count` sequences, (L, count), to their costs J, (count,).

    It agrees with `tetractl.control.cost.evaluate` to 1e-9, and raises ControlError if a cost is
    not finite.
    """
    from tetractl.control.kernels.rollout import costs, lay_out

    rollout = lay_out(problem, count)

    def evaluate(signals: Floats) -> Floats:
        found = np.empty(count)
        costs(rollout, np.ascontiguousarray(signals), found)
        require_finite(found)
        return found

    return evaluate


def compiled_path(problem: Problem, signals: Floats) -> Floats:
    """Return the poses (L + 1, N, 3) under a sequence (L,), as `cost.predict` but compiled."""
    from tetractl.control.kernels.motion import constants
    from tetractl.control.kernels.prediction import predict

    path = np.empty((signals.size + 1, problem.a.size, 3))
    path[0] = problem.poses.array()
    predict(
        np.ascontiguousarray(signals),
        problem.a,
        problem.speed,
        problem.drift,
        problem.first_period,
        problem.period,
        constants(problem)[1],
        path,
    )
    return path


def compiled_foresee(problem: Problem, signals: Floats) -> Foreseen:
    """Return the prediction for a sequence (L,), as `cost.foresee` but compiled."""
    from tetractl.control.kernels.rollout import costs, lay_out

    rollout, total = lay_out(problem, 1), np.empty(1)
    costs(rollout, np.ascontiguousarray(signals[:, None]), total)
    require_finite(total)
    path = compiled_path(problem, signals)
    missed = path[-1, :, :2] - problem.targets
    target = float(np.hypot(missed[:, 0], missed[:, 1]).sum())  # (8)
    return Foreseen(path, target, float(rollout.lanes[4].sum()))  # (9)
