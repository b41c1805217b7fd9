"""Fatrop, through CasADi: direct multiple shooting in the order of stages that it asks for.

States, motion and obstacles are those of `tetractl_ipopt`; Hessians are exact, and every start is
cold.
"""

from functools import cache
from typing import Any, NoReturn

import numpy as np

from tetractl.control.cost import evaluate, predict
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats

from .peers import Meter, available

ITERATIONS = 300


def installed() -> bool:
    """Whether CasADi, with Fatrop, and the package of its programmes are installed."""
    if not (available("casadi") and available("tetractl_ipopt")):
        return False
    import casadi as ca

    return ca.has_nlpsol("fatrop")


def fatrop(meter: Meter, seed: int) -> NoReturn:
    """Solve from one random curve after the other, the best of 64 each."""
    from tetractl_ipopt import promising

    rng = np.random.default_rng(seed)
    problem = meter.problem
    programme = Stages.of(problem, meter.length)
    while True:
        (start,) = promising(problem, meter.length, rng, 1)
        solution = programme.solve(problem, start)
        meter.note(float(evaluate(problem, solution[None]).total[0]))


class Stages:
    """The programme for L signals: x_0, u_0, x_1, ..., x_L in units of length near 1."""

    def __init__(self, motion: str, count: int, length: int, discs: int, boxes: int) -> None:
        import casadi as ca
        from tetractl_ipopt import _outside, _step

        self.length = length
        self.step = 3 * count + 1
        states = [ca.MX.sym(f"x{k}", 3, count) for k in range(length + 1)]
        signals = [ca.MX.sym(f"u{k}") for k in range(length)]
        start = ca.MX.sym("p", 3, count)
        targets = ca.MX.sym("t", 2, count)
        robots = ca.MX.sym("r", 2, count)
        held = ca.MX.sym("h", 1, length)
        scene = ca.MX.sym("d", 3, discs), ca.MX.sym("b", 4, boxes)
        move = _step(motion).map(count)
        variables = list[Any]()
        defects = list[Any]()
        equal = list[bool]()

        def keep(expression: Any, equality: bool) -> None:
            defects.append(ca.vec(expression))
            equal.extend([equality] * defects[-1].numel())

        for k, x in enumerate(states):
            variables.append(ca.vec(x))
            if k < length:
                variables.append(signals[k])
                u = ca.repmat(signals[k], 1, count)
                period = ca.repmat(held[k], 1, count)
                keep(states[k + 1] - move(x, u, robots, period), equality=True)
            if k == 0:
                keep(x - start, equality=True)
                continue
            for outside, shapes in zip(_outside(), scene, strict=True):
                for i in range(shapes.shape[1]):
                    shape = ca.repmat(shapes[:, i], 1, count)
                    keep(outside.map(count)(x[:2, :], shape), equality=False)
        self.equal = np.array(equal)
        programme = {
            "x": ca.vertcat(*variables),
            "p": ca.vertcat(*map(ca.vec, (start, robots, held, targets, *scene))),
            "f": ca.sumsqr(states[-1][:2, :] - targets),
            "g": ca.vertcat(*defects),
        }
        options = {"print_level": 0, "max_iter": ITERATIONS, "tol": 1e-6}
        settings = {
            "structure_detection": "auto",
            "equality": equal,
            "print_time": False,
            "expand": True,
        }
        self.solver = ca.nlpsol("stages", "fatrop", programme, settings | {"fatrop": options})

    @staticmethod
    def of(problem: Problem, length: int) -> "Stages":
        """Return the programme of a problem's size, built once."""
        from tetractl_ipopt import Scene

        scene = Scene.of(problem, length)
        sizes = problem.a.size, length, len(scene.discs), len(scene.boxes)
        return _built(problem.motion, *sizes)

    def solve(self, problem: Problem, guess: Floats) -> Floats:
        """Return the directions (L,) found from a guess (L,), in which J is not limited."""
        from tetractl_ipopt import Scene, unit_of

        unit = unit_of(problem)
        length = self.length
        scene = Scene.of(problem, self.length)
        path = predict(problem, guess)  # (L + 1, N, 3)
        path[..., :2] /= unit
        held = np.full(length, problem.period)
        held[0] = problem.first_period
        robots = np.column_stack([problem.a, problem.speed / unit])
        low = np.full_like(path, -np.inf)
        high = np.full_like(path, np.inf)
        low[1:, :, :2] = scene.field[:2]
        high[1:, :, :2] = scene.field[2:]
        parts = path[0], robots, held, problem.targets / unit, *scene.discs, *scene.boxes
        solution = self.solver(
            x0=self._woven(path, guess),
            p=np.concatenate([np.ravel(part) for part in parts]),
            lbx=self._woven(low, np.full(length, -np.inf)),
            ubx=self._woven(high, np.full(length, np.inf)),
            lbg=np.zeros(self.equal.size),
            ubg=np.where(self.equal, 0.0, np.inf),
        )
        return np.array(solution["x"]).ravel()[self.step - 1 :: self.step]

    def _woven(self, path: Floats, signals: Floats) -> Floats:
        """Return states (L + 1, N, 3) and signals (L,) in the order of the variables."""
        rows = np.column_stack([path[:-1].reshape(self.length, -1), signals])
        return np.concatenate([rows.ravel(), path[-1].ravel()])


_built = cache(Stages)
