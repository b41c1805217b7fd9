"""Run a trial that a person steers with the arrow keys. The controller asks for each direction.

The trial is the same as one in which the controller `sequence` sends these directions, and so is
its log. However, a log begins with its spec, and its directions are only known after the trial.
Each logged plan also contains the directions that came later. Therefore the trial is logged twice:

    LogWriter        while the robots drive, as in any trial, with plans that hold the present
                     direction: what remains after a crash, as NAME.part
    HandLog          when they stand still, as the final log: the log of `sequence`, as NAME

    HandController   asks for the direction of each step, and keeps it with the step's problem
    WallPace         slows a simulation down to the time that people need to steer it
    EndNotifier      reports at once how the trial ended, before its log is written
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
from tetractl.log.write.sink import TRIAL_PART_SUFFIX
from tetractl.log.write.writer import LogWriter
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_with_log
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.loaded_spec import LoadedSpec, create_start, with_controller
from tetractl.tools.files import make_folder
from tetractl.tools.worker import Relay

SAVING_SUFFIX = ".saving"
"""Suffix of the final log while it is written. Before, only the log with `.part` exists."""

Ask = Callable[[float], float | None]
"""A function that returns the direction of a step [rad], or None to end the trial.

Its argument is the time since the first step [s].
"""
Pause = Callable[[Callable[[float], Plan]], None]
"""A function that is called before each step, and returns once the person continues.

Its argument is a function that plans a direction [rad].
"""


def never_pause(plan_direction: Callable[[float], Plan]) -> None:
    """Return at once: by default, nobody can pause the trial."""


class HandController(PlainController):
    """The controller of a trial that a person steers, for a spec from `directed_spec`.

    While the robots drive, a plan shows where they go if the direction is held.

    Args:
        spec: The spec.
        trial: Index of the trial.
        ask: Asks the person for a direction.
        pause: Called before each step. It returns at once unless the person pauses the trial.

    Attributes:
        directions: The directions sent so far [rad].
    """

    def __init__(self, spec: LoadedSpec, trial: int, ask: Ask, pause: Pause = never_pause) -> None:
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
        """Ask the person for a direction, and return its plan; see `PlainController.decided`.

        The trial is complete once the person stops it. During a pause, the method waits.
        """

        def plan_direction(direction: float) -> Plan:
            return given_plan(problem, np.full(self._section.ahead, direction), step_key)

        self._pause(plan_direction)
        direction = self._ask(self.k * self._section.period)
        if direction is None:
            return Outcome.SEQUENCE_COMPLETED
        self.directions.append(direction)
        self._problems.append(problem)
        return plan_direction(direction)

    @property
    def section_with_directions(self) -> SequenceSection:
        """The section of the controller `sequence` with the directions sent so far.

        At least one direction must have been sent.
        """
        return self._section.model_copy(update={"directions": tuple(self.directions)})

    def plan_of_sequence(self, k: int) -> Plan:
        """Return the plan that `sequence`, which knows the later directions, makes in step `k`."""
        signals = np.array(self.directions[k : k + self._section.ahead])
        return given_plan(self._problems[k], signals, mix(self.key, k))


class HandLog(Relay):
    """A recorder that keeps a trial in memory, until `save` writes its final log."""

    def __init__(self, controller: HandController) -> None:
        self._controller = controller
        self._calls: list[Callable[[Observer], object]] = []
        self._start: Start

    def on_start(self, start: Start) -> None:
        """Store the start of the trial."""
        self._start = start

    def put(self, call: Callable[[Observer], object]) -> None:
        """Store a call of an observer, which is made when the final log is written."""
        self._calls.append(call)

    def on_step(self, step: Step) -> None:
        """Store a step. In the log, its plan will be the one of `sequence`."""

        def write(log: Observer) -> None:
            plan = self._controller.plan_of_sequence(step.k)
            log.on_step(replace(step, plan=plan))

        self.put(write)

    def save(self, spec: LoadedSpec, path: Path) -> None:
        """Write the final log of a trial that a person has steered.

        Args:
            spec: The spec of the trial, without the directions.
            path: The log. It must not exist.
        """
        final_spec = with_controller(spec, self._controller.section_with_directions)
        start = create_start(
            final_spec, self._start.trial, self._start.plant, self._start.start_unix_ns
        )
        try:
            with LogWriter(path, part_suffix=SAVING_SUFFIX) as log:
                log.on_start(start)
                for call in self._calls:
                    call(log)
        finally:
            path.with_name(path.name + SAVING_SUFFIX).unlink(missing_ok=True)


def run_by_hand(
    spec: LoadedSpec,
    folder: Path,
    controller: HandController,
    observers: Sequence[Observer] = (),
    interrupt: Interrupt | None = None,
    supervision: LabSupervision | None = None,
) -> Result:
    """Run a trial that a person steers, and write its log.

    If no direction was sent, there is no log.

    Args:
        spec: The spec of the trial, from `directed_spec`.
        folder: Where to write the log.
        controller: Asks the person for directions.
        observers: Observers that watch the trial.
        interrupt: Requests to end the trial.
        supervision: How people supervise the run. Only real robots need it.
    """
    make_folder(folder)
    path = log_path(folder, controller.trial)
    hand_log = HandLog(controller)
    with LogWriter(path, real_time=spec.experiment.plant.real_time, keeps_part=True) as log:
        result = run_with_log(
            log,
            spec,
            controller.trial,
            observers,
            interrupt,
            supervision,
            recorders=[hand_log],
            controller=controller,
        )
    if controller.directions:
        hand_log.save(spec, path)
    path.with_name(path.name + TRIAL_PART_SUFFIX).unlink()  # last: a crash leaves one log at least
    if not controller.directions:
        folder.rmdir()
    return result


class WallPace(Observer):
    """An observer that slows trials in virtual time down, so that people can follow them.

    A delay shifts all later steps; the trial does not hurry to make up for it.

    Args:
        wall_clock: The clock of the real world.
        speed: Seconds of the trial per second of the clock.
    """

    def __init__(self, wall_clock: Clock, speed: float) -> None:
        self._wall_clock = wall_clock
        self._speed = speed
        self._due_ns = 0
        self._sent_ns: int | None = None

    def on_start(self, start: Start) -> None:
        """Begin a trial: its first command is due at once."""
        self._sent_ns = None

    def on_step(self, step: Step) -> None:
        """Wait until the command of a step is due at the chosen speed."""
        now_ns = self._wall_clock.now()
        sent_ns = step.command.sent_ns
        if self._sent_ns is None:
            self._due_ns = now_ns
        else:
            self._due_ns += round((sent_ns - self._sent_ns) / self._speed)
        self._sent_ns = sent_ns
        self._due_ns = max(self._due_ns, now_ns)
        self._wall_clock.sleep_until(self._due_ns)


class EndNotifier(Observer):
    """An observer that calls `on_end` with the result as soon as a trial has ended.

    At this time, the log may not be complete yet.
    """

    def __init__(self, on_end: Callable[[Result], None]) -> None:
        self._on_end = on_end

    def on_stop(self, stop: Command, result: Result) -> None:
        """Pass the result to `tell`."""
        self._on_end(result)
