"""Levenberg-Marquardt on one sequence, readable: drives f(u) of (8) to 0, the path off obstacles.

This is the reference of the compiled `tetractl.control.kernels.levenberg`, which must agree with
it. The quantity that is brought down is the merit of a sequence u of L signals,

    m(u) = sqrt(N sum_i |s_i - tar_i|^2) + W sum_i sum_o max(0, max_j depth_o(s_i(j))),

with W = DEPTH_WEIGHT, the last predicted position s_i of robot i, (8), of N, and how deep its
deepest position lies inside each obstacle o; the count P of (9) has no slope. The first term is
never less than f, and equal to it where all robots miss by as much. A sum of distances gives up the
robots that miss by most, and ends in a local minimum where many robots are to be led. Where robots
are to keep a separation, W times how far each pair comes within it, where the two are nearest, is
added.

The residuals r are, for each robot, the two coordinates of s_i - tar_i over the square root of
their root mean square, so that their squares sum up to the first term (iteratively reweighted least
squares), and W depth / sqrt(depth) for each robot and obstacle that it meets. With their Jacobian J
(R, L) by the signals, the damped step is

    du = -J' (J J' + lambda I)^-1 r:

as long as R is less than L, the system to be solved is that of the residuals. A step that lowers m
is taken, and lambda falls; else lambda grows, and the step is tried again.

Source: Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", SIAM Journal
11 (1963); the step in the space of the residuals is by the identity (J'J + lambda I)^-1 J' = J'
(J J' + lambda I)^-1.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tetractl.control.cost import predict
from tetractl.control.kernels.levenberg import DEPTH_WEIGHT, LARGEST_STEP, PROGRESS
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.core.registries import MOTIONS
from tetractl.core.shape import Shape

NUDGE = 0.02  # rad, for derivatives
CENTRAL = {1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Weights of the six-point central difference; its error is of order NUDGE^6."""


@dataclass(frozen=True, slots=True)
class Polished:
    """A polished sequence: `history[z]` is the merit after z iterations, `merit` the last."""

    signals: Floats
    merit: float
    history: Floats
    evaluations: int


def polish(
    problem: Problem,
    start: Floats,
    tolerance: float,
    slack: float,
    iterations: int,
    budget: int | None = None,
    patience: int = 6,
) -> Polished:
    """Improve a sequence (L,).

    The search ends when the merit is at most `tolerance`, when no step helps, when it has not
    fallen to PROGRESS of itself over `patience` iterations, after `iterations`, or before it
    exceeds `budget` evaluations; a Jacobian counts as one for each of its rows. Obstacles are grown
    by `slack` [length unit] in the residuals, so that what ends on their edge ends outside.
    """
    u, merit = start.copy(), _merit(problem, start)
    history, evaluations, damping = [merit], 1, 1e-2
    most = _rows_max(problem) + 1  # evaluations of one iteration
    while (
        len(history) <= iterations
        and (budget is None or evaluations + most <= budget)
        and merit > tolerance
    ):
        residual, jacobian = _linearise(problem, u, max(tolerance, 1e-9), slack)
        gram = jacobian @ jacobian.T
        size = float(np.trace(gram)) / len(residual)
        evaluations += len(residual)
        better = False
        while (
            not better
            and len(history) <= iterations
            and damping < 1e4
            and (budget is None or evaluations < budget)
        ):
            trial = _step(u, residual, jacobian, gram + damping * size * np.eye(len(residual)))
            if trial is not None:
                evaluations += 1
                new = _merit(problem, trial)
                if new < merit:
                    better, u, merit = True, trial, new
            damping = max(0.2 * damping, 1e-10) if better else 5 * damping
            history.append(merit)
        z = len(history) - 1
        if not better or (z >= patience and merit > PROGRESS * history[z - patience]):
            break
    return Polished(u, merit, np.array(history), evaluations)


def _rows_max(problem: Problem) -> int:
    count = len(problem.a)
    pairs = count * (count - 1) // 2 if problem.separation > 0 else 0
    return count * (2 + problem.obstacles.count) + pairs


def _step(u: Floats, residual: Floats, jacobian: Floats, damped: Floats) -> Floats | None:
    """Return u + du, no signal moved by more than LARGEST_STEP; None if there is no solution."""
    try:
        np.linalg.cholesky(damped)  # raises unless positive definite
    except np.linalg.LinAlgError:
        return None
    du = -jacobian.T @ np.linalg.solve(damped, residual)
    largest = float(np.abs(du).max())
    return u + du * (min(1.0, LARGEST_STEP / largest) if largest > 0 else 1.0)


def _merit(problem: Problem, u: Floats) -> float:
    path = predict(problem, u)[1:, :, :2]  # (L, N, 2)
    squares = float(((path[-1] - problem.targets) ** 2).sum())
    depths = _depths(problem, path)[0].max(axis=1, initial=0.0)  # (O, N)
    nearer = sum(max(0.0, meeting) for _, _, _, meeting in _meetings(problem, path))
    return float(np.sqrt(len(problem.a) * squares) + DEPTH_WEIGHT * (depths.sum() + nearer))


def _meetings(problem: Problem, path: Floats) -> Iterator[tuple[int, int, int, float]]:
    """Yield, for each pair of robots, the two, where they are nearest, and how far within."""
    if problem.separation > 0:
        for i in range(len(problem.a)):
            for k in range(i):
                apart = np.hypot(*(path[:, i] - path[:, k]).T)
                at = int(np.argmin(apart))
                yield i, k, at, problem.separation - float(apart[at])


def _linearise(problem: Problem, u: Floats, floor: float, slack: float) -> tuple[Floats, Floats]:
    """Return the residuals (R,) and their Jacobian (R, L)."""
    path, by_signal = positions(problem, u)
    residuals, rows = [], []
    gaps = path[-1] - problem.targets
    typical = float(np.sqrt((gaps**2).sum() / len(gaps)))
    scale = 1 / np.sqrt(max(typical, floor))
    for i, gap in enumerate(gaps):
        residuals += [*(scale * gap)]
        rows += [*(scale * by_signal[-1, i])]
    depths, outwards = _depths(problem, path)
    for i in range(len(problem.a)):
        for depth, outward in zip(depths[:, :, i], outwards[:, :, i], strict=True):
            j = int(np.argmax(depth))  # the deepest position
            grown = float(depth[j]) + slack
            if grown > 0:
                scale = DEPTH_WEIGHT / np.sqrt(max(grown, floor))
                residuals.append(scale * grown)
                rows.append(-scale * (outward[j] @ by_signal[j, i]))
    for i, k, j, depth in _meetings(problem, path):
        if depth + slack > 0:
            gap = path[j, i] - path[j, k]
            apart = float(np.hypot(*gap))
            outward = gap / apart if apart > 0 else np.zeros(2)
            scale = DEPTH_WEIGHT / np.sqrt(max(depth + slack, floor))
            residuals.append(scale * (depth + slack))
            rows.append(-scale * (outward @ (by_signal[j, i] - by_signal[j, k])))
    return np.array(residuals), np.array(rows)


def positions(problem: Problem, u: Floats) -> tuple[Floats, Floats]:
    """Return the predicted positions (L, N, 2) and how they depend on u, (L, N, 2, L).

    By the chain rule forwards in time: a step moves a robot by d(heading, u_j) and turns it by
    g(heading, u_j), so with the derivative H of its heading by u and its position's S,

        S <- S + dd/dheading H + dd/du_j e_j,     H <- H + dg/dheading H + dg/du_j e_j.

    The derivatives of a step are central differences: no model's own are used.
    """
    path = predict(problem, u)
    count, length = len(problem.a), len(u)
    s, h = np.zeros((count, 2, length)), np.zeros((count, length))
    every = np.empty((length, count, 2, length))
    for j in range(length):
        t = problem.first_period if j == 0 else problem.period
        by_heading, by_u = _step_derivatives(problem, path[j, :, 2], u[j], t)  # each (N, 3)
        s = s + by_heading[:, :2, None] * h[:, None, :]
        s[:, :, j] += by_u[:, :2]
        h = h + by_heading[:, 2, None] * h
        h[:, j] += by_u[:, 2]
        every[j] = s
    return path[1:, :, :2], every


def _step_derivatives(
    problem: Problem, heading: Floats, u: float, t: float
) -> tuple[Floats, Floats]:
    """Return how x, y and turn of one step of all robots depend on heading and u, each (N, 3)."""

    step = MOTIONS.load(problem.motion).step

    def moved(turned: float, steered: float) -> Floats:
        zero = np.zeros_like(heading)
        x, y, after = step(
            zero, zero, heading + turned, np.array(u + steered), problem.a, problem.speed, t
        )
        return np.stack([x, y, after - (heading + turned)], axis=-1)

    def derivative(turn: float, steer: float) -> Floats:
        total = np.zeros((len(heading), 3))
        for k, weight in CENTRAL.items():
            up, down = moved(k * turn, k * steer), moved(-k * turn, -k * steer)
            total += weight / NUDGE * (up - down)
        return total

    return derivative(NUDGE, 0.0), derivative(0.0, NUDGE)


def _depths(problem: Problem, path: Floats) -> tuple[Floats, Floats]:
    """Return how deep positions (L, N, 2) are in each obstacle and the way out, a unit vector.

    Shapes (O, L, N) and (O, L, N, 2); a depth is at most 0 outside. The walls come last.
    """
    x, y = path[..., 0], path[..., 1]
    outwards = np.empty((problem.obstacles.count, *path.shape))
    shapes = getattr(problem.obstacles, "shapes")  # noqa: B009
    for o, shape in enumerate(shapes):
        for at in np.ndindex(path.shape[:-1]):
            outwards[o][at] = outward(shape, *path[at].tolist())
    for out, way in zip(outwards[len(shapes) :], ((1, 0), (0, 1), (-1, 0), (0, -1)), strict=False):
        out[:] = way
    return -problem.obstacles.distances(x, y), outwards


def outward(shape: Shape, x: float, y: float) -> Floats:
    """Return the unit vector along which the distance to a shape grows."""
    ends, at = shape.corners, np.array([x, y])
    edges = ends - np.roll(ends, 1, axis=0)
    along = ((at - ends) * edges).sum(axis=1) / np.maximum((edges**2).sum(axis=1), 1e-300)
    away = at - (ends + np.clip(along, -1.0, 0.0)[:, None] * edges)
    nearest = int(np.hypot(*away.T).argmin())
    size = float(np.hypot(*away[nearest]))
    if size > 1e-9 * (abs(x) + abs(y)):
        inside = shape.distance(np.array(x), np.array(y)) < -shape.radius
        return away[nearest] / (-size if inside else size)
    ex, ey = edges[nearest]
    return np.array([ey, -ex]) / np.hypot(ex, ey) if ex or ey else np.array([1.0, 0.0])
