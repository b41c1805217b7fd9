"""`optimizer: {type: ipopt}`: multiple shooting, solved by IPOPT through CasADi.

States and directions are the variables, the motion is a constraint between neighbours in time, and
the cost is the sum of the squared distances to the targets. Obstacles are constraints at the
samples: a disc as it is, any other shape as a smooth curve round its bounds, since IPOPT
differentiates twice.
"""

from typing import Any, Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import evaluate, predict
from tetractl.control.curves import bearing, interpolate
from tetractl.control.progress import Progress
from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats, wrap
from tetractl.core.problem import Problem
from tetractl.experiment.base import Positive
from tetractl.experiment.controller import OptimizerSection

POWER = 6  # of the curve |x/hx|^p + |y/hy|^p = 2, which passes through the corners of a box
SWEPT = 0.4  # of the way of a period: so much are obstacles grown, that no step cuts a corner
KNOTS = 6  # of a random start
ENDLESS = 1e9  # s
FAR = 10.0  # shapes are a wall from this many times the robots' gaps on


class Ipopt(OptimizerSection):
    """IPOPT on the states and directions of all robots, from the warm start or random curves."""

    type: Literal["ipopt"]
    starts: int = Field(default=10, ge=1, le=1000)
    """Random starts of a search that has no warm start."""
    iterations: int = Field(default=300, ge=1, le=100_000)
    """Iterations of IPOPT from one start."""
    tolerance: Positive = 1.0
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations_max(self) -> int:
        """A start is an iteration, and so is a warm start."""
        return self.starts + 1

    @property
    def evaluations_min(self) -> int:
        """That of the warm start."""
        return 1

    @property
    def good_enough(self) -> float:
        """The tolerance."""
        return self.tolerance

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Solve from the warm start unless it is good enough; without one from random curves.

        J (7) of what IPOPT returns decides. The time of one solution is not limited.
        """
        rng, progress = np.random.default_rng(key), Progress(length, limits)
        programme = shooter(problem, length, self.iterations)
        for k in range(self.starts if warm is None else 2):
            if progress.history and not progress.affords(1):
                break
            if warm is None:
                found = wrap(programme.solve(problem, curve(problem, length, rng)))
            else:
                found = warm if k == 0 else wrap(programme.solve(problem, warm))
            progress.add(found[:, None], evaluate(problem, found[None]).total)
            if progress.cost <= self.tolerance:
                progress.ended = StopReason.TARGET
                break
        return progress.search()


def curve(problem: Problem, length: int, rng: np.random.Generator) -> Floats:
    """Return a random curve (L,) through a few directions around the bearing of the targets."""
    knots = rng.uniform(-np.pi / 2, np.pi / 2, (min(KNOTS, length), 1))
    return bearing(problem) + interpolate(knots, length)[:, 0]


class Shooter:
    """The programme for sequences of one length; poses, a, speed and periods are its parameters.

    Lengths are in units of `unit`, so that variables are near 1. `cap_s` ends a solution [s].
    """

    def __init__(self, problem: Problem, length: int, iterations: int, cap_s: float) -> None:
        import casadi as ca

        self.unit, self.length = scale(problem), length
        count = problem.a.size
        u, states = ca.MX.sym("u", length), ca.MX.sym("s", 3 * count, length)
        start, robots = ca.MX.sym("p", 3 * count), ca.MX.sym("r", 2 * count + 2)
        before = ca.horzcat(start, states[:, :-1])
        held = ca.horzcat(robots[-2], ca.repmat(robots[-1], 1, length - 1))
        step = _step(ca, problem.motion, count).map(length)
        after = step(before, u.T, ca.repmat(robots[:-2], 1, length), held)
        x, y = states[0::3, :], states[1::3, :]
        targets = problem.targets / self.unit
        kept, low, high = [ca.vec(after - states)], [0.0], [0.0]
        for shape in problem.obstacles.shapes:
            kept.append(ca.vec(_outside(ca, problem, shape, x, y, self.unit)))
            low.append(0.0)
            high.append(np.inf)
        programme = {
            "x": ca.vertcat(u, ca.vec(states)),
            "p": ca.vertcat(start, robots),
            "f": ca.sumsqr(x[:, -1] - targets[:, 0]) + ca.sumsqr(y[:, -1] - targets[:, 1]),
            "g": ca.vertcat(*kept),
        }
        ipopt = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": 1e-7,
            "hessian_approximation": "limited-memory",  # exact Hessians seldom converged
            "max_wall_time": cap_s,
        }
        self.solver = ca.nlpsol("shoot", "ipopt", programme, {"print_time": 0, "ipopt": ipopt})
        sizes = [part.numel() for part in kept]
        self.low, self.high = np.repeat(low, sizes), np.repeat(high, sizes)

    def solve(self, problem: Problem, guess: Floats) -> Floats:
        """Return the directions (L,) found from a guess (L,)."""
        path = predict(problem, guess)[1:]  # (L, N, 3)
        path[..., :2] /= self.unit
        at = problem.poses.array()
        at[:, :2] /= self.unit
        periods = [problem.first_period, problem.period]
        found = self.solver(
            x0=np.concatenate([guess, path.ravel()]),
            p=np.concatenate([at.ravel(), problem.a, problem.speed / self.unit, periods]),
            lbg=self.low,
            ubg=self.high,
        )
        return np.array(found["x"]).ravel()[: self.length]


def scale(problem: Problem) -> float:
    """Return the unit of length of a programme: five seconds' way of the fastest robot."""
    return 5.0 * float(problem.speed.max())


def _step(ca: Any, motion: str, count: int) -> Any:
    """Return one step of every robot, a function of (states, u, a and speed, T)."""
    s, u = ca.SX.sym("s", 3 * count), ca.SX.sym("u")
    robots, t = ca.SX.sym("r", 2 * count), ca.SX.sym("t")
    new = []
    for i in range(count):
        x, y, heading = s[3 * i], s[3 * i + 1], s[3 * i + 2]
        a, v = robots[i], robots[count + i]
        phi = u - heading
        if motion == "euler":
            east, north = t * v * ca.cos(heading), t * v * ca.sin(heading)
            turn = t * a * ca.sin(phi)
        else:
            e, c, sin = ca.exp(-a * t), ca.cos(phi), ca.sin(phi)
            d = (1 + c) + (1 - c) * e * e
            turn = 2 * ca.atan2(sin * (1 - e), (1 + c) + (1 - c) * e)
            along, right = v * (t + ca.log(d / 2) / a), v * turn / a
            east = along * ca.cos(u) + right * ca.sin(u)
            north = along * ca.sin(u) - right * ca.cos(u)
        new += [x + east, y + north, heading + turn]
    return ca.Function("step", [s, u, robots, t], [ca.vertcat(*new)])


def _outside(ca: Any, problem: Problem, shape: Any, x: Any, y: Any, unit: float) -> Any:
    """Return a function of the places (N, L) that is >= 0 where they are outside a shape.

    A shape many times the size of the scene is a wall: the half-plane beyond its nearest side.
    """
    grown = shape.grown(SWEPT * problem.period * float(problem.speed.max()) * problem.swept)
    numbers = [value / unit for value in grown.row()]
    if shape.type == "circle":
        cx, cy, radius = numbers
        return ((x - cx) / radius) ** 2 + ((y - cy) / radius) ** 2 - 1
    left, bottom, right, top = numbers if shape.type == "rectangle" else _bounds(grown, unit)
    if max(right - left, top - bottom) > FAR * float(np.ptp(problem.targets) / unit + 1):
        at_x, at_y = problem.poses.x / unit, problem.poses.y / unit
        if right < at_x.min():
            return x - right
        if left > at_x.max():
            return left - x
        return y - top if top < at_y.min() else bottom - y
    hx, hy, cx, cy = (right - left) / 2, (top - bottom) / 2, (right + left) / 2, (top + bottom) / 2
    return ((x - cx) / hx) ** POWER + ((y - cy) / hy) ** POWER - 2


def _bounds(shape: Any, unit: float) -> tuple[float, float, float, float]:
    """Return the sides of a shape's bounding box, its margin included."""
    corners, margin = shape.outline() / unit, shape.margin / unit
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    return left - margin, bottom - margin, right + margin, top + margin


_built: dict[tuple[Any, ...], Shooter] = {}


def shooter(problem: Problem, length: int, iterations: int, cap_s: float = ENDLESS) -> Shooter:
    """Return the programme for a length, built once in a process."""
    scene = problem.obstacles.shapes, problem.swept, problem.targets.tobytes(), scale(problem)
    key = (problem.motion, *scene, length, iterations, cap_s)
    if key not in _built:
        _built[key] = Shooter(problem, length, iterations, cap_s)
    return _built[key]
