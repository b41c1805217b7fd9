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
from tetractl.core.errors import WrongValueError
from tetractl.core.plan import Limits, Outcome, Plan, Problem, Search, StopReason
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.protocols import LabSupervision, Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.controller import ControllerSection, Host, OptimizerSection
from tetractl.model.obstacles import Obstacles
from tetractl.plant.sim_section import SimSection
from tetractl.run.checked_controller import CheckedController
from tetractl.testing.finding import SEED, Finding, Findings, near, random_watched, same, true

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
        self.first = setup.starts.array()  # the poses first observed
        self.wrong, self.wrapped = "", False  # a decision that is refused; whether `wrap` is used
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
        host = Host(self._wrap, lambda: next(timer))
        controller = CheckedController(section, setup, SEED, host)
        plant.open()
        command, earlier = None, list[Observation]()
        for k in range(STEPS_MAX + 2):
            seen = plant.observe()
            self.first = seen.poses.array() if k == 0 else self.first
            try:
                decision = controller.plan(seen, command, earlier)
            except WrongValueError as error:
                self.wrong = error.what
                return
            self.decisions.append(decision)
            if not isinstance(decision, Plan):
                return
            command = plant.send(decision.action)
            clock.sleep_until(round((k + 1) * section.period * SECOND))
            earlier = [sample.observation for sample in plant.samples()][:-1]

    def _wrap(self, optimizer: OptimizerSection) -> Optimizer:
        self.wrapped = True
        return optimizer

    def _called(self, frame: Any, event: str, called: Any) -> None:
        """Note each call of a clock by the section's package."""
        module = frame.f_globals.get("__name__", "")  # code that was generated has none
        if event == "c_call" and module.partition(".")[0] == self._package:
            clock = called.__name__.removesuffix("_ns") in CLOCKS
            if clock and "time" in repr(called.__self__):
                self.clocks.add(f"line {frame.f_lineno} calls {called.__name__}")


def check_controller(section: ControllerSection, setup: Setup) -> Findings:
    """Check a controller's plans and its end, and that the key alone determines its decisions."""
    if any(section.contradictions(setup)):
        setup = setup.only([0])  # some controllers steer one robot
    limit_s = (STEPS_MAX + 1) * section.period
    section = section.model_copy(update={"time_limit": limit_s, "arrival_tolerance": 20.0})
    setup = replace(setup, period_s=section.period, time_limit_s=limit_s)
    section.warm_up(setup)
    with random_watched() as used:
        play, again = Play(section, setup), Play(section, setup)
    plans, decisions, robots = play.plans, play.decisions, len(setup.names)
    yield Finding("plan: a Plan, an Outcome or an End that can be sent and logged", play.wrong)
    if play.wrong:
        return
    yield true("plan: path is finite", [np.isfinite(one.path).all() for one in plans])
    inside = [np.abs(one.signals).max(initial=0.0) <= math.pi + 1e-12 for one in plans]
    yield true("plan: signals from -pi to pi", inside)
    yield true("plan: signals of the chosen search", [_chosen(one) for one in plans])
    consistent = [_consistent(search) for one in plans for search in one.searches]
    yield true("searches: signals, history and cost fit together", consistent)
    if plans:
        path, size = plans[0].path, max(plans[0].target_cost, 1e-9)
        yield near("plan: path from the observed poses", path[0], play.first, 1.0)
        ends = np.hypot(*(path[-1, :, :2] - setup.targets).T).sum()
        yield near("plan: target_cost of the path's end", plans[0].target_cost, ends, size)
    off = [section.switches_field or not isinstance(one.instead, FieldOff) for one in plans]
    yield true("plan: FieldOff only with switches_field", off)
    in_time = len(plans) < len(decisions) and len(plans) <= STEPS_MAX + 1
    if len(plans) == STEPS_MAX + 1:
        in_time &= decisions[-1] is Outcome.TIME_LIMIT
    yield true("time_limit: ends the trial", in_time)
    for share, arrived in ((0.95, True), (1.05, False)):
        off = np.array([share * section.arrival_tolerance, 0.0])
        there = Poses.of(np.column_stack([setup.targets + off, np.ones(robots)]))
        seen = Observation(0, 0, 0, there, np.ones(robots, dtype=np.bool_))
        ended = section.build(setup, SEED).plan(seen) is Outcome.ARRIVED
        what = "ends the trial" if arrived else "a robot further off has not arrived"
        yield true(f"arrival_tolerance: {what}", ended == arrived)
    searches = any(isinstance(one, OptimizerSection) for _, one in section)
    yield true("wrap: gets the optimiser", play.wrapped or not searches)
    yield same("key: same key, same decisions", play.numbers, again.numbers)
    yield Finding("random numbers: from the key", " and ".join(used))
    yield Finding("clock: only timer", ", ".join(sorted(play.clocks)))


def _chosen(plan: Plan) -> bool:
    return np.array_equal(plan.signals, plan.search.signals)


def _consistent(search: Search) -> bool:
    """Return whether the record of a search agrees with itself."""
    history = np.asarray(search.history)
    return (
        bool(np.isfinite(history).all() and np.all(np.diff(history) <= 0))
        and bool(search.cost == history[-1] >= 0)
        and isinstance(search.stopped, StopReason)
        and search.evaluations >= 1
        and len(search.signals) == search.length
    )


def _numbers(plan: Plan) -> Floats:
    costs = [plan.cost, plan.target_cost, plan.obstacle_cost, plan.generator]
    return np.concatenate([plan.signals, plan.path.ravel(), costs])
