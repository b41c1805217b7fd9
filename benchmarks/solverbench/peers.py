"""Other people's optimisers on our problems, each with the best settings that we found.

All except IPOPT evaluate J with our compiled kernel, so that only the search is compared. Each
optimiser restarts when it gets stuck, until J <= GOOD or the time is over.
"""

import importlib.util
import itertools
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

import numpy as np

from tetractl.control.search.cost import evaluate
from tetractl.control.search.evaluate import compiled_costs
from tetractl.control.search.optimizers.multistart import Multistart
from tetractl.control.search.optimizers.pso import Pso, Swarm
from tetractl.control.search.rng import mix
from tetractl.control.search.stop import TargetStop
from tetractl.core.plan import Limits, Problem
from tetractl.core.poses import Floats
from tetractl.spec.controller import OptimizerSection

from .problems import PARTICLES

GOOD = 1.0  # mm of total error
Peer = Callable[["Meter", int], NoReturn]
"""Searches, with a seed, until the meter raises Over."""


def available(module: str) -> bool:
    """Check whether another solver is installed."""
    return importlib.util.find_spec(module) is not None


class Over(Exception):  # noqa: N818 - the end of a race is no error
    """Raised when a solver has reached J <= GOOD, or when its time is over."""


class Meter:
    """Evaluates J for one problem and plan length, and ends the race between solvers."""

    def __init__(self, problem: Problem, length: int, cap_s: float) -> None:
        self.problem = problem
        self.length = length
        self.best = np.inf
        self.begin = time.process_time()
        self.end = self.begin + cap_s

    def of_columns(self, signals: Floats) -> Floats:
        """Evaluate J of signals (L, P)."""
        total = compiled_costs(self.problem, signals.shape[1])(signals)
        self.note(float(total.min()))
        return total

    def of_rows(self, signals: Floats) -> Floats:
        """Evaluate J of signals (P, L)."""
        return self.of_columns(signals.T)

    def note(self, cost: float) -> None:
        self.best = min(self.best, cost)
        if self.best <= GOOD or self.expired():
            raise Over

    def expired(self, _: int = 0) -> bool:
        return time.process_time() >= self.end


def race(peer: Peer, problem: Problem, length: int, seed: int, cap_s: float) -> tuple[float, float]:
    """Run a solver, and return its processor time [s] and its best J."""
    meter = Meter(problem, length, cap_s)
    with suppress(Over):
        peer(meter, seed)
    return time.process_time() - meter.begin, meter.best


def _ours(optimizer: OptimizerSection) -> Peer:
    def run(meter: Meter, seed: int) -> NoReturn:
        problem = meter.problem
        length = meter.length
        for again in itertools.count():
            key = mix(seed, again)
            plan = optimizer.search(problem, length, None, key, Limits(expired=meter.expired))
            meter.note(float(evaluate(problem, plan.signals[None]).total[0]))
        raise AssertionError

    return run


_TARGET = TargetStop(type="target", cost=GOOD)
_MULTISTART = Multistart(tolerance=GOOD, rounds=8)
ours = _ours(_MULTISTART)
_SWARM = Pso(particles=PARTICLES, iterations=400, stop=_TARGET)
our_pso = _ours(_SWARM)


def compile_for(problem: Problem, length: int) -> None:
    """Compile our searches of a problem in advance, so that compilation is never timed."""
    for optimizer in (_MULTISTART, _SWARM):
        optimizer.search(problem, length, np.zeros(length), 0, Limits())


def reference(meter: Meter, seed: int) -> NoReturn:
    """Run our particle swarm, with J from the NumPy reference."""

    def numpy_costs(signals: np.ndarray) -> np.ndarray:
        return evaluate(meter.problem, signals.T).total

    for again in itertools.count():
        swarm = Swarm.scattered(_SWARM, meter.length, mix(seed, again), numpy_costs)
        while swarm.z < _SWARM.iterations:
            swarm.iterate()
            meter.note(swarm.best.cost)
    raise Over


def pyswarms(meter: Meter, seed: int) -> NoReturn:
    from pyswarms.single import GlobalBestPSO

    np.random.seed(seed)  # noqa: NPY002 - it draws from NumPy's global generator
    bounds = (np.full(meter.length, -np.pi), np.full(meter.length, np.pi))
    while True:
        swarm = GlobalBestPSO(PARTICLES, meter.length, OPTIONS, bounds, bh_strategy="nearest")
        swarm.optimize(meter.of_rows, 400, verbose=False)


OPTIONS = {"w": 0.7, "c1": 1.5, "c2": 1.5}


def pycma(meter: Meter, seed: int) -> NoReturn:
    """Run CMA-ES without bounds, because J is periodic; a diagonal covariance was best."""
    import cma

    rng = np.random.default_rng(seed)
    for again in range(10**9):
        options = {"seed": 1 + seed + 1000 * again, "verbose": -9, "popsize": 32}
        options |= {"CMA_diagonal": True, "tolflatfitness": 20}
        start = smooth_start(meter.problem, meter.length, rng)
        search = cma.CMAEvolutionStrategy(start, 0.2, options)
        while not search.stop():
            candidates = search.ask()
            costs = meter.of_rows(np.array(candidates))
            search.tell(candidates, costs.tolist())
    raise AssertionError


def scipy_de(meter: Meter, seed: int) -> NoReturn:
    from scipy.optimize import differential_evolution

    for again in range(10**9):
        differential_evolution(
            meter.of_columns,
            [(-np.pi, np.pi)] * meter.length,
            vectorized=True,
            updating="deferred",
            strategy="best1bin",
            popsize=2,
            mutation=(0.4, 0.9),
            recombination=0.9,
            maxiter=10**6,
            tol=0,
            polish=False,
            rng=np.random.default_rng([seed, again]),
        )
    raise AssertionError


def smooth_start(problem: Problem, length: int, rng: np.random.Generator) -> Floats:
    """Sample a smooth curve through a few directions near the bearing of the targets."""
    gaps = problem.targets - problem.poses.xy
    bearing = np.arctan2(gaps[:, 1].sum(), gaps[:, 0].sum())
    knots = rng.uniform(-np.pi / 2, np.pi / 2, 6)
    return bearing + np.interp(np.linspace(0, 5, length), np.arange(6), knots)
