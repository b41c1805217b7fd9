"""(c) closed loop and the time of whole control steps."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.plan import End, Limits, Outcome, Plan, Problem
from tetractl.core.poses import Observation
from tetractl.core.protocols import Controller, Plant
from tetractl.core.trial import Result
from tetractl.experiment.experiment import Experiment
from tetractl.run.checked_controller import build_controller

from . import shooting
from .peers import available
from .problems import (
    ITERATIONS,
    LENGTH,
    LONGEST,
    OURS,
    PAPER,
    PARTICLES,
    SWARM,
    experiment,
    played,
    printed,
    recommended,
)
from .report import Report, Settings, load, progress, spread

FRAME_MS = 8.33
Times = Sequence[float] | np.ndarray


@dataclass(slots=True)
class Batch:
    """The results of some trials, and the processor time of each plan, by trial [s]."""

    results: list[Result] = field(default_factory=list)
    processor: list[list[float]] = field(default_factory=list)

    def later(self) -> tuple[np.ndarray, np.ndarray]:
        """Times of all plans but the first [s], by the clock and by the processor."""
        clock = np.concatenate([r.solve_ns[1:] for r in self.results]) / 1e9
        return clock, np.concatenate([times[1:] for times in self.processor])


@dataclass(slots=True)
class _Timed:
    """A controller whose plans' processor time is noted."""

    controller: Controller
    times: list[float]

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        begin = time.thread_time()
        decision = self.controller.plan(observation, last_command, earlier)
        self.times.append(time.thread_time() - begin)
        return decision


def _clocked(times: list[float], spec: Experiment, key: int, plant: Plant) -> Controller:
    return _Timed(build_controller(spec, key), times)


def run(experiment: Experiment, trials: int) -> Batch:
    """Run trials in virtual time without any log."""
    batch = Batch()
    for trial in range(trials):
        times: list[float] = []
        batch.processor.append(times)
        clocked = partial(_clocked, times)
        batch.results.append(played(experiment, trial, clocked)[0])
    return batch


HEAD = ["controller", "total error [mm], mean +- std", "worst [mm]", "entered obstacle"]
TIMES = ["first step [ms], median", "later steps, clock [ms]", "later steps, processor [ms]"]


def _errors(name: str, results: list[Result]) -> list[str]:
    errors = np.array([r.total_error for r in results])
    std = errors.std(ddof=1) if len(errors) > 1 else 0.0
    entered = sum(r.entered_obstacle for r in results)
    mean = f"{errors.mean():.4g} +- {std:.3g}"
    return [name, mean, f"{errors.max():.4g}", f"{entered} of {len(results)}"]


def _times(batch: Batch) -> list[str]:
    first = np.median([r.solve_ns[0] for r in batch.results]) / 1e6
    return [f"{first:.1f}", *map(spread, batch.later())]


def closed(settings: Settings) -> Report:
    """Final error and step times on the undisturbed continuous plant; budgets of a step."""
    report = Report("(c) Closed loop and control step")
    ours = experiment(OURS)
    contestants = [("paper, as published", experiment(PAPER)), ("**ours**", ours)]
    if available(shooting.PACKAGE):
        from tetractl_ipopt import Ipopt

        progress("(c) building the programmes of IPOPT")
        shooting.build_all(recommended(), LENGTH - 2 if settings.quick else 1)
        at_5hz = experiment(OURS, "controller.period=0.2")  # s: a signal a step
        ipopt = shooting.shrinking(at_5hz, Ipopt(type="ipopt"))
        if settings.quick:
            ipopt = replace_control(ipopt, time_limit=0.5)  # s: three steps
        contestants.append((f"CasADi + IPOPT, {LENGTH} signals, warm-started", ipopt))
    else:
        report.say("IPOPT: benchmarks/tetractl-ipopt is not installed: skipped.")
    rows = []
    for name, spec in contestants:
        progress(f"(c) closed loop: {name}")
        run(replace_control(spec, time_limit=0.1), 1)  # warm up
        batch = run(spec, settings.trials)
        results = batch.results
        rows.append([*_errors(name, results), *_times(batch)])
        if "ours" in name:
            mean = np.mean([r.total_error for r in results])
            entered = sum(r.entered_obstacle for r in results)
            figure = "closed loop, continuous plant, undisturbed: mean total error"
            text = f"{mean:.2g} mm, {entered} of {len(results)} entered"
            report.bar(figure, "<= 1 mm, none entered", text, mean <= 1 and not entered)
            figure = "closed loop: control step of the default controller, p99"
            _frame(report, figure, *batch.later())
    report.say(
        f"{settings.trials} trials, continuous plant, nothing disturbed; times of steps are p50 / "
        f"p99 / max. {load()}."
    )
    report.table([*HEAD, *TIMES], rows)
    _budgets(report, settings)
    return report


def replace_control(spec: Experiment, **fields: object) -> Experiment:
    return spec.model_copy(update={"controller": spec.controller.model_copy(update=fields)})


def _budgets(report: Report, settings: Settings) -> None:
    """Whole control steps and whole sweeps of the compiled swarm, with the budget fully spent."""
    rows = []
    euler = printed()
    count = settings.repeats * 5
    models = [("Euler", euler), ("exact", replace(euler, motion="exact"))]
    models.append(("exact, swept, walls", recommended()))
    for name, problem in models:
        step = _timed(partial(_control_step, problem), count)
        sweep = _timed(partial(_sweep, problem), max(2, settings.repeats // 4))
        rows.append([name, *map(spread, step), *map(spread, sweep)])  # wall, then processor time
        if name == "Euler":
            middle = np.median(sweep[0]) * 1e3
            figure = "whole control step, 3 lengths x 100 iterations x 128 particles, p99"
            _frame(report, figure, *step)
            figure = f"step-0 sweep of lengths 1 to {LONGEST}, 100 iterations each, median"
            report.bar(figure, "<= 100 ms", f"{middle:.1f} ms", middle <= 100)
    report.say(
        f"**Times of the compiled swarm with every evaluation of its budget**: a control "
        f"step searches {LENGTH - 1}, {LENGTH} and {LENGTH + 1} signals with {ITERATIONS} "
        f"iterations x {PARTICLES} particles each, a sweep all lengths from "
        f"1 to {LONGEST}; one thread, p50 / p99 / max in ms, by the clock and by the "
        f"processor time of the thread. {load()}."
    )
    clocks = ["step, clock", "step, processor", "sweep, clock", "sweep, processor"]
    report.table(["model", *clocks], rows)


def _frame(report: Report, figure: str, clock: Times, processor: Times) -> None:
    """Note whether the p99 of some steps, by the clock, fits into a frame of the camera."""
    p99 = np.quantile(clock, 0.99) * 1e3
    used = np.quantile(processor, 0.99) * 1e3
    text = f"{p99:.2f} ms by the clock, {used:.2f} ms of processor time"
    report.bar(figure, f"<= {FRAME_MS} ms", text, p99 <= FRAME_MS)


def _timed(work: Callable[[int], None], count: int) -> tuple[list[float], list[float]]:
    """Times by the clock and by the thread's processor time [s]."""
    work(0)
    wall = []
    used = []
    for i in range(count):
        begin = time.perf_counter()
        used_before = time.thread_time()
        work(i)
        wall.append(time.perf_counter() - begin)
        used.append(time.thread_time() - used_before)
    return wall, used


def _control_step(problem: Problem, key: int) -> None:
    warm = np.zeros(LENGTH)
    for start in (warm[1:], warm, np.append(warm, 0.0)):
        SWARM.search(problem, len(start), start, key, Limits())


def _sweep(problem: Problem, key: int) -> None:
    for length in range(1, LONGEST + 1):
        SWARM.search(problem, length, None, key, Limits())
