"""A trial that a script steps: it asks for a direction in place of a controller.

The trial is that of the controller `sequence` with the directions sent so far: the same plant, the
same random draws, the same end. So what a script does is logged, verified and compared as any
trial: `save` runs the same directions by `sequence`, and checks that the result is the same.

Threads. The trial runs in a thread of its own. That thread and the script's take turns: the trial
waits in `plan` while the script decides, the script waits in `step` while the trial runs. What one
hands to the other goes through a queue; they share nothing else.
"""

import math
import threading
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from tetractl.control.methods.sequence import SequenceController, SequenceSection
from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError, UsageError, demand, whole_number
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.protocols import LabSupervision, Observer
from tetractl.core.setup import Setup
from tetractl.core.trial import EPOCH_NS, PlantInfo, Result
from tetractl.run import spec_trial
from tetractl.run.control_loop import Trial
from tetractl.run.folder_lock import make_folder
from tetractl.run.interrupt import Interrupt
from tetractl.spec.controller import ControllerSection
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec, start_of, with_controller, with_seed

SIMULATED = PlantInfo("", True, 0.0, {})
"""What is known of the plant before it is open."""
FIRST_SENT = 0.0
"""A direction of the section of `sequence`, which needs one; the script's take its place [rad]."""


def directed_spec(spec: LoadedSpec) -> LoadedSpec:
    """Return a spec with the controller `sequence`, whose directions are given as it runs.

    Period, dead time, limit of time and `arrival_tolerance` are those of the spec's controller.
    Raises SpecError for what `sequence` cannot do, such as a hold.
    """
    experiment = spec.experiment
    if experiment.chosen is not None:
        raise UsageError("each trial of the spec finds its robots, which no script can step")
    control = experiment.controller
    section = SequenceSection(
        period=control.period,
        dead_time=control.dead_time,
        time_limit=control.time_limit,
        arrival_tolerance=control.arrival_tolerance,
        directions=(FIRST_SENT,),
    )
    return parse_spec(with_controller(spec, section).text, spec.name)


class TruthWatch(Observer):
    """An observer of the true paths: whether a robot entered an obstacle or left the arena, as far
    as camera frames show it. The trial's result knows it from the finest samples.

    A `PathCheck` of the same frames would find distances too, which are not read at each step, and
    take three to six times as long.
    """

    def __init__(self, setup: Setup) -> None:
        self._arena = setup.arena
        self._obstacles = Obstacles.of(setup.obstacles)
        self._last: Poses | None = None
        self.failed = False
        """Whether any robot did so."""

    def on_samples(self, samples: list[Sample]) -> None:
        """Look at the true poses of new frames, and at the straight ways to them."""
        poses = [sample.truth for sample in samples if sample.truth is not None]
        if not poses:
            return
        before = [poses[0] if self._last is None else self._last, *poses[:-1]]
        self._last = poses[-1]
        x = np.array([pose.x for pose in poses])
        y = np.array([pose.y for pose in poses])
        x_before = np.array([pose.x for pose in before])
        y_before = np.array([pose.y for pose in before])
        outside = self._arena.inside(x, y) < 0
        entered = self._obstacles.cross(x_before, y_before, x, y)
        self.failed = self.failed or bool(outside.any() or entered.any())


class DroppedError(BaseException):
    """The script has dropped the trial: its result is not wanted."""


class AskingController:
    """The controller of a stepped trial: in `plan`, its thread waits for the script's decision.

    The trial ends where `sequence` ends it: on arrival, at the limit of time, by an error.
    """

    def __init__(self, sequence: SequenceController) -> None:
        self._sequence = sequence
        self.asked = SimpleQueue[Observation | Result | BaseException]()
        """Of which frame a decision is wanted; at last how the trial has ended."""
        self.answers = SimpleQueue[Plan | Outcome | None]()
        """The decisions, None if the trial is dropped."""

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome:
        """Return what the script decides, unless the trial is over."""
        state = self._sequence.step(observation, last_command)
        if isinstance(state, Outcome):
            return state
        self.asked.put(observation)
        answer = self.answers.get()
        if answer is None:
            raise DroppedError
        return answer

    def run(self, trial: Trial) -> None:
        """Run the trial that this is the controller of, and hand its end to the script."""
        try:
            self.asked.put(trial.run())
        except BaseException as error:  # the script raises it
            self.asked.put(error)


def drop(answers: SimpleQueue[Plan | Outcome | None], thread: threading.Thread) -> None:
    """Let the trial end that waits for an answer, and wait until it has."""
    answers.put(None)
    thread.join()


class OpenTrial:
    """A simulated trial that waits for a direction at each control step.

    Call `step` until `result` is there, or end the trial by `stop`; then `save` writes its log. A
    trial runs once: open another for the next. A trial that is dropped ends like one that is
    stopped, without a result.
    """

    def __init__(self, spec: LoadedSpec, trial: int, seed: int) -> None:
        experiment = spec.experiment
        section: ControllerSection = experiment.controller
        assert isinstance(section, SequenceSection), "a spec by `directed_spec`"
        self._spec = spec
        self._trial = whole_number(trial, "a trial")
        self._seed = whole_number(seed, "a seed")
        self._directions: list[float] = []
        self._truth = TruthWatch(experiment.setup)
        key, plant_seed = spec_trial.trial_seeds(self._seed, self._trial)
        self._controller = AskingController(SequenceController(section, experiment.setup, key))
        clock = experiment.plant.clock()
        ready = Trial(
            start=replace(start_of(spec, self._trial, SIMULATED, EPOCH_NS), seed=self._seed),
            plant=experiment.plant.build(experiment.setup, clock, plant_seed, LabSupervision()),
            controller=self._controller,
            clock=clock,
            observers=[self._truth],
            interrupt=Interrupt(),
        )
        thread = threading.Thread(target=self._controller.run, args=(ready,), daemon=True)
        self._drop = weakref.finalize(self, drop, self._controller.answers, thread)
        self._result: Result | None = None
        self._observation: Observation
        thread.start()
        self._wait()

    @property
    def setup(self) -> Setup:
        """The constants of the experiment: names, targets, arena, obstacles, units."""
        return self._spec.experiment.setup

    @property
    def observation(self) -> Observation:
        """The newest camera frame; its poses are measured, and cannot be written."""
        return self._observation

    @property
    def directions(self) -> tuple[float, ...]:
        """The directions sent so far [rad]."""
        return tuple(self._directions)

    @property
    def last_direction(self) -> float | None:
        """The direction sent last [rad], None before the first."""
        return self._directions[-1] if self._directions else None

    @property
    def result(self) -> Result | None:
        """How the trial ended, None as long as it waits for a direction."""
        return self._result

    @property
    def failed(self) -> bool:
        """Whether a robot has truly entered an obstacle or left the arena so far."""
        if self._result is None:
            return self._truth.failed
        verdict = self._result.verdict
        return any(verdict.entered) or any(edge < 0 for edge in verdict.edge)

    def step(self, direction: float) -> Observation:
        """Send a direction [rad] for one control period, and return the next observation.

        After the last step that is the observation before it. Raises UsageError for a direction
        that is not finite and for a trial that has ended; neither counts as sent.
        """
        self._demand_open()
        try:
            direction = float(direction)
        except (TypeError, ValueError):
            direction = math.nan
        if not math.isfinite(direction):
            raise UsageError("a direction is a finite number of radians")
        self._directions.append(direction)
        self._controller.answers.put(self._plan(direction))
        self._wait()
        return self.observation

    def stop(self) -> Result:
        """End the trial after the directions sent so far, and return the result.

        Raises UsageError for a trial that has ended, and before the first direction.
        """
        self._demand_open()
        if not self._directions:
            raise UsageError("a trial has at least one direction", "step it before it is stopped")
        self._controller.answers.put(Outcome.SEQUENCE_COMPLETED)
        self._wait()
        assert self._result is not None
        return self._result

    @property
    def spec(self) -> LoadedSpec:
        """The spec of this trial with the directions sent so far, which `tetractl run` takes."""
        if not self._directions:
            raise UsageError("no direction was sent", "step the trial first")
        section = self._spec.experiment.controller
        with_directions = section.model_copy(update={"directions": self.directions})
        return with_seed(with_controller(self._spec, with_directions), self._seed)

    def save(self, folder: str | Path) -> Path:
        """Write the log of the trial to a folder and return its path.

        Raises UsageError for a trial that has not ended and for a log that exists already.
        """
        if self._result is None:
            raise UsageError("the trial has not ended", "step it until it has a result, or stop it")
        demand(folder, str | Path, "a folder is a path")
        path = spec_trial.log_path(Path(folder), self._trial)
        if path.exists():
            raise UsageError(f"{path}: exists already", "name another folder")
        make_folder(Path(folder))
        logged = spec_trial.run_logged(self.spec, Path(folder), self._trial)
        if _outcome_of(logged) != _outcome_of(self._result):
            raise TetractlError(f"{path}: the repeated trial ended otherwise than the stepped one")
        return path

    def _demand_open(self) -> None:
        """Raise UsageError if the trial has ended."""
        if not self._drop.alive:
            raise UsageError("the trial was broken off", "open another trial")
        if self._result is not None:
            outcome = self._result.outcome.value
            raise UsageError(f"the trial has ended: {outcome}", "open another trial")

    def _plan(self, direction: float) -> Plan:
        """Return the plan of one direction, without the prediction that the log of `save` has."""
        unknown = np.empty((0, len(self.setup.names), 3))
        return Plan(
            signals=np.array([direction]),
            path=unknown,
            cost=math.nan,
            target_cost=math.nan,
            obstacle_cost=math.nan,
            searches=(),
            chosen=0,
            generator=0,
        )

    def _wait(self) -> None:
        """Wait until the trial asks for the next decision or has ended. What breaks the wait off,
        such as Ctrl-C, ends the trial without a result."""
        try:
            said = self._controller.asked.get()
            if isinstance(said, BaseException):
                raise said
        except BaseException:
            self._drop()
            raise
        if isinstance(said, Observation):
            self._observation = said
            return
        # virtual time stands still while a script thinks: it is never late
        self._result = replace(said, solve_ns=(0,) * said.steps, deadline_misses=0)


def _outcome_of(result: Result) -> tuple[object, ...]:
    """Return what two runs of one trial have in common."""
    return result.outcome, result.steps, result.duration_s, result.robot_errors
