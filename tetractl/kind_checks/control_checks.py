"""Checks of an optimiser: its searches are consistent, bounded and repeatable; and of a controller:
its decisions in short undisturbed simulations.
"""

import math
import sys
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import FieldOff
from tetractl.core.plan import End, Limits, Outcome, Plan, Problem
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.protocols import LabSupervision, Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.controller import ControllerSection, OptimizerSection
from tetractl.kind_checks.finding import SEED, Finding, Findings, near, random_watched, same, true
from tetractl.model.obstacles import Obstacles
from tetractl.plant.simulation import SimSection

STEPS_MAX = 3
CLOCKS = {"time", "perf_counter", "monotonic", "process_time", "now", "utcnow", "today"}


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
            if (most := optimizer.evaluations_max) is not None:
                text = f"{what}evaluations: at most evaluations_max"
                yield true(text, found.evaluations <= most, str(found.evaluations))
            budget = optimizer.evaluations_min + 5
            spent = optimizer.search(problem, length, warm, SEED, Limits(budget)).evaluations
            yield true(f"{what}evaluations: in budget", spent <= budget, f"{spent} of {budget}")


class Play:
    """The decisions of a controller in one simulation, and what it did besides."""

    def __init__(self, section: ControllerSection, setup: Setup) -> None:
        self.decisions: list[Any] = []
        self.changed = self.wrapped = False  # whether it changes observations, and uses `wrap`
        self.clocks: set[str] = set()
        self._package = type(section).__module__.partition(".")[0]
        sys.setprofile(self._called)
        try:
            self._drive(section, setup)
        finally:
            sys.setprofile(None)
        self.plans = [one for one in self.decisions if isinstance(one, Plan)]
        self.numbers = [_numbers(one) for one in self.plans]

    def _drive(self, section: ControllerSection, setup: Setup) -> None:
        clock, timer = VirtualClock(), count(step=SECOND // 1000)
        plant = SimSection().build(setup, clock, np.random.SeedSequence(SEED), LabSupervision())
        controller = section.build(setup, SEED, self._wrap, lambda: next(timer))
        plant.open()
        command, earlier = None, list[Observation]()
        for k in range(STEPS_MAX + 2):
            seen = plant.observe()
            before = seen.poses.array()
            decision = controller.plan(seen, command, earlier)
            self.changed |= not np.array_equal(before, seen.poses.array())
            self.decisions.append(decision)
            if not isinstance(decision, Plan) or not np.isfinite(decision.signals).all():
                return
            command = plant.send(decision.action)
            clock.sleep_until(round((k + 1) * section.period * SECOND))
            earlier = [sample.observation for sample in plant.samples()][:-1]

    def _wrap(self, optimizer: OptimizerSection) -> Optimizer:
        self.wrapped = True
        return optimizer

    def _called(self, frame: Any, event: str, called: Any) -> None:
        """Note each call of a clock by the section's package."""
        if event == "c_call" and frame.f_globals["__name__"].partition(".")[0] == self._package:
            clock = called.__name__.removesuffix("_ns") in CLOCKS
            if clock and "time" in repr(called.__self__):
                self.clocks.add(f"line {frame.f_lineno} calls {called.__name__}")


def check_controller(section: ControllerSection, setup: Setup) -> Findings:
    """Check a controller's plans and its end, and that the key alone determines its decisions."""
    if any(section.contradictions(setup)):
        setup = setup.only([0])  # some controllers steer one robot
    section = section.model_copy(update={"steps_max": STEPS_MAX, "arrival_tolerance": 20.0})
    setup = replace(setup, period_s=section.period, steps_max=STEPS_MAX)
    section.warm_up(setup)
    with random_watched() as used:
        play, again = Play(section, setup), Play(section, setup)
    plans, decisions, robots = play.plans, play.decisions, len(setup.names)
    odd = [repr(one) for one in decisions if not isinstance(one, Plan | Outcome | End)]
    yield Finding("plan: returns a Plan, an Outcome or an End", ", ".join(odd))
    if odd:
        return
    yield true(
        "plan: at least one signal; a path (signals + 1, robots, 3)",
        [one.signals.size and one.path.shape == (one.signals.size + 1, robots, 3) for one in plans],
    )
    finite = [np.isfinite(each).all() for each in play.numbers]
    yield true("plan: signals, path and costs are finite", finite)
    chosen = [np.array_equal(one.signals, one.search.signals) for one in plans]
    yield true("plan: signals of the chosen search", chosen)
    off = [section.switches_field or not isinstance(one.instead, FieldOff) for one in plans]
    yield true("plan: FieldOff only with switches_field", off)
    late = len(plans) == len(decisions) or len(plans) > STEPS_MAX + 1
    yield true("steps_max: ends the trial", not late)
    there = Poses.of(np.column_stack([setup.targets, np.zeros(robots)]))
    seen = Observation(0, 0, 0, there, np.ones(robots, dtype=np.bool_))
    late = isinstance(section.build(setup, SEED).plan(seen), Plan)
    yield true("arrival_tolerance: ends the trial", not late)
    yield true("observation: not changed", not play.changed)
    searches = any(isinstance(one, OptimizerSection) for _, one in section)
    yield true("wrap: gets the optimiser", play.wrapped or not searches)
    yield same("key: same key, same decisions", play.numbers, again.numbers)
    yield Finding("random numbers: from the key", " and ".join(used))
    yield Finding("clock: only timer", ", ".join(sorted(play.clocks)))


def _numbers(plan: Plan) -> Floats:
    costs = [plan.cost, plan.target_cost, plan.obstacle_cost, plan.generator]
    return np.concatenate([plan.signals, plan.path.ravel(), costs])
