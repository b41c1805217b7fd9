"""Checks of a controller: its decisions in short undisturbed simulations."""

import sys
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.protocols import LabSupervision, Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.controller import ControllerSection, OptimizerSection
from tetractl.kind_checks.finding import SEED, Finding, Findings, random_watched, same, true
from tetractl.plant.simulation import SimSection

STEPS_MAX = 3
CLOCKS = {"time", "perf_counter", "monotonic", "process_time", "now", "utcnow", "today"}


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

    @property
    def plans(self) -> list[Plan]:
        """The decisions that do not end the trial."""
        return [one for one in self.decisions if isinstance(one, Plan)]

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
            command = plant.pause() if decision.pauses else plant.steer(decision.direction)
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
        play = Play(section, setup)
    with random_watched():
        again = Play(section, setup)
    odd = [repr(one) for one in play.decisions if not isinstance(one, Plan | Outcome | End)]
    yield Finding("plan: returns a Plan, an Outcome or an End", ", ".join(odd))
    if odd:
        return
    plans, robots = play.plans, len(setup.names)
    yield true(
        "plan: at least one signal; a path (signals + 1, robots, 3)",
        [one.signals.size and one.path.shape == (one.signals.size + 1, robots, 3) for one in plans],
        "not so",
    )
    finite = [bool(np.isfinite(_numbers(one)).all()) for one in plans]
    yield true("plan: signals, path and costs are finite", finite, "one is not")
    chosen = [np.array_equal(one.signals, one.search.signals) for one in plans]
    yield true("plan: signals of the chosen search", chosen, "they differ")
    off = any(one.field_off for one in plans) and not section.switches_field
    yield Finding("plan: field_off only with switches_field", "a plan switches it off" * off)
    late = len(plans) == len(play.decisions) or len(plans) > STEPS_MAX + 1
    yield Finding("steps_max: ends the trial", "it goes on" * late)
    there = Poses.of(np.column_stack([setup.targets, np.zeros(robots)]))
    seen = Observation(0, 0, 0, there, np.ones(robots, dtype=np.bool_))
    late = isinstance(section.build(setup, SEED).plan(seen), Plan)
    yield Finding("arrival_tolerance: ends the trial", "it goes on" * late)
    yield Finding("observation: not changed", "it is changed" * play.changed)
    searches = any(isinstance(one, OptimizerSection) for _, one in section)
    yield Finding("wrap: gets the optimiser", "it does not" * (searches and not play.wrapped))
    pair = ([_numbers(one) for one in each.plans] for each in (play, again))
    yield same("key: same key, same decisions", *pair)
    yield Finding("random numbers: from the key", f"uses {' and '.join(used)}" if used else "")
    yield Finding("clock: only timer", ", ".join(sorted(play.clocks)))


def _numbers(plan: Plan) -> Floats:
    costs = [plan.cost, plan.target_cost, plan.obstacle_cost, plan.generator]
    return np.concatenate([plan.signals, plan.path.ravel(), costs])
