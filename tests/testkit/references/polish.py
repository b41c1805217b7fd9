"""A slow Levenberg-Marquardt method from the equations in the head of `levenberg`.

Slopes are central differences, and systems are solved by NumPy.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from tetractl.control.search.cost import predict
from tetractl.control.search.kernels.levenberg import (
    DAMPING_DECREASE,
    DAMPING_FIRST,
    DAMPING_INCREASE,
    DAMPING_MAX,
    DAMPING_MIN,
    DEPTH_WEIGHT,
    FLOOR_MIN,
    PROGRESS,
    SIGNAL_CHANGE_MAX,
    PolishSettings,
)
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats


class Polished(NamedTuple):
    """What a polish has found."""

    signals: Floats
    history: Floats  # the merit after each iteration
    evaluations: int


class Path:
    """Where robots go under signals (L,), and how that depends on each signal."""

    def __init__(self, problem: Problem, signals: Floats) -> None:
        step = 1e-6
        changes = step * np.eye(len(signals))
        self.problem = problem
        self.places = self._predicted(signals)  # (L, N, 2)
        ahead = self._predicted(signals + changes)
        behind = self._predicted(signals - changes)
        self.slopes = (ahead - behind) / (2 * step)  # (L, N, 2, L), the last by the signal

    def _predicted(self, signals: Floats) -> Floats:
        path = predict(self.problem, signals)[1:, ..., :2]
        return path if signals.ndim == 1 else np.moveaxis(path, 1, -1)

    def meetings(self) -> list[tuple[int, int]]:
        if self.problem.separation == 0:
            return []
        return [(i, k) for i in range(len(self.problem.a)) for k in range(i)]

    def depths(self) -> list[tuple[float, Floats]]:
        """How deep each robot is in each obstacle, and each pair in its separation; with the
        slopes (L,)."""
        found = []
        for i in range(len(self.problem.a)):
            x, y = self.places[:, i].T
            for o, distances in enumerate(self.problem.obstacles.distances(x, y)):
                j = int(np.argmin(distances))
                found.append((-float(distances[j]), -self._slope_of_distance(i, j, o)))
        for i, k in self.meetings():
            apart = self.places[:, i] - self.places[:, k]
            distances = np.hypot(*apart.T)
            j = int(np.argmin(distances))
            slope = (self.slopes[j, i] - self.slopes[j, k]).T @ apart[j] / distances[j]
            found.append((self.problem.separation - float(distances[j]), -slope))
        return found

    def _slope_of_distance(self, i: int, j: int, o: int) -> Floats:
        step = 1e-5
        x, y = self.places[j, i]
        xs = np.array([x + step, x - step, x, x])
        ys = np.array([y, y, y + step, y - step])
        east, west, north, south = self.problem.obstacles.distances(xs, ys)[o]
        return np.array([east - west, north - south]) / (2 * step) @ self.slopes[j, i]

    def misses(self) -> Floats:
        return self.places[-1] - self.problem.targets

    def merit(self) -> float:
        robots = len(self.problem.a)
        deep = sum(max(0.0, depth) for depth, _ in self.depths())
        return math.sqrt(robots * (self.misses() ** 2).sum()) + DEPTH_WEIGHT * deep

    def residuals(self, floor: float, slack: float) -> tuple[Floats, Floats]:
        """The residuals r (R,) and their slopes J (R, L)."""
        misses = self.misses()
        c = 1 / math.sqrt(max(math.sqrt((misses**2).sum() / len(misses)), floor))
        r = list(c * misses.ravel())
        rows = list(c * self.slopes[-1].reshape(2 * len(misses), -1))
        for depth, slope in self.depths():
            if depth + slack > 0:
                c = DEPTH_WEIGHT / math.sqrt(max(depth + slack, floor))
                r.append(c * (depth + slack))
                rows.append(c * slope)
        return np.array(r), np.array(rows)


def polish(problem: Problem, signals: Floats, settings: PolishSettings, budget: float) -> Polished:
    """Improve a sequence of signals (L,)."""
    robots = len(problem.a)
    pairs = len(list(itertools.combinations(range(robots), 2))) if problem.separation else 0
    residuals_max = 2 * robots + robots * problem.obstacles.count + pairs
    floor = max(settings.tolerance, FLOOR_MIN)
    path = Path(problem, signals)
    merits = [path.merit()]
    evaluations = 1
    damping = DAMPING_FIRST
    while (
        merits[-1] > settings.tolerance
        and len(merits) - 1 < settings.iterations_max
        and evaluations + residuals_max + 1 <= budget
    ):
        r, jacobian = path.residuals(floor, settings.slack)
        evaluations += len(r)
        squares = jacobian @ jacobian.T
        mean_square = np.trace(squares) / len(r)
        better = None
        while (
            len(merits) - 1 < settings.iterations_max
            and damping < DAMPING_MAX
            and evaluations < budget
        ):
            y = np.linalg.solve(squares + damping * mean_square * np.eye(len(r)), r)
            change = jacobian.T @ y
            change *= min(1.0, SIGNAL_CHANGE_MAX / np.abs(change).max())
            evaluations += 1
            tried = Path(problem, signals - change)
            if tried.merit() < merits[-1]:
                better = tried
                break
            merits.append(merits[-1])
            damping *= DAMPING_INCREASE
        if better is None:
            break
        path = better
        signals = signals - change
        merits.append(path.merit())
        damping = max(DAMPING_DECREASE * damping, DAMPING_MIN)
        z = len(merits) - 1
        if z >= settings.patience and merits[z] > PROGRESS * merits[z - settings.patience]:
            break
    return Polished(signals, np.array(merits), evaluations)
