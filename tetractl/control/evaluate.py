"""Compiled functions for optimisers: J of many sequences at once, and the path of one sequence."""

import math
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
        total = np.empty(count)
        costs(rollout, np.ascontiguousarray(signals), total)
        require_finite(total)
        return total

    return evaluate


def compiled_branches(
    problem: Problem, start: Floats, towards: Floats, turns: Floats, seconds: float
) -> Floats:
    """Return the poses (L + 1, B, N, 3) of B copies of the robots, from start (B, N, 3).

    Copy b is steered towards towards[b] + turns[j] [rad], each for `seconds`; turns (L,).
    """
    from tetractl.control.kernels.motion import flat
    from tetractl.control.kernels.prediction import predict

    copies = len(towards)
    robots = len(problem.a)
    motion = flat(problem)
    path = np.empty((len(turns) + 1, copies * robots, 3))
    path[0] = start.reshape(-1, 3)
    bias = np.zeros(robots) if problem.bias is None else problem.bias
    directions = (towards[:, None] + bias).ravel()
    drift = np.tile(motion.drift, copies)
    drift[0] = np.cos(directions)
    drift[1] = np.sin(directions)
    parameters = np.tile(motion.parameters, (copies, 1))
    predict(turns, parameters, drift, seconds, seconds, motion.rest, path)
    return path.reshape(-1, *start.shape)


def compiled_foresee(problem: Problem, signals: Floats) -> Foreseen:
    """Return the prediction for a sequence (L,), as `cost.foresee` but compiled."""
    from tetractl.control.kernels.motion import flat
    from tetractl.control.kernels.prediction import foresee

    motion = flat(problem)
    path = np.empty((signals.size + 1, problem.a.size, 3))
    path[0] = motion.start
    target, obstacle = foresee(
        np.ascontiguousarray(signals),
        motion.parameters,
        motion.drift,
        problem.first_period,
        problem.period,
        motion.rest,
        path,
        np.ascontiguousarray(problem.targets),
        problem.obstacles.rows,
        problem.obstacles.walls,
        problem.swept,
        float(problem.separation),
    )
    if not math.isfinite(target):
        require_finite(np.array([target]))
    return Foreseen(path, target, obstacle)


def compiled_drive(problem: Problem, towards: Floats, seconds: Floats) -> Floats:
    """Return the poses (M, N, 3) of robots that drive for each of `seconds` (M,), each towards its
    own direction (N,) [rad]; a robot stands if that is NaN."""
    from tetractl.control.kernels.motion import flat
    from tetractl.control.kernels.prediction import drive

    motion = flat(problem)
    path = np.empty((len(seconds), len(towards), 3))
    drive(motion.start, towards, motion.parameters, motion.drift, motion.rest, seconds, path)
    return path
