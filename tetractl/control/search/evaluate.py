"""Compiled predictions of paths and costs, for optimisers and controllers.

These functions compute the cost J of many sequences of signals at once, or the predicted path of
one sequence. `tetractl.control.search.cost` has the readable versions.
"""

import math
from collections.abc import Callable
from threading import get_ident

import numpy as np

from tetractl.control.search.cost import Prediction, require_finite
from tetractl.core import elementwise
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


def compiled_costs(problem: Problem, n_sequences: int) -> Callable[[Floats], Floats]:
    """Create a compiled function that computes the costs J of many sequences of signals at once.

    The function maps sequences of shape (L, n_sequences) to costs of shape (n_sequences,). Its
    costs agree with `tetractl.control.search.cost.evaluate` to 1e-9. It raises ControlError if a
    cost is not finite.

    Args:
        problem: The problem of the control step.
        n_sequences: Number of sequences in each call.
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.rollout import costs, rollouts_of

    flat = flatten(problem)
    rollouts = rollouts_of(get_ident(), len(problem.a), n_sequences)

    def evaluate(signals: Floats) -> Floats:
        total = np.empty(n_sequences)
        costs(flat, rollouts, np.ascontiguousarray(signals), total)
        require_finite(total)
        return total

    return evaluate


def compiled_branch_paths(
    problem: Problem, starts: Floats, offsets: Floats, signals: Floats, held_s: float
) -> Floats:
    """Predict the poses of all robots for B sequences of directions at once.

    The directions of sequence b are `offsets[b] + signals[0]`, `offsets[b] + signals[1]`, and so
    on.

    Args:
        problem: The problem of the control step.
        starts: Poses at the start of each sequence, shape (B, N, 3).
        offsets: Angle added to all directions of each sequence [rad], shape (B,).
        signals: The directions before the offset is added [rad], shape (L,).
        held_s: How long each direction is held [s].

    Returns:
        The poses, shape (L + 1, B, N, 3).
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import predict

    n_sequences = len(offsets)
    n_robots = len(problem.a)
    flat = flatten(problem)
    bias = np.zeros(n_robots) if problem.bias is None else problem.bias
    directions = (offsets[:, None] + bias).ravel()
    tiled = flat._replace(
        robots=np.tile(flat.robots, (n_sequences, 1)),
        bias_cos=elementwise.cos(directions),
        bias_sin=elementwise.sin(directions),
        flow=np.tile(flat.flow, (n_sequences, 1)),
        first_period=held_s,
        period=held_s,
    )
    path = predict(signals, tiled, starts.reshape(-1, 3))
    return path.reshape(-1, *starts.shape)


def compiled_prediction(problem: Problem, signals: Floats) -> Prediction:
    """Predict the path and the costs of a sequence of signals (L,), with compiled code.

    This is the compiled counterpart of `cost.predict_with_costs`. Raises ControlError if the cost
    is not finite.
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import costs_along, predict

    flat = flatten(problem)
    path = predict(np.ascontiguousarray(signals), flat, flat.poses)
    target, obstacle = costs_along(flat, path)
    if not math.isfinite(target):
        require_finite(np.array([target]))
    return Prediction(path, target, obstacle)


def compiled_drive(problem: Problem, directions: Floats, times_s: Floats) -> Floats:
    """Predict the poses of robots that each follow their own direction.

    Args:
        problem: The problem of the control step.
        directions: Direction of each robot [rad], shape (N,). NaN if a robot stands still.
        times_s: The times to predict [s], shape (M,).

    Returns:
        The poses, shape (M, N, 3).
    """
    from tetractl.control.search.kernels.motion import flatten
    from tetractl.control.search.kernels.prediction import drive

    return drive(directions, times_s, flatten(problem))
