"""Checks of an optimiser: its searches are consistent, bounded and repeatable."""

import math

import numpy as np

from tetractl.core.plan import Limits, Problem
from tetractl.core.setup import Setup
from tetractl.experiment.controller import OptimizerSection
from tetractl.kind_checks.finding import SEED, Finding, Findings, near, same, true
from tetractl.model.obstacles import Obstacles


def check_optimizer(optimizer: OptimizerSection, setup: Setup) -> Findings:
    """Check that an optimiser's search records are consistent, and that its searches repeat."""
    from tetractl.control.evaluate import compiled_costs

    problem = Problem(
        poses=setup.starts, targets=setup.targets, a=setup.a, speed=setup.speed, motion="exact",
        period=0.2, first_period=0.2, obstacles=Obstacles.of(setup.obstacles),
        obstacle_weight=1000.0, swept=True,
    )  # fmt: skip
    rng = np.random.default_rng(SEED)
    for length in (1, 12):
        for warm in (None, rng.uniform(-math.pi, math.pi, length)):
            kept, what = None if warm is None else warm.copy(), f"{length} signals: "
            found = optimizer.search(problem, length, warm, SEED, Limits())
            again = optimizer.search(problem, length, warm, SEED, Limits())
            if warm is not None:
                what = f"{length} signals, warm start: "
                yield same(f"{what}not changed", [warm], [kept])
            shape = np.shape(found.signals)
            if shape != (length,):
                yield Finding(f"{what}signals", f"have shape {shape}, not ({length},)")
                return
            pair = [(one.signals, one.history, one.evaluations) for one in (found, again)]
            yield same(f"{what}same search for the same key", *pair)
            cost = float(compiled_costs(problem, 1)(found.signals[:, None])[0])
            yield near(f"{what}cost: equals J of signals", found.cost, cost, max(abs(cost), 1e-9))
            yield near(f"{what}history: ends with cost", found.history[-1], found.cost, 1 + cost)
            yield true(f"{what}history: never rises", np.diff(found.history) <= 0, "it rises")
            yield true(f"{what}evaluations: at least 1", found.evaluations >= 1, "there are none")
            if optimizer.evaluations_max is not None:
                fits = found.evaluations <= optimizer.evaluations_max
                yield true(
                    f"{what}evaluations: at most evaluations_max", fits, str(found.evaluations)
                )
            budget = optimizer.evaluations_min + 5
            spent = optimizer.search(problem, length, warm, SEED, Limits(budget)).evaluations
            yield true(f"{what}evaluations: in budget", spent <= budget, f"{spent} of {budget}")
