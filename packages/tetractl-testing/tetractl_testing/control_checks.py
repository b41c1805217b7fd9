"""Checks of an optimiser and of a controller.

An optimiser's searches must be consistent, bounded and repeatable. A controller's decisions are
checked in short undisturbed simulations.
"""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import date, datetime
from itertools import count
from types import FrameType
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import FieldOff
from tetractl.core.errors import WrongValueError
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Limits, Outcome, Plan, Problem, Search, StopReason
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.protocols import LabSupervision, Optimizer
from tetractl.core.setup import Setup
from tetractl.plant.sim_section import SimSection
from tetractl.run.checked_controller import CheckedController
from tetractl.spec.controller import ControllerSection, Host, OptimizerSection
from tetractl_testing.expect import (
    SEED,
    expect,
    expect_near,
    expect_same,
    expect_true,
    random_watched,
)

STEPS_MAX = 3
"""Number of control periods of a simulation before its time limit."""
LENGTHS = (1, 12)
"""Numbers of signals in the checked searches. Each is searched without and with a warm start."""
EXTRA_EVALUATIONS = 5
"""Number of evaluations by which a search's budget exceeds the minimum."""
SIGNAL_MAX = math.pi + 1e-12
"""Maximum magnitude of a signal, with rounding [rad]."""
CLOCKS = frozenset(
    {
        time.time,
        time.time_ns,
        time.perf_counter,
        time.perf_counter_ns,
        time.monotonic,
        time.monotonic_ns,
        time.process_time,
        time.process_time_ns,
        datetime.now,
        datetime.utcnow,
        datetime.today,
        date.today,
    }
)
"""Functions that read a clock, which a controller must not call."""


def check_optimizer(optimizer: OptimizerSection, setup: Setup) -> None:
    """Check that an optimiser's search records are consistent, and that its searches repeat.

    Each length in LENGTHS is searched with and without a warm start.
    """
    problem = Problem(
        poses=setup.starts, targets=setup.targets, a=setup.a, speed=setup.speed, motion="exact",
        period=0.2, first_period=0.2, obstacles=Obstacles.from_shapes(setup.obstacles),
        obstacle_weight=1000.0, swept=True,
    )  # fmt: skip
    rng = np.random.default_rng(SEED)
    for length in LENGTHS:
        warm = rng.uniform(-math.pi, math.pi, length)
        _check_search(optimizer, problem, length, None)
        _check_search(optimizer, problem, length, warm)


def _check_search(
    optimizer: OptimizerSection, problem: Problem, length: int, warm_start: Floats | None
) -> None:
    """Check the search for `length` signals.

    With `warm_start`, the search begins from these signals, shape (length,).
    """
    from tetractl.control.search.evaluate import compiled_costs

    prefix = f"{length} signals: "
    start_before = None if warm_start is None else warm_start.copy()
    search = optimizer.search(problem, length, warm_start, SEED, Limits())
    repeated_search = optimizer.search(problem, length, warm_start, SEED, Limits())
    if warm_start is not None:
        prefix = f"{length} signals, warm start: "
        expect_same(f"{prefix}not changed", [warm_start], [start_before])
    shape = np.shape(search.signals)
    if shape != (length,):
        expect(f"{prefix}signals", f"have the shape {shape} instead of ({length},)")
        return
    record = (search.signals, search.history, search.evaluations)
    record_again = (repeated_search.signals, repeated_search.history, repeated_search.evaluations)
    expect_same(f"{prefix}the same key gives the same search", record, record_again)
    cost = float(compiled_costs(problem, 1)(search.signals[:, None])[0])
    expect_near(f"{prefix}cost: equals J of signals", search.cost, cost, max(abs(cost), 1e-9))
    expect_near(
        f"{prefix}history: its last value is the cost", search.history[-1], search.cost, 1 + cost
    )
    expect_true(f"{prefix}history: never rises", np.diff(search.history) <= 0, "it rises")
    expect_true(f"{prefix}evaluations: are at least 1", search.evaluations >= 1, "there are none")
    evaluations_max = optimizer.evaluations_max
    if evaluations_max is not None:
        expectation = f"{prefix}evaluations: are at most evaluations_max"
        expect_true(expectation, search.evaluations <= evaluations_max, str(search.evaluations))
    budget = optimizer.evaluations_min + EXTRA_EVALUATIONS
    evaluations = optimizer.search(problem, length, warm_start, SEED, Limits(budget)).evaluations
    expect_true(
        f"{prefix}evaluations: in budget", evaluations <= budget, f"{evaluations} of {budget}"
    )


@dataclass(slots=True)
class SimulatedRun:
    """The decisions of a controller in one simulation.

    Attributes:
        first: The first observed poses, shape (N, 3).
        decisions: The decisions before the first refused one.
        wrong: Why a decision was refused. Empty if no decision was refused.
        wraps: Whether the controller wraps its optimiser.
    """

    first: Floats
    decisions: list[Any] = field(default_factory=list)
    wrong: str = ""
    wraps: bool = False

    @property
    def plans(self) -> list[Plan]:
        """All plans among the decisions of the controller, in the order of time."""
        return [decision for decision in self.decisions if isinstance(decision, Plan)]

    @property
    def numbers(self) -> list[Floats]:
        """All numbers of each plan: signals, path, costs, generator, and further numbers to log."""
        numbers: list[Floats] = []
        for plan in self.plans:
            costs = [plan.cost, plan.target_cost, plan.obstacle_cost, plan.generator]
            logged_numbers = list(plan.numbers.values())
            numbers.append(np.concatenate([plan.signals, plan.path.ravel(), costs, logged_numbers]))
        return numbers


def simulate_run(section: ControllerSection, setup: Setup) -> SimulatedRun:
    """Run a controller in an undisturbed simulation, until it ends or for STEPS_MAX + 2 steps.

    A decision of the wrong kind also ends the run. It is described in the run's `wrong`.
    """
    run = SimulatedRun(first=setup.starts.array())

    def wrap(optimizer: OptimizerSection) -> Optimizer:
        run.wraps = True
        return optimizer

    clock = VirtualClock()
    timer = count(step=SECOND // 1000)
    plant = SimSection().build(setup, clock, np.random.SeedSequence(SEED), LabSupervision())
    controller = CheckedController(section, setup, SEED, Host(wrap, lambda: next(timer)))
    plant.open()
    command = None
    earlier: list[Observation] = []
    for k in range(STEPS_MAX + 2):
        observation = plant.observe()
        if k == 0:
            run.first = observation.poses.array()
        try:
            decision = controller.plan(observation, command, earlier)
        except WrongValueError as error:
            run.wrong = error.what
            break
        run.decisions.append(decision)
        if not isinstance(decision, Plan):
            break
        command = plant.send(decision.action)
        clock.sleep_until(round((k + 1) * section.period * SECOND))
        earlier = [sample.observation for sample in plant.samples()][:-1]
    return run


@contextmanager
def clocks_watched(package: str) -> Iterator[set[str]]:
    """Record which clocks the code of a package reads during a `with` block.

    Calls are recorded by Python's profiler. Replacing `time.time` would not be enough, because code
    that has imported the function earlier would still call the original.

    Args:
        package: Name of the package.

    Yields:
        The calls of CLOCKS so far, such as "line 12 calls time". The set grows during the block.
    """
    calls = set[str]()

    def record_call(frame: FrameType, event: str, called: Any) -> None:
        module = frame.f_globals.get("__name__", "")  # code that was generated has none
        is_in_package = module.partition(".")[0] == package
        if is_in_package and event == "c_call" and called in CLOCKS:
            calls.add(f"line {frame.f_lineno} calls {called.__name__}")

    previous_profiler = sys.getprofile()
    sys.setprofile(record_call)
    try:
        yield calls
    finally:
        sys.setprofile(previous_profiler)


def check_controller(section: ControllerSection, setup: Setup) -> None:
    """Check a controller's plans and its end, and that the key alone determines its decisions.

    If the controller cannot steer all robots of the setup, it is checked with the first one
    only.
    """
    if any(section.contradictions(setup)):
        setup = setup.select_robots([0])  # some controllers steer one robot
    limit_s = (STEPS_MAX + 1) * section.period
    section = section.model_copy(update={"time_limit": limit_s, "arrival_tolerance": 20.0})
    setup = replace(setup, period_s=section.period, time_limit_s=limit_s)
    section.warm_up(setup)
    package = type(section).__module__.partition(".")[0]
    with random_watched() as generators_used, clocks_watched(package) as clock_calls:
        run = simulate_run(section, setup)
        repeated_run = simulate_run(section, setup)
    expect("plan: returns a Plan, an Outcome or an End that can be sent and logged", run.wrong)
    if run.wrong:
        return
    _check_plans(run.plans, section, setup, run.first)
    _check_ends(run, section, setup)
    has_optimizer = any(isinstance(value, OptimizerSection) for _, value in section)
    expect_true("wrap: receives the optimiser", run.wraps or not has_optimizer)
    expect_same("key: the same key gives the same decisions", run.numbers, repeated_run.numbers)
    expect("random numbers: come only from the key", " and ".join(generators_used))
    expect("clock: reads only `timer`", ", ".join(sorted(clock_calls)))


def _check_plans(
    plans: list[Plan], section: ControllerSection, setup: Setup, first_poses: Floats
) -> None:
    """Check each plan, and check that the first plan starts at the poses `first_poses` (N, 3)."""
    are_finite = [np.isfinite(plan.path).all() for plan in plans]
    expect_true("plan: its path is finite", are_finite)
    largest = [np.abs(plan.signals).max(initial=0.0) for plan in plans]
    expect_true("plan: its signals are from -pi to pi", np.array(largest) <= SIGNAL_MAX)
    are_from_search = [np.array_equal(plan.signals, plan.search.signals) for plan in plans]
    expect_true("plan: its signals are those of the chosen search", are_from_search)
    are_consistent = [_consistent(search) for plan in plans for search in plan.searches]
    expect_true("searches: signals, history and cost fit together", are_consistent)
    if plans:
        path = plans[0].path
        cost_scale = max(plans[0].target_cost, 1e-9)
        expect_near("plan: its path starts at the observed poses", path[0], first_poses, 1.0)
        to_targets = path[-1, :, :2] - setup.targets
        distance = np.hypot(to_targets[:, 0], to_targets[:, 1]).sum()
        expect_near(
            "plan: target_cost is the cost of the path's end",
            plans[0].target_cost,
            distance,
            cost_scale,
        )
    are_allowed = [
        section.switches_field or not isinstance(plan.instead, FieldOff) for plan in plans
    ]
    expect_true("plan: is FieldOff only if switches_field is set", are_allowed)


def _check_ends(run: SimulatedRun, section: ControllerSection, setup: Setup) -> None:
    """Check that a trial ends at its time limit, and only when all robots are at their targets.

    A robot is at its target if it is within `arrival_tolerance`.
    """
    n_plans = len(run.plans)
    ends_in_time = n_plans < len(run.decisions) and n_plans <= STEPS_MAX + 1
    if n_plans == STEPS_MAX + 1:
        ends_in_time = ends_in_time and run.decisions[-1] is Outcome.TIME_LIMIT
    expect_true("time_limit: ends the trial", ends_in_time)
    n_robots = len(setup.names)
    for fraction, arrived in ((0.95, True), (1.05, False)):
        aside = np.array([fraction * section.arrival_tolerance, 0.0])
        poses = Poses.from_array(np.column_stack([setup.targets + aside, np.ones(n_robots)]))
        all_seen = np.ones(n_robots, dtype=np.bool_)
        controller = section.build(setup, SEED)
        decision = controller.plan(Observation(0, 0, 0, poses, all_seen))
        has_ended = decision is Outcome.ARRIVED
        expectation = "ends the trial" if arrived else "a robot further off has not arrived"
        expect_true(f"arrival_tolerance: {expectation}", has_ended == arrived)


def _consistent(search: Search) -> bool:
    """Check that the record of a search does not contradict itself.

    The history of costs must be finite, never rise, and end at the cost, which must not be
    negative.
    """
    history = np.asarray(search.history)
    finite = bool(np.isfinite(history).all())
    falls = bool((np.diff(history) <= 0).all())
    return (
        finite
        and falls
        and bool(search.cost == history[-1] >= 0)
        and isinstance(search.stopped, StopReason)
        and search.evaluations >= 1
        and len(search.signals) == search.length
    )
