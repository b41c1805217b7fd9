"""`optimizer: {type: ipopt}`: multiple shooting, solved by IPOPT through CasADi.

The variables are states and directions. The motion is a constraint between successive states, and
the cost is the sum of the squared distances to the targets. Obstacles are constraints at the
samples. They are smooth curves around their bounds, because IPOPT needs second derivatives. A shape
that no robot can drive around in time is a wall, which limits the positions.

A nonlinear programme depends only on the numbers of robots, signals and boxes, which seldom change.
All other values, including the estimates of the robots, are parameters of the programme, so that it
is built only once.

There are two programmes for each size, because measurements showed that both are needed to
converge. From a random start, IPOPT approximates the Hessian by BFGS, because few starts converge
with exact Hessians. From a warm start, which is near a solution, it uses exact Hessians and a
barrier that begins small, and needs a third of the iterations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, Self

import numpy as np

from tetractl.control.search.cost import evaluate, predict
from tetractl.control.search.search_progress import SearchProgress
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.spec.base import Positive
from tetractl.spec.controller import OptimizerSection

CORNER_RADIUS = 0.02
"""Distance within which the corners of a box are rounded [programme's length unit]."""
GROWN_FRACTION = 0.4
"""Growth of obstacles as a fraction of a robot's path in a period. No step then cuts a corner."""
KNOTS_PER_ROBOT = 4
"""Number of knots of a random start for each robot."""
KNOTS_MIN = 12
"""Minimum number of knots of a random start."""
RANDOM_STARTS = 64
"""Number of random starts from which the best are chosen."""
WALL_GAP = 1e-3
"""Distance that robots keep from walls, whose edges belong to them [programme's length unit]."""
GUESS_WEIGHT = 1e-6
"""Weight of the squared distance from a warm start, which makes the Hessian regular."""
NO_LIMIT_S = 1e9
"""Time limit of a solution that is not limited [s]."""
STARTS = 3
"""Number of random starts that a search without a warm start solves from."""
ITERATIONS_COLD = 60
"""Maximum number of IPOPT iterations from one random start."""
ITERATIONS_WARM = 40
"""Maximum number of IPOPT iterations from a warm start, or from the result of a random start."""
ITERATIONS_ALL = 150
"""Number of IPOPT iterations in one search after which no further start is made."""

PIVOT_TOLERANCE = 1e-8
"""IPOPT's default for MA57. With MUMPS's 1e-6, some solutions take eight times as long."""
SHARED_OPTIONS = {"print_level": 0, "sb": "yes", "mumps_pivtol": PIVOT_TOLERANCE}
COLD_OPTIONS = {"hessian_approximation": "limited-memory", "tol": 1e-6}
WARM_OPTIONS = {
    "tol": 1e-5,
    "constr_viol_tol": 1e-4,
    "mu_strategy": "adaptive",
    "mu_init": 1e-4,
    "bound_mult_init_method": "mu-based",
    "bound_push": 1e-3,
    "bound_frac": 1e-3,
    "slack_bound_push": 1e-3,
    "slack_bound_frac": 1e-3,
}


class Ipopt(OptimizerSection):
    """IPOPT on the states and directions of all robots, from the warm start or random curves."""

    type: Literal["ipopt"]
    tolerance: Positive = 1.0
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations_max(self) -> int:
        """Maximum number of iterations: the best random start as it is, and each start solved
        twice.
        """
        return 2 * STARTS + 1

    @property
    def evaluations_min(self) -> int:
        """Minimum number of evaluations: the evaluation of the warm start."""
        return 1

    @property
    def good_enough(self) -> float:
        """The tolerance: a cost that is good enough."""
        return self.tolerance

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Solve from the warm start unless it is good enough, or from random curves without one.

        The cost J (7) of IPOPT's result decides. The time of a single solution is not limited.
        """
        solutions = _Solutions(problem, length, limits, self.tolerance)
        if warm is not None:
            solutions.note(warm)
            solutions.solve(warm, ITERATIONS_WARM, warm=True)
            return solutions.to_search()
        rng = np.random.default_rng(key)
        starts = best_random_starts(problem, length, rng, STARTS)
        solutions.note(starts[0])
        for start in starts:
            first = solutions.solve(start, ITERATIONS_COLD, warm=False)
            if first is not None:
                solutions.solve(first, ITERATIONS_WARM, warm=True)
        return solutions.to_search()


class _Solutions(SearchProgress):
    """The progress of a search, and the number of IPOPT iterations that remain."""

    def __init__(self, problem: Problem, length: int, limits: Limits, tolerance: float) -> None:
        super().__init__(length, limits)
        self.problem = problem
        self.tolerance = tolerance
        self.iterations_left = ITERATIONS_ALL

    def note(self, signals: Floats) -> None:
        """Evaluate one sequence. The search is over if it is good enough."""
        self.add_iteration(signals[:, None], evaluate(self.problem, signals[None]).total)
        if self.best_cost <= self.tolerance:
            self.stop_reason = StopReason.TARGET

    def solve(self, guess: Floats, iterations: int, warm: bool) -> Floats | None:
        """Solve from a guess, and return the directions found.

        The result is None if the search is over.
        """
        if self.stop_reason is None:
            self.stop_reason = self.find_limit(1)
        if self.stop_reason is not None or self.iterations_left <= 0:
            return None
        programme = shooting_programme(self.problem, self.length, iterations, warm=warm)
        signals = wrap(programme.solve(self.problem, guess))
        self.iterations_left -= programme.iterations
        self.note(signals)
        return signals


def best_random_starts(
    problem: Problem, length: int, rng: np.random.Generator, count: int
) -> Sequence[Floats]:
    """Return the best of many random curves (length,) through random directions, best first.

    Args:
        problem: The problem.
        length: Number of signals of each curve.
        rng: Source of the random directions.
        count: Number of curves to return.
    """
    knots_max = max(KNOTS_MIN, KNOTS_PER_ROBOT * problem.a.size)
    shape = min(knots_max, length), max(RANDOM_STARTS, count)
    x, y = (problem.targets - problem.poses.xy).T
    bearing = np.arctan2(y.sum(), x.sum())  # of the mean vector from robots to targets
    knots = rng.uniform(-np.pi, np.pi, shape)
    positions = np.linspace(0, len(knots) - 1, length)
    turns = [np.interp(positions, range(len(knots)), knots_of_curve) for knots_of_curve in knots.T]
    curves = bearing + np.array(turns).T
    costs = evaluate(problem, curves.T).total
    return [curves[:, i] for i in np.argsort(costs, kind="stable")[:count]]


def length_unit(problem: Problem) -> float:
    """Compute the programme's length unit: how far the fastest robot moves in five seconds."""
    return 5.0 * float(problem.speed.max())


@dataclass(frozen=True, slots=True)
class Scene:
    """Obstacles for robots, in a programme's unit.

    `boxes` are (left, bottom, right, top). Robots must stay within the `field`, which has the same
    form. Infinite sides are open.
    """

    boxes: Sequence[Floats]
    field: Floats

    @classmethod
    def of(cls, problem: Problem, length: int) -> Self:
        """Return the obstacles that robots can reach in a sequence of `length` signals.

        A box that spans everything within reach, with all robots and targets on the same side, is a
        wall. It is not grown, because it has no corners.
        """
        unit = length_unit(problem)
        xy = np.vstack([problem.poses.xy, problem.targets]) / unit
        reach = problem.seconds(length) * float(problem.speed.max()) / unit
        start = problem.poses.xy / unit
        reach_low = start.min(axis=0) - reach
        reach_high = start.max(axis=0) + reach
        grown = GROWN_FRACTION * problem.period * float(problem.speed.max()) * problem.swept
        field = np.array([-np.inf, -np.inf, np.inf, np.inf])
        boxes: list[Floats] = []
        region: Any = problem.obstacles
        if region.inner_bounds is not None:  # the walls of the arena
            margins = np.array([-1.0, -1.0, 1.0, 1.0]) * WALL_GAP * unit
            field = (region.walls - margins) / unit
        for shape in region.shapes:
            ungrown = np.array(shape.grown(WALL_GAP * unit).box) / unit
            box = np.array(shape.grown(grown).box) / unit
            if (box[:2] > reach_high).any() or (box[2:] < reach_low).any():
                continue
            side = _wall_side(ungrown, xy, reach_low, reach_high)
            if side is None:
                boxes.append(box)
            elif side < 2:
                field[side] = max(field[side], ungrown[side + 2])
            else:
                field[side] = min(field[side], ungrown[side - 2])
        field[:2] = np.minimum(field[:2], xy.min(axis=0))  # who is beyond a wall may be there
        field[2:] = np.maximum(field[2:], xy.max(axis=0))
        return cls(boxes, field)


def _wall_side(box: Floats, xy: Floats, low: Floats, high: Floats) -> int | None:
    """Find the side of the field on which a box is a wall.

    A wall spans the reach of the robots across this side, and has all positions on its inner side.

    Args:
        box: Left, bottom, right and top of the box.
        xy: Positions of all robots and targets, shape (M, 2).
        low: Minimum x and y that a robot can reach.
        high: Maximum x and y that a robot can reach.

    Returns:
        The index of the side in `Scene.field`. None if the box is not a wall.
    """
    for axis in (0, 1):
        across = 1 - axis
        if box[across] <= low[across] and box[across + 2] >= high[across]:
            if box[axis + 2] < xy[:, axis].min():
                return axis
            if box[axis] > xy[:, axis].max():
                return axis + 2
    return None


class Shooter:
    """The nonlinear programme for sequences of one length, with IPOPT as its solver.

    Lengths are in the unit from `length_unit`, so that variables are near 1.

    Args:
        motion: Name of the motion model.
        count: Number of robots.
        length: Number of signals.
        boxes: Number of obstacles.
        guess_weight: Weight of the squared change of the directions from the guess.
        options: Options of IPOPT.

    Attributes:
        iterations: Number of IPOPT iterations of the last solution.
    """

    def __init__(
        self,
        motion: str,
        count: int,
        length: int,
        boxes: int,
        guess_weight: float,
        options: Mapping[str, Any],
    ) -> None:
        import casadi as ca

        self.length = length
        self.guess_weight = guess_weight
        self.iterations = 0
        columns = count * length
        u = ca.MX.sym("u", 1, length)
        states = ca.MX.sym("s", 3, columns)
        start = ca.MX.sym("p", 3, count)
        targets = ca.MX.sym("t", 2, count)
        robots = ca.MX.sym("r", 2, count)
        hold_s = ca.MX.sym("h", 1, length)
        guess = ca.MX.sym("n", 1, length)
        scene = ca.MX.sym("b", 4, boxes)
        signal = np.repeat(np.arange(length), count).tolist()  # of each column of `states`
        states_before = ca.horzcat(start, states[:, : columns - count])
        step = _step_function(motion).map(columns)
        states_after = step(
            states_before, u[:, signal], ca.repmat(robots, 1, length), hold_s[:, signal]
        )
        defects = [ca.vec(states_after - states)]
        outside_box = _outside_function().map(columns)
        for i in range(boxes):
            box = ca.repmat(scene[:, i], 1, columns)
            defects.append(ca.vec(outside_box(states[:2, :], box)))
        cost = ca.sumsqr(states[:2, columns - count :] - targets)
        programme = {
            "x": ca.vertcat(ca.vec(u), ca.vec(states)),
            "p": ca.vertcat(*map(ca.vec, (start, robots, hold_s, targets, scene, guess))),
            "f": cost + guess_weight * ca.sumsqr(u - guess),
            "g": ca.vertcat(*defects),
        }
        settings = {"print_time": False, "ipopt": dict(options)}
        self.solver = ca.nlpsol("shoot", "ipopt", programme, settings)

    def solve(self, problem: Problem, guess: Floats) -> Floats:
        """Compute the directions (L,) from a guess (L,).

        If a robot starts or has its target within the curve around an obstacle, it may come as near
        to the obstacle as this start or target.
        """
        unit = length_unit(problem)
        length = self.length
        scene = Scene.of(problem, self.length)
        path = predict(problem, guess)[1:]  # (L, N, 3)
        path[..., :2] /= unit
        poses = problem.poses.array()
        targets = problem.targets / unit
        poses[:, :2] /= unit
        hold_s = np.full(length, problem.period)
        hold_s[0] = problem.first_period
        robots = np.column_stack([problem.a, problem.speed / unit])
        state_min = np.full_like(path, -np.inf)
        state_max = np.full_like(path, np.inf)
        state_min[..., :2] = scene.field[:2]
        state_max[..., :2] = scene.field[2:]
        unlimited = np.full(length, np.inf)
        constraints_min = [np.zeros(path.size)]
        ends = np.vstack([poses[:, :2], targets])
        for box in scene.boxes:
            box_of_ends = np.tile(box[:, None], len(ends))
            distances = np.array(_outside_function()(ends.T, box_of_ends)).ravel()
            allowed = np.minimum(distances, 0.0).reshape(2, -1).min(axis=0)
            constraints_min.append(np.tile(allowed, length))
        constraint_min = np.concatenate(constraints_min)
        parts = poses, robots, hold_s, targets, *scene.boxes, guess
        solution = self.solver(
            x0=np.concatenate([guess, path.ravel()]),
            p=np.concatenate([np.ravel(part) for part in parts]),
            lbx=np.concatenate([-unlimited, state_min.ravel()]),
            ubx=np.concatenate([unlimited, state_max.ravel()]),
            lbg=constraint_min,
            ubg=np.where(np.arange(constraint_min.size) < path.size, 0.0, np.inf),
        )
        self.iterations = self.solver.stats()["iter_count"]
        return np.array(solution["x"]).ravel()[:length]


def shooting_programme(
    problem: Problem, length: int, iterations: int, cap_s: float = NO_LIMIT_S, warm: bool = False
) -> Shooter:
    """Return the programme for sequences of one length. Each programme is built once in a process.

    Args:
        problem: The problem, which determines the numbers of robots and boxes.
        length: Number of signals.
        iterations: Maximum number of IPOPT iterations of a solution.
        cap_s: Maximum duration of a solution [s].
        warm: Whether solutions begin at warm starts instead of random ones.
    """
    counts = problem.a.size, length, len(Scene.of(problem, length).boxes)
    return _cached_shooter(problem.motion, *counts, iterations, cap_s, warm)


@cache
def _cached_shooter(
    motion: str, count: int, length: int, boxes: int, iterations: int, cap_s: float, warm: bool
) -> Shooter:
    options = SHARED_OPTIONS | (WARM_OPTIONS if warm else COLD_OPTIONS)
    options |= {"max_iter": iterations, "max_wall_time": cap_s}
    return Shooter(motion, count, length, boxes, GUESS_WEIGHT if warm else 0.0, options)


@cache
def _step_function(motion: str) -> Any:
    """Return one step of one robot as a function of (state, u, (a, speed), T)."""
    import casadi as ca

    state = ca.SX.sym("s", 3)
    u = ca.SX.sym("u")
    robot = ca.SX.sym("r", 2)
    period = ca.SX.sym("t")
    x = state[0]
    y = state[1]
    heading = state[2]
    a = robot[0]
    v = robot[1]
    phi = u - heading
    if motion == "euler":
        east = period * v * ca.cos(heading)
        north = period * v * ca.sin(heading)
        turn = period * a * ca.sin(phi)
    else:
        remaining = ca.exp(-a * period)
        cos_phi = ca.cos(phi)
        sin_phi = ca.sin(phi)
        two_h = (1 + cos_phi) + (1 - cos_phi) * remaining * remaining
        turn = 2 * ca.atan2(sin_phi * (1 - remaining), (1 + cos_phi) + (1 - cos_phi) * remaining)
        along = v * (period + ca.log(two_h / 2) / a)
        right = v * turn / a
        east = along * ca.cos(u) + right * ca.sin(u)
        north = along * ca.sin(u) - right * ca.cos(u)
    state_after = ca.vertcat(x + east, y + north, heading + turn)
    return ca.Function("step", [state, u, robot, period], [state_after])


@cache
def _outside_function() -> Any:
    """Return a function of a position and a box that is at least 0 outside of the box.

    Near its zero, the function is about the distance in units. It is a smooth maximum of the
    distances to the sides: 0 at the corners, and within BEND of the sides.
    """
    import casadi as ca

    position = ca.SX.sym("at", 2)
    box = ca.SX.sym("box", 4)
    x = position[0]
    y = position[1]
    sides = ca.vertcat(box[0] - x, x - box[2], box[1] - y, y - box[3]) / CORNER_RADIUS
    largest = ca.mmax(sides)
    exponentials = ca.exp(sides - largest)
    smooth_max = largest + ca.log(ca.sum1(exponentials)) - np.log(2)
    return ca.Function("box", [position, box], [CORNER_RADIUS * smooth_max])
