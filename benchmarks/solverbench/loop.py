"""(c) closed loop, and the time of its steps."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tetractl.core.commands import Command
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.protocols import Controller, Plant
from tetractl.core.trial import Result
from tetractl.experiment.experiment import Experiment
from tetractl.run.checked_controller import build_controller

from . import shooting
from .peers import available
from .problems import (
    LENGTH,
    OURS,
    PAPER,
    experiment,
    played,
    recommended,
)
from .report import Report, Settings, load, progress, spread

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
    """Final error and step times on the undisturbed continuous plant."""
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
        rows.append([*_errors(name, batch.results), *_times(batch)])
    report.say(
        f"{settings.trials} trials, continuous plant, nothing disturbed; times of steps are p50 / "
        f"p99 / max. {load()}."
    )
    report.table([*HEAD, *TIMES], rows)
    return report


def replace_control(spec: Experiment, **fields: object) -> Experiment:
    return spec.model_copy(update={"controller": spec.controller.model_copy(update=fields)})
