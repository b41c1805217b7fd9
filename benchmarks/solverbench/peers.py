"""Optimisers of other libraries for our planning problems, with the best settings that we found.

All except IPOPT evaluate J with our compiled kernel, so that only the search is compared. Each
optimiser restarts when it gets stuck, until J <= GOOD_COST_MM or the time is over.
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

GOOD_COST_MM = 1.0
"""Total error J at which a search has succeeded [mm]."""
Peer = Callable[["Meter", int], NoReturn]
"""A solver, as a function that searches with a seed until the meter raises RaceOver."""


def available(module: str) -> bool:
    """Check whether another solver is installed."""
    return importlib.util.find_spec(module) is not None


class RaceOver(Exception):  # noqa: N818 - the end of a race is no error
    """Raised when a solver has reached J <= GOOD_COST_MM, or when its time is over."""


class Meter:
    """Evaluates J for one problem and plan length, and ends the race between solvers."""

    def __init__(self, problem: Problem, length: int, cap_s: float) -> None:
        self.problem = problem
        self.length = length
        self.best_cost = np.inf
        self.start_s = time.process_time()
        self.end_s = self.start_s + cap_s

    def evaluate_columns(self, signals: Floats) -> Floats:
        """Evaluate J of P sequences of L signals, given as the columns of an array (L, P)."""
        costs = compiled_costs(self.problem, signals.shape[1])(signals)
        self.note(float(costs.min()))
        return costs

    def evaluate_rows(self, signals: Floats) -> Floats:
        """Evaluate J of P sequences of L signals, given as the rows of an array (P, L)."""
        return self.evaluate_columns(signals.T)

    def note(self, cost: float) -> None:
        """Record the cost of a sequence, and raise RaceOver if the race has ended."""
        self.best_cost = min(self.best_cost, cost)
        if self.best_cost <= GOOD_COST_MM or self.expired():
            raise RaceOver

    def expired(self, _: int = 0) -> bool:
        """Check whether the processor time of the race is used up."""
        return time.process_time() >= self.end_s


def race(peer: Peer, problem: Problem, length: int, seed: int, cap_s: float) -> tuple[float, float]:
    """Run a solver, and return its processor time [s] and its best J."""
    meter = Meter(problem, length, cap_s)
    with suppress(RaceOver):
        peer(meter, seed)
    return time.process_time() - meter.start_s, meter.best_cost


def _peer_of_optimizer(optimizer: OptimizerSection) -> Peer:
    def run(meter: Meter, seed: int) -> NoReturn:
        problem = meter.problem
        length = meter.length
        for restart in itertools.count():
            key = mix(seed, restart)
            plan = optimizer.search(problem, length, None, key, Limits(expired=meter.expired))
            meter.note(float(evaluate(problem, plan.signals[None]).total[0]))
        raise AssertionError

    return run


_TARGET = TargetStop(type="target", cost=GOOD_COST_MM)
_MULTISTART = Multistart(tolerance=GOOD_COST_MM, rounds=8)
ours = _peer_of_optimizer(_MULTISTART)
_SWARM = Pso(particles=PARTICLES, iterations=400, stop=_TARGET)
our_pso = _peer_of_optimizer(_SWARM)


def compile_for(problem: Problem, length: int) -> None:
    """Compile our searches of a problem in advance, so that compilation is never timed."""
    for optimizer in (_MULTISTART, _SWARM):
        optimizer.search(problem, length, np.zeros(length), 0, Limits())


def numpy_reference(meter: Meter, seed: int) -> NoReturn:
    """Run our particle swarm, with J from the NumPy reference."""

    def numpy_costs(signals: np.ndarray) -> np.ndarray:
        return evaluate(meter.problem, signals.T).total

    for restart in itertools.count():
        swarm = Swarm.create_random(_SWARM, meter.length, mix(seed, restart), numpy_costs)
        while swarm.z < _SWARM.iterations:
            swarm.iterate()
            meter.note(swarm.global_best.cost)
    raise RaceOver


def pyswarms(meter: Meter, seed: int) -> NoReturn:
    from pyswarms.single import GlobalBestPSO

    np.random.seed(seed)  # noqa: NPY002 - it draws from NumPy's global generator
    bounds = (np.full(meter.length, -np.pi), np.full(meter.length, np.pi))
    while True:
        swarm = GlobalBestPSO(PARTICLES, meter.length, OPTIONS, bounds, bh_strategy="nearest")
        swarm.optimize(meter.evaluate_rows, 400, verbose=False)


OPTIONS = {"w": 0.7, "c1": 1.5, "c2": 1.5}


def pycma(meter: Meter, seed: int) -> NoReturn:
    """Run CMA-ES without bounds, because J is periodic; a diagonal covariance was best."""
    import cma

    rng = np.random.default_rng(seed)
    for restart in range(10**9):
        options = {"seed": 1 + seed + 1000 * restart, "verbose": -9, "popsize": 32}
        options |= {"CMA_diagonal": True, "tolflatfitness": 20}
        start = smooth_start(meter.problem, meter.length, rng)
        search = cma.CMAEvolutionStrategy(start, 0.2, options)
        while not search.stop():
            candidates = search.ask()
            costs = meter.evaluate_rows(np.array(candidates))
            search.tell(candidates, costs.tolist())
    raise AssertionError


def scipy_de(meter: Meter, seed: int) -> NoReturn:
    from scipy.optimize import differential_evolution

    for restart in range(10**9):
        differential_evolution(
            meter.evaluate_columns,
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
            rng=np.random.default_rng([seed, restart]),
        )
    raise AssertionError


def smooth_start(problem: Problem, length: int, rng: np.random.Generator) -> Floats:
    """Sample a smooth curve through a few directions near the bearing of the targets."""
    gaps = problem.targets - problem.poses.xy
    bearing = np.arctan2(gaps[:, 1].sum(), gaps[:, 0].sum())
    knots = rng.uniform(-np.pi / 2, np.pi / 2, 6)
    return bearing + np.interp(np.linspace(0, 5, length), np.arange(6), knots)
