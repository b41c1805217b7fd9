"""CasADi and IPOPT: multiple shooting, from several starts and warm-started in the loop.

States and directions are variables, the motion a constraint between neighbours; the cost is the
sum of the squared misses. A rectangle is kept out at the samples by a smooth curve round it, since
IPOPT differentiates twice.
"""

from collections.abc import Callable, Iterable
from typing import Any, NoReturn

import numpy as np

from tetractl.control.algorithm_2 import Mpc
from tetractl.control.cost import evaluate, predict
from tetractl.control.lengths import Candidate
from tetractl.core.plan import Limits, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem

from .peers import Meter, smooth_start
from .problems import LENGTH

METRE = 1000.0  # IPOPT works in metres: variables near 1
SWEPT_MM = 15.0  # by which obstacles are grown, so that no segment between samples cuts a corner
POWER = 6  # of the smooth curve |x/hx|^p + |y/hy|^p = 2, which passes through the corners


class Shooter:
    """The programme for sequences of one length; poses, a, speed and periods are parameters."""

    def __init__(self, problem: Problem, length: int, cap_s: float) -> None:
        import casadi as ca

        count = problem.a.size
        u = ca.MX.sym("u", length)
        states = ca.MX.sym("s", 3 * count, length)
        start, robots = ca.MX.sym("p", 3 * count), ca.MX.sym("r", 2 * count + 2)
        step = _step(ca, problem.motion, count)
        before = ca.horzcat(start, states[:, :-1])
        held = ca.horzcat(robots[-2], ca.repmat(robots[-1], 1, length - 1))
        after = step.map(length)(before, u.T, ca.repmat(robots[:-2], 1, length), held)
        x, y = states[0::3, :], states[1::3, :]
        targets = problem.targets / METRE
        f = ca.sumsqr(x[:, -1] - targets[:, 0]) + ca.sumsqr(y[:, -1] - targets[:, 1])
        kept = [ca.vec(after - states)]
        low = [np.zeros(3 * count * length)]
        high = [np.zeros(3 * count * length)]
        for left, bottom, right, top in (box.row() for box in problem.obstacles.shapes):
            wall = _wall(problem, left, bottom, right, top)
            if wall is not None:
                axis, bound, sign = wall
                kept.append(ca.vec(sign * ((x, y)[axis] - bound / METRE)))
                low.append(np.zeros(count * length))
                high.append(np.full(count * length, np.inf))
                continue
            grown = SWEPT_MM if problem.swept else 0.0
            hx, hy = ((right - left) / 2 + grown) / METRE, ((top - bottom) / 2 + grown) / METRE
            cx, cy = (right + left) / 2 / METRE, (top + bottom) / 2 / METRE
            kept.append(ca.vec(((x - cx) / hx) ** POWER + ((y - cy) / hy) ** POWER))
            low.append(np.full(count * length, 2.0))
            high.append(np.full(count * length, np.inf))
        programme = {
            "x": ca.vertcat(u, ca.vec(states)),
            "p": ca.vertcat(start, robots),
            "f": f,
            "g": ca.vertcat(*kept),
        }
        ipopt = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": 300,
            "tol": 1e-7,
            "hessian_approximation": "limited-memory",  # exact Hessians seldom converged
            "max_wall_time": max(cap_s, 0.01),
        }
        self.solver = ca.nlpsol("shoot", "ipopt", programme, {"print_time": 0, "ipopt": ipopt})
        self.low, self.high, self.length = np.concatenate(low), np.concatenate(high), length

    def solve(self, problem: Problem, guess: Floats) -> Floats:
        """Return the directions (L,) found from a guess (L,)."""
        path = predict(problem, guess)[1:]  # (L, N, 3)
        path[..., :2] /= METRE
        at = problem.poses.array()
        at[:, :2] /= METRE
        periods = [problem.first_period, problem.period]
        robots = np.concatenate([problem.a, problem.speed / METRE, periods])
        found = self.solver(
            x0=np.concatenate([guess, path.reshape(len(guess), -1).ravel()]),
            p=np.concatenate([at.ravel(), robots]),
            lbg=self.low,
            ubg=self.high,
        )
        return np.array(found["x"]).ravel()[: self.length]


def _step(ca: Any, model: str, count: int) -> Any:
    """One step of every robot, as a CasADi function of (states, u, a and speed, T)."""
    s, u = ca.SX.sym("s", 3 * count), ca.SX.sym("u")
    robots, t = ca.SX.sym("r", 2 * count), ca.SX.sym("t")
    new = []
    for i in range(count):
        x, y, heading = s[3 * i], s[3 * i + 1], s[3 * i + 2]
        a, v = robots[i], robots[count + i]
        phi = u - heading
        if model == "euler":
            east, north, turn = (
                t * v * ca.cos(heading),
                t * v * ca.sin(heading),
                t * a * ca.sin(phi),
            )
        else:
            e, c, sin = ca.exp(-a * t), ca.cos(phi), ca.sin(phi)
            d = (1 + c) + (1 - c) * e * e
            turn = 2 * ca.atan2(sin * (1 - e), (1 + c) + (1 - c) * e)
            along, right = v * (t + ca.log(d / 2) / a), v * turn / a
            east = along * ca.cos(u) + right * ca.sin(u)
            north = along * ca.sin(u) - right * ca.cos(u)
        new += [x + east, y + north, heading + turn]
    return ca.Function("step", [s, u, robots, t], [ca.vertcat(*new)])


def _wall(problem: Problem, left: float, bottom: float, right: float, top: float):
    """(axis, bound, sign) of a rectangle far larger than the arena: a wall, else None."""
    if max(right - left, top - bottom) < 10 * METRE:
        return None
    x, y = problem.poses.x, problem.poses.y
    if right < x.min():
        return 0, right, 1
    if left > x.max():
        return 0, left, -1
    return (1, top, 1) if top < y.min() else (1, bottom, -1)


_built: dict[tuple, Shooter] = {}


def shooter(problem: Problem, length: int, cap_s: float) -> Shooter:
    """Return the programme for a length, built once: building is not timed."""
    key = (problem.motion, problem.obstacles.shapes, length, cap_s)
    if key not in _built:
        _built[key] = Shooter(problem, length, cap_s)
    return _built[key]


def ipopt(cap_s: float) -> Callable[[Meter, int], NoReturn]:
    def run(meter: Meter, seed: int) -> NoReturn:
        rng, problem = np.random.default_rng(seed), meter.problem
        programme = shooter(problem, meter.length, cap_s)
        while True:
            found = programme.solve(problem, smooth_start(problem, meter.length, rng))
            meter.note(float(evaluate(problem, found[None]).total[0]))

    return run


class Ipopt:
    """An `Optimizer` by IPOPT: from the warm start, or from up to ten random ones."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        programme, rng = shooter(problem, length, 10.0), np.random.default_rng(key)
        best, least, tried = np.zeros(length), np.inf, 0
        while tried < (10 if warm is None else 1) and least > 1.0:
            guess = smooth_start(problem, length, rng) if warm is None else warm
            found = programme.solve(problem, guess)
            cost = float(evaluate(problem, found[None]).total[0])
            tried += 1
            if cost < least:
                best, least = found, cost
        return Search(length, best, least, np.array([least]), tried, StopReason.ITERATIONS)


class Shrinking(Mpc):
    """Model predictive control by IPOPT: one length at step 0, then what is left of the plan."""

    def _candidates(self) -> Iterable[Candidate]:
        yield (LENGTH, None) if self.warm is None else (len(self.warm), self.warm)


def build_all(problem: Problem, shortest: int) -> None:
    """Build the programmes a closed loop needs, outside its time."""
    for length in range(shortest, LENGTH + 1):
        shooter(problem, length, 10.0)
