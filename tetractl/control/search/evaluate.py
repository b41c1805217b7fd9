"""Compiled counterparts of the functions in `cost`, as optimisers and controllers call them.

They compute the cost J of many sequences of signals at once, or the predicted path of one sequence.
"""

import math
from collections.abc import Callable
from threading import get_ident

import numpy as np

from tetractl.control.search.cost import Foreseen, require_finite
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


def compiled_costs(problem: Problem, count: int) -> Callable[[Floats], Floats]:
    """Return a function that maps `count` sequences of signals (L, count) to costs J (count,).

    The costs agree with those of `tetractl.control.search.cost.evaluate` to 1e-9. The function
    raises ControlError if a cost is not finite.
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.rollout import costs, rollouts_of

    flat = flatten(problem)
    rollouts = rollouts_of(get_ident(), len(problem.a), count)

    def evaluate(signals: Floats) -> Floats:
        total = np.empty(count)
        costs(flat, rollouts, np.ascontiguousarray(signals), total)
        require_finite(total)
        return total

    return evaluate


def compiled_branches(
    problem: Problem, start: Floats, towards: Floats, turns: Floats, seconds: float
) -> Floats:
    """Predict the poses of all robots for B sequences of directions at once.

    The directions of sequence b are `towards[b] + turns[0]`, `towards[b] + turns[1]`, and so on.

    Args:
        problem: The problem of the control step.
        start: Poses at the start of each sequence, shape (B, N, 3).
        towards: Angle added to all directions of each sequence [rad], shape (B,).
        turns: The directions before this angle is added [rad], shape (L,).
        seconds: How long each direction is held [s].

    Returns:
        The poses, shape (L + 1, B, N, 3).
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import predict

    copies = len(towards)
    robots = len(problem.a)
    flat = flatten(problem)
    bias = np.zeros(robots) if problem.bias is None else problem.bias
    directions = (towards[:, None] + bias).ravel()
    held = flat._replace(
        robots=np.tile(flat.robots, (copies, 1)),
        bias_cos=elementwise.cos(directions),
        bias_sin=elementwise.sin(directions),
        flow=np.tile(flat.flow, (copies, 1)),
        first_period=seconds,
        period=seconds,
    )
    path = predict(turns, held, start.reshape(-1, 3))
    return path.reshape(-1, *start.shape)


def compiled_foresee(problem: Problem, signals: Floats) -> Foreseen:
    """Predict the path and the costs of a sequence of signals (L,), with compiled code.

    This is the compiled counterpart of `cost.foresee`. Raises ControlError if the cost is not
    finite.
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import costs_along, predict

    flat = flatten(problem)
    path = predict(np.ascontiguousarray(signals), flat, flat.poses)
    target, obstacle = costs_along(flat, path)
    if not math.isfinite(target):
        require_finite(np.array([target]))
    return Foreseen(path, target, obstacle)


def compiled_drive(problem: Problem, towards: Floats, seconds: Floats) -> Floats:
    """Predict the poses of robots that each follow their own direction.

    Args:
        problem: The problem of the control step.
        towards: Direction of each robot [rad], shape (N,). NaN if a robot stands still.
        seconds: The times to predict [s], shape (M,).

    Returns:
        The poses, shape (M, N, 3).
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import drive

    return drive(towards, seconds, flatten(problem))
