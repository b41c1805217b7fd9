"""A trial that a person steers: its controller asks for a direction in place of a search.

The trial is that of the controller `sequence` with the directions given, and so is its log. But a
log begins with its spec, whose directions are known when the trial has ended, and each logged plan
holds the directions that came later. So the trial is logged twice:

    LogWriter        while the robots drive, as any trial, each plan being the direction held: what
                     a crash leaves, as NAME.part
    HandLog          when they stand, in its place: the log of `sequence`, as NAME

    HandController   asks for the direction of each step, and keeps it with the step's problem
    WallPace         lets a simulation take as long as people need to steer it
    AtEnd            tells the person at once how the trial ended, before its log is written
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tetractl.control.methods.fixed_sequence import given_plan
from tetractl.control.methods.plain import PlainController
from tetractl.control.methods.sequence import SequenceSection
from tetractl.control.search.rng import mix
from tetractl.core.clock import Clock
from tetractl.core.commands import Command
from tetractl.core.plan import Outcome, Plan, Problem
from tetractl.core.poses import Observation
from tetractl.core.protocols import LabSupervision, Observer
from tetractl.core.trial import Result, Start, Step
from tetractl.log.write.sink import TRIAL_PART
from tetractl.log.write.writer import LogWriter
from tetractl.run.folder_lock import make_folder
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import log_path, ready_trial, trial_seeds
from tetractl.spec.loaded_spec import LoadedSpec, start_of, with_controller
from tetractl.tools.worker import Relay

SAVING = ".saving"
"""Suffix of a finished log while it is written: until then, the log so far is the only one."""

Ask = Callable[[float], float | None]
"""Returns the direction [rad] of a step, or None to stop, by the step's time from the first [s]."""
Pause = Callable[[Callable[[float], Plan]], None]
"""Called before each step with what plans a direction [rad]; returns once the person goes on."""


def go_on(plan_of: Callable[[float], Plan]) -> None:
    """Do not pause."""


class HandController(PlainController):
    """The controller of one trial of a spec by `directed_spec`; `directions` are those sent so far
    [rad].

    A plan while the robots drive shows where they go if the direction is held.
    """

    def __init__(self, spec: LoadedSpec, trial: int, ask: Ask, pause: Pause = go_on) -> None:
        self.trial = trial
        experiment = spec.experiment
        section = experiment.controller
        assert isinstance(section, SequenceSection), "a spec by `directed_spec`"
        key, _ = trial_seeds(experiment.trials.seed, trial)
        super().__init__(section, experiment.setup, key)
        self.directions: list[float] = []
        self._section = section
        self._ask = ask
        self._pause = pause
        self._problems: list[Problem] = []

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Plan | Outcome:
        """Return the plan of the direction that the person wants, or the end of the trial."""

        def plan_of(direction: float) -> Plan:
            return given_plan(problem, np.full(self._section.ahead, direction), step_key)

        self._pause(plan_of)
        direction = self._ask(self.k * self._section.period)
        if direction is None:
            return Outcome.SEQUENCE_COMPLETED
        self.directions.append(direction)
        self._problems.append(problem)
        return plan_of(direction)

    @property
    def given(self) -> SequenceSection:
        """The section of `sequence` with the directions sent so far, at least one."""
        return self._section.model_copy(update={"directions": tuple(self.directions)})

    def plan_of_sequence(self, k: int) -> Plan:
        """Return the plan of step `k` by `sequence`, which knows the directions that follow."""
        signals = np.array(self.directions[k : k + self._section.ahead])
        return given_plan(self._problems[k], signals, mix(self.key, k))


class HandLog(Relay):
    """Keeps the records of a trial, in memory, until the trial has ended and `save` writes them."""

    def __init__(self, controller: HandController) -> None:
        self._controller = controller
        self._calls: list[Callable[[Observer], object]] = []
        self._start: Start

    def on_start(self, start: Start) -> None:
        """Keep the start."""
        self._start = start

    def put(self, call: Callable[[Observer], object]) -> None:
        """Keep a call of the log that there will be."""
        self._calls.append(call)

    def on_step(self, step: Step) -> None:
        """Keep a step; its plan will be that of `sequence`."""

        def write(log: Observer) -> None:
            plan = self._controller.plan_of_sequence(step.k)
            log.on_step(replace(step, plan=plan))

        self.put(write)

    def save(self, spec: LoadedSpec, path: Path) -> None:
        """Write the log; `spec` is that of the trial."""
        with_directions = with_controller(spec, self._controller.given)
        start = start_of(
            with_directions, self._start.trial, self._start.plant, self._start.start_unix_ns
        )
        try:
            with LogWriter(path, part=SAVING) as log:
                log.on_start(start)
                for call in self._calls:
                    call(log)
        finally:
            path.with_name(path.name + SAVING).unlink(missing_ok=True)


def run_by_hand(
    spec: LoadedSpec,
    folder: Path,
    controller: HandController,
    observers: Sequence[Observer] = (),
    interrupt: Interrupt | None = None,
    supervision: LabSupervision | None = None,
) -> Result:
    """Run the controller's trial of a spec by `directed_spec`, and write its log to `folder`; no
    log if no direction was given."""
    make_folder(folder)
    path = log_path(folder, controller.trial)
    hand_log = HandLog(controller)
    first = LogWriter(path, real_time=spec.experiment.plant.real_time, keeps_part=True)
    with (
        first as log,
        ready_trial(
            [log, hand_log],
            spec,
            controller.trial,
            observers,
            interrupt or Interrupt(),
            supervision,
            controller,
        ) as ready,
    ):
        result = ready.run()
    if controller.directions:
        hand_log.save(spec, path)
    path.with_name(path.name + TRIAL_PART).unlink()  # last: a crash leaves one log at least
    if not controller.directions:
        folder.rmdir()
    return result


class WallPace(Observer):
    """Slows trials in virtual time down, so that people can follow them.

    A delay is not caught up.

    Args:
        wall: The clock on the wall.
        speed: Seconds of the trial per second of the clock.
    """

    def __init__(self, wall: Clock, speed: float) -> None:
        self._wall = wall
        self._speed = speed
        self._due_ns = 0
        self._sent_ns: int | None = None

    def on_start(self, start: Start) -> None:
        """Begin a trial: its first command is due at once."""
        self._sent_ns = None

    def on_step(self, step: Step) -> None:
        """Wait until the command of a step is due."""
        now_ns = self._wall.now()
        sent_ns = step.command.sent_ns
        if self._sent_ns is None:
            self._due_ns = now_ns
        else:
            self._due_ns += round((sent_ns - self._sent_ns) / self._speed)
        self._sent_ns = sent_ns
        self._due_ns = max(self._due_ns, now_ns)
        self._wall.sleep_until(self._due_ns)


class AtEnd(Observer):
    """Calls `tell` with the result as soon as a trial has ended, before its log is whole."""

    def __init__(self, tell: Callable[[Result], None]) -> None:
        self._tell = tell

    def on_stop(self, stop: Command, result: Result) -> None:
        """Tell the result."""
        self._tell(result)
