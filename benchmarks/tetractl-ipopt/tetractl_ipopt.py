"""`optimizer: {type: ipopt}`: multiple shooting, solved by IPOPT through CasADi.

The variables are states and directions. The motion is a constraint between successive states, and
the cost is the sum of the squared distances to the targets. Obstacles are constraints at the
samples. They are smooth curves around their bounds, because IPOPT needs second derivatives. A shape
that no robot can drive around in time is a wall, which limits the positions.

A nonlinear programme depends only on numbers that seldom change: of robots, signals and boxes. All
other values, including the estimates of the robots, are parameters, so that programmes are built
once.

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
from tetractl.control.search.search_progress import Progress
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.spec.base import Positive
from tetractl.spec.controller import OptimizerSection

BEND = 0.02  # units within which a box's corner is rounded
SWEPT = 0.4  # of the way of a period: so much are obstacles grown, that no step cuts a corner
KNOTS = 4  # of a random start, a robot ...
LEAST_KNOTS = 12  # ... and at least
SCATTERED = 64  # random starts of which the best are taken
TOUCH = 1e-3  # units that walls are kept away from: their edges belong to them
NEAR = 1e-6  # weight of what a warm start is changed by: it makes the Hessian regular
ENDLESS = 1e9  # s
STARTS = 3  # of a search that has no warm start, the best of many random ones
ITERATIONS = 60  # of IPOPT from one random start
POLISH = 40  # from a warm start, and from what a random start has led to
ITERATIONS_ALL = 150  # in one search, after which no further start is made

PIVOT = 1e-8  # as IPOPT has it for MA57; with MUMPS's 1e-6 some solutions take eight times as long
SHARED = {"print_level": 0, "sb": "yes", "mumps_pivtol": PIVOT}
COLD = {"hessian_approximation": "limited-memory", "tol": 1e-6}
WARM = {
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
            solutions.solve(warm, POLISH, warm=True)
            return solutions.search()
        rng = np.random.default_rng(key)
        starts = promising(problem, length, rng, STARTS)
        solutions.note(starts[0])
        for start in starts:
            first = solutions.solve(start, ITERATIONS, warm=False)
            if first is not None:
                solutions.solve(first, POLISH, warm=True)
        return solutions.search()


class _Solutions(Progress):
    """The progress of a search, and the number of IPOPT iterations that remain."""

    def __init__(self, problem: Problem, length: int, limits: Limits, tolerance: float) -> None:
        super().__init__(length, limits)
        self.problem = problem
        self.tolerance = tolerance
        self.left = ITERATIONS_ALL

    def note(self, signals: Floats) -> None:
        """Evaluate one sequence. The search is over if it is good enough."""
        self.add(signals[:, None], evaluate(self.problem, signals[None]).total)
        if self.cost <= self.tolerance:
            self.ended = StopReason.TARGET

    def solve(self, guess: Floats, iterations: int, warm: bool) -> Floats | None:
        """Solve from a guess, and return the result. None if the search is over."""
        if self.ended is None:
            self.ended = self.limit_before(1)
        if self.ended is not None or self.left <= 0:
            return None
        programme = shooter(self.problem, self.length, iterations, warm=warm)
        signals = wrap(programme.solve(self.problem, guess))
        self.left -= programme.iterations
        self.note(signals)
        return signals


def promising(
    problem: Problem, length: int, rng: np.random.Generator, count: int
) -> Sequence[Floats]:
    """Return the `count` best of many random curves (length,), best first."""
    knots_max = max(LEAST_KNOTS, KNOTS * problem.a.size)
    size = min(knots_max, length), max(SCATTERED, count)
    x, y = (problem.targets - problem.poses.xy).T
    bearing = np.arctan2(y.sum(), x.sum())  # of the mean vector from robots to targets
    knots = rng.uniform(-np.pi, np.pi, size)
    places = np.linspace(0, len(knots) - 1, length)
    turns = [np.interp(places, range(len(knots)), of_curve) for of_curve in knots.T]
    curves = bearing + np.array(turns).T
    costs = evaluate(problem, curves.T).total
    return [curves[:, i] for i in np.argsort(costs, kind="stable")[:count]]


def unit_of(problem: Problem) -> float:
    """Return the length unit of a programme: the distance of the fastest robot in five seconds."""
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
        unit = unit_of(problem)
        xy = np.vstack([problem.poses.xy, problem.targets]) / unit
        way = problem.seconds(length) * float(problem.speed.max()) / unit
        start = problem.poses.xy / unit
        low = start.min(axis=0) - way
        high = start.max(axis=0) + way
        grown = SWEPT * problem.period * float(problem.speed.max()) * problem.swept
        field = np.array([-np.inf, -np.inf, np.inf, np.inf])
        boxes: list[Floats] = []
        region: Any = problem.obstacles
        if region.inside is not None:  # the walls of the arena
            outside = np.array([-1.0, -1.0, 1.0, 1.0]) * TOUCH * unit
            field = (region.walls - outside) / unit
        for shape in region.shapes:
            bare = np.array(shape.grown(TOUCH * unit).box) / unit
            box = np.array(shape.grown(grown).box) / unit
            if (box[:2] > high).any() or (box[2:] < low).any():
                continue
            side = _side(bare, xy, low, high)
            if side is None:
                boxes.append(box)
            elif side < 2:
                field[side] = max(field[side], bare[side + 2])
            else:
                field[side] = min(field[side], bare[side - 2])
        field[:2] = np.minimum(field[:2], xy.min(axis=0))  # who is beyond a wall may be there
        field[2:] = np.maximum(field[2:], xy.max(axis=0))
        return cls(boxes, field)


def _side(box: Floats, xy: Floats, low: Floats, high: Floats) -> int | None:
    """Return the side of the field beyond which a box is a wall. None if it is no wall.

    Sides count as in `field`. The positions xy (M, 2) are on one side of a wall, and the wall must
    span `low` to `high`.
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
    """The nonlinear programme for sequences of one length. All but counts are its parameters.

    Lengths are in the unit from `unit_of`, so that variables are near 1. `near` is the weight of
    changes of the directions. `options` are IPOPT's. `iterations` are those of the last solution.
    """

    def __init__(
        self,
        motion: str,
        count: int,
        length: int,
        boxes: int,
        near: float,
        options: Mapping[str, Any],
    ) -> None:
        import casadi as ca

        self.length = length
        self.near = near
        self.iterations = 0
        stages = count * length
        u = ca.MX.sym("u", 1, length)
        states = ca.MX.sym("s", 3, stages)
        start = ca.MX.sym("p", 3, count)
        targets = ca.MX.sym("t", 2, count)
        robots = ca.MX.sym("r", 2, count)
        held = ca.MX.sym("h", 1, length)
        guess = ca.MX.sym("n", 1, length)
        scene = ca.MX.sym("b", 4, boxes)
        signal = np.repeat(np.arange(length), count).tolist()  # of each column of `states`
        before = ca.horzcat(start, states[:, : stages - count])
        step = _step(motion).map(stages)
        after = step(before, u[:, signal], ca.repmat(robots, 1, length), held[:, signal])
        defects = [ca.vec(after - states)]
        outside = _outside().map(stages)
        for i in range(boxes):
            box = ca.repmat(scene[:, i], 1, stages)
            defects.append(ca.vec(outside(states[:2, :], box)))
        cost = ca.sumsqr(states[:2, stages - count :] - targets)
        programme = {
            "x": ca.vertcat(ca.vec(u), ca.vec(states)),
            "p": ca.vertcat(*map(ca.vec, (start, robots, held, targets, scene, guess))),
            "f": cost + near * ca.sumsqr(u - guess),
            "g": ca.vertcat(*defects),
        }
        settings = {"print_time": False, "ipopt": dict(options)}
        self.solver = ca.nlpsol("shoot", "ipopt", programme, settings)

    def solve(self, problem: Problem, guess: Floats) -> Floats:
        """Compute the directions (L,) from a guess (L,).

        A robot that starts or should end within the curve around an obstacle may come as near to
        the obstacle.
        """
        unit = unit_of(problem)
        length = self.length
        scene = Scene.of(problem, self.length)
        path = predict(problem, guess)[1:]  # (L, N, 3)
        path[..., :2] /= unit
        poses = problem.poses.array()
        targets = problem.targets / unit
        poses[:, :2] /= unit
        held = np.full(length, problem.period)
        held[0] = problem.first_period
        robots = np.column_stack([problem.a, problem.speed / unit])
        low = np.full_like(path, -np.inf)
        high = np.full_like(path, np.inf)
        low[..., :2] = scene.field[:2]
        high[..., :2] = scene.field[2:]
        free = np.full(length, np.inf)
        least = [np.zeros(path.size)]
        ends = np.vstack([poses[:, :2], targets])
        for box in scene.boxes:
            box_of_ends = np.tile(box[:, None], len(ends))
            room = np.array(_outside()(ends.T, box_of_ends)).ravel()
            robot = np.minimum(room, 0.0).reshape(2, -1).min(axis=0)
            least.append(np.tile(robot, length))
        lowest = np.concatenate(least)
        parts = poses, robots, held, targets, *scene.boxes, guess
        solution = self.solver(
            x0=np.concatenate([guess, path.ravel()]),
            p=np.concatenate([np.ravel(part) for part in parts]),
            lbx=np.concatenate([-free, low.ravel()]),
            ubx=np.concatenate([free, high.ravel()]),
            lbg=lowest,
            ubg=np.where(np.arange(lowest.size) < path.size, 0.0, np.inf),
        )
        self.iterations = self.solver.stats()["iter_count"]
        return np.array(solution["x"]).ravel()[:length]


def shooter(
    problem: Problem, length: int, iterations: int, cap_s: float = ENDLESS, warm: bool = False
) -> Shooter:
    """Return the programme for a length, from random or warm starts. It is built once in a process.

    A solution ends after a number of iterations, or after `cap_s` [s].
    """
    counts = problem.a.size, length, len(Scene.of(problem, length).boxes)
    return _built(problem.motion, *counts, iterations, cap_s, warm)


@cache
def _built(
    motion: str, count: int, length: int, boxes: int, iterations: int, cap_s: float, warm: bool
) -> Shooter:
    options = SHARED | (WARM if warm else COLD)
    options |= {"max_iter": iterations, "max_wall_time": cap_s}
    return Shooter(motion, count, length, boxes, NEAR if warm else 0.0, options)


@cache
def _step(motion: str) -> Any:
    """Return one step of one robot as a function of (state, u, (a, speed), T)."""
    import casadi as ca

    s = ca.SX.sym("s", 3)
    u = ca.SX.sym("u")
    robot = ca.SX.sym("r", 2)
    t = ca.SX.sym("t")
    x = s[0]
    y = s[1]
    heading = s[2]
    a = robot[0]
    v = robot[1]
    phi = u - heading
    if motion == "euler":
        east = t * v * ca.cos(heading)
        north = t * v * ca.sin(heading)
        turn = t * a * ca.sin(phi)
    else:
        e = ca.exp(-a * t)
        c = ca.cos(phi)
        sin = ca.sin(phi)
        d = (1 + c) + (1 - c) * e * e
        turn = 2 * ca.atan2(sin * (1 - e), (1 + c) + (1 - c) * e)
        along = v * (t + ca.log(d / 2) / a)
        right = v * turn / a
        east = along * ca.cos(u) + right * ca.sin(u)
        north = along * ca.sin(u) - right * ca.cos(u)
    new = ca.vertcat(x + east, y + north, heading + turn)
    return ca.Function("step", [s, u, robot, t], [new])


@cache
def _outside() -> Any:
    """Return a function of a position and a box that is at least 0 outside of the box.

    Near its zero, the function is about the distance in units. It is a smooth maximum of the
    distances to the sides: 0 at the corners, and within BEND of the sides.
    """
    import casadi as ca

    time = ca.SX.sym("at", 2)
    box = ca.SX.sym("box", 4)
    x = time[0]
    y = time[1]
    sides = ca.vertcat(box[0] - x, x - box[2], box[1] - y, y - box[3]) / BEND
    largest = ca.mmax(sides)
    exponentials = ca.exp(sides - largest)
    soft = largest + ca.log(ca.sum1(exponentials)) - np.log(2)
    return ca.Function("box", [time, box], [BEND * soft])
