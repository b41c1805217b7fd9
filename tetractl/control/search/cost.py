"""The optimal control problem of one control step: the cost J(u), the paper's equations (7)-(13).

    min over u in [-pi, pi]^L   J(u) = f(u) + omega_p P(s(k+1|k), ..., s(k+L|k))            (7)
    f(u) = sum_i || s_i(k+L|k) - tar_i ||                                                   (8)
    P    = sum_i sum_j p(s_i(k+j|k)),   p = 1 in an obstacle, else 0                   (9), (13)
    s_i(k+j|k) = [x_i(k+j|k), y_i(k+j|k)],   tar_i = [x_tar,i, y_tar,i]                   (10), (11)
    -pi <= u <= pi                                                                             (12)

The length L of a sequence is, as in Algorithm 2, its number of signals: u(k), ..., u(k+L-1). The
paper's horizon in (7)-(12) is h = L - 1. The prediction s(k+j|k) comes from (4)-(6) or from one of
the other motions in `tetractl.model.motion`. In two extensions of the paper, P also counts each
pair of robots that is nearer than the `separation` at a predicted position, and if robots have to
stay `within` R of their targets,

    f(u) = R sum_i mean_j h(|| s_i(k+j|k) - tar_i || / R),   h(d) = 1 + 0.3 (d - 1)  if d > 1,
                                                             else 0,

which is R times the sum of the robots' fractions of time outside, plus a small cost that grows
with the distance.
"""

from dataclasses import dataclass

import numpy as np

from tetractl.core import elementwise
from tetractl.core.errors import ControlError
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.model.motion.motion import Motion
from tetractl.model.motion.turn_rate import compute_turning_rate, parameters_in_rows

STRAY_SLOPE = 0.3
"""Slope 0.3 of h(d) beyond d = 1, where d is a robot's distance to its target in units of R."""


@dataclass(frozen=True, slots=True)
class Costs:
    """The costs of B sequences of signals, computed together. Arrays have the shape (B,).

    Attributes:
        total: The cost J = f + omega_p P that an optimiser minimises.
        target: f, the part for the distances of robots to their targets.
        obstacle: P, the part for contacts with obstacles.
    """

    total: Floats
    target: Floats
    obstacle: Floats


@dataclass(frozen=True, slots=True)
class Prediction:
    """The predicted path of all robots under one sequence of L signals, and its costs.

    Attributes:
        path: Predicted poses, shape (L + 1, N, 3). The first row is the start.
        target: Cost f for the distances to the targets.
        obstacle: Cost P for contacts with obstacles.
    """

    path: Floats
    target: float
    obstacle: float


def predict_with_costs(problem: Problem, signals: Floats) -> Prediction:
    """Predict the path of all robots under a sequence of signals (L,), with its costs.

    Raises:
        ControlError: If a cost is not finite.
    """
    return prediction_from_path(problem, predict(problem, signals))


def prediction_from_path(problem: Problem, path: Floats) -> Prediction:
    """Add the costs to a path that is already predicted, shape (L + 1, N, 3).

    Raises:
        ControlError: If a cost is not finite.
    """
    costs = costs_along(problem, path[:, None])
    return Prediction(path, float(costs.target[0]), float(costs.obstacle[0]))


def predict(problem: Problem, signals: Floats) -> Floats:
    """Predict the poses (L + 1, ..., N, 3) of robots that follow sequences of signals (..., L).

    The first entry along the first axis holds the present poses. Each further entry holds the
    poses at the end of a signal. A pose is x, y [length unit] and heading [rad].
    """
    motion: Motion = MOTIONS.load(problem.motion)
    shape = (*signals.shape[:-1], problem.targets.shape[0])
    path = np.empty((signals.shape[-1] + 1, *shape, 3))
    path[0] = problem.poses.array()
    x = path[..., 0]
    y = path[..., 1]
    directions = np.moveaxis(signals, -1, 0)[..., None]  # (L, ..., 1), the same for all robots
    if problem.bias is not None:
        directions = directions + problem.bias  # (L, ..., N)
    parameters = parameters_in_rows(problem)
    needs_rates = problem.side is not None or problem.saturation is not None
    for j, u in enumerate(directions):
        seconds = problem.first_period if j == 0 else problem.period
        heading = path[j, ..., 2]
        rates = _turning_rates(heading, u, parameters, seconds) if needs_rates else problem.a
        next_pose = motion.step(x[j], y[j], heading, u, rates, problem.speed, seconds)
        path[j + 1] = np.stack(next_pose, axis=-1)
    if problem.flow is not None:
        periods = np.arange(len(directions)).reshape(-1, *(1 for _ in shape))
        times = problem.first_period + problem.period * periods
        x[1:] += times * problem.flow[:, 0]
        y[1:] += times * problem.flow[:, 1]
    return path


def _turning_rates(heading: Floats, u: Floats, parameters: Floats, seconds: float) -> Floats:
    """Compute each robot's turning rate a during one signal, shape (..., N) [rad/s].

    The motion's function `turning` computes it, from the robot's `side` and saturation.
    """

    def rate(c: float, s: float, cu: float, su: float, *robot: float) -> float:
        return compute_turning_rate(c, s, cu, su, robot, seconds)[0]

    vectorised_rate = np.vectorize(rate)
    direction = elementwise.cos(u), elementwise.sin(u)
    return vectorised_rate(
        elementwise.cos(heading), elementwise.sin(heading), *direction, *parameters.T
    )


def evaluate(problem: Problem, signals: Floats) -> Costs:
    """Compute the costs of B sequences of signals (B, L), by the paper's equations (7)-(9).

    Raises:
        ControlError: If a cost is not finite, because only finite costs can be compared.
    """
    return costs_along(problem, predict(problem, signals))


def costs_along(problem: Problem, path: Floats) -> Costs:
    """Compute the costs of B predicted paths (L + 1, B, N, 3), by the paper's equations (7)-(9).

    Raises:
        ControlError: If a cost is not finite.
    """
    x = path[..., 0]
    y = path[..., 1]
    if problem.within is None:
        misses = elementwise.hypot(x[-1] - problem.targets[:, 0], y[-1] - problem.targets[:, 1])
    else:
        distances = elementwise.hypot(x[1:] - problem.targets[:, 0], y[1:] - problem.targets[:, 1])
        excess = distances / problem.within - 1
        misses = problem.within * np.where(excess > 0, 1 + STRAY_SLOPE * excess, 0.0).mean(axis=0)
    target = misses.sum(axis=-1)  # (8)
    if problem.swept:
        hits = problem.obstacles.meets_segments(x[:-1], y[:-1], x[1:], y[1:])
    else:
        hits = problem.obstacles.contains(x[1:], y[1:])
    obstacle = hits.sum(axis=(0, 2)).astype(np.float64)  # (9)
    if problem.separation > 0:
        i, k = np.triu_indices(x.shape[-1], 1)  # the pairs of robots
        dx = x[1:, :, i] - x[1:, :, k]
        dy = y[1:, :, i] - y[1:, :, k]
        obstacle += (dx * dx + dy * dy <= np.square(problem.separation)).sum(axis=(0, 2))
    total = target + problem.obstacle_weight * obstacle  # (7)
    require_finite(total)
    return Costs(total, target, obstacle)


def require_finite(costs: Floats) -> None:
    """Raise ControlError unless every cost is a finite number."""
    if not np.isfinite(costs).all():
        raise ControlError(
            f"the cost is not finite for {np.count_nonzero(~np.isfinite(costs))} of {costs.size} "
            "sequences",
            "look in the spec for a pose that is not a number, or for lengths near the "
            "largest floating-point number",
        )
