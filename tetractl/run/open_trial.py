"""A simulated trial that a script steers step by step, instead of a controller.

The trial is the same as one in which the controller `sequence` sends these directions: it has the
same plant, the same random numbers and the same end. It can therefore be logged, verified and
compared like any other trial. `save` runs the same directions with `sequence`, and checks that the
result is the same.

Threads: the trial runs in its own thread. That thread and the script's thread take turns. The trial
waits in `plan` while the script decides, and the script waits in `step` while the trial runs. They
pass values to each other through a queue, and share nothing else.
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
from tetractl.core.errors import TetractlError, UsageError, require_type, require_whole_number
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.protocols import LabSupervision, Observer
from tetractl.core.setup import Setup
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Result
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.controller import ControllerSection
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec, create_start, with_controller, with_seed
from tetractl.tools.files import make_folder

UNOPENED_PLANT = PlantInfo("", True, 0.0, {})
"""The description of a plant that is not open yet."""
PLACEHOLDER_DIRECTION = 0.0
"""Direction in the section of `sequence` before the script has sent one [rad].

The section must have at least one direction.
"""


def directed_spec(spec: LoadedSpec) -> LoadedSpec:
    """Return a spec with the controller `sequence`, which receives its directions while it runs.

    The period, dead time, time limit and `arrival_tolerance` come from the spec's controller.

    Raises:
        SpecError: If `sequence` cannot run the spec, for example because of a hold.
    """
    experiment = spec.experiment
    if experiment.chosen is not None:
        raise UsageError(
            "a trial of this spec chooses its robots itself, so a script cannot step it"
        )
    control = experiment.controller
    section = SequenceSection(
        period=control.period,
        dead_time=control.dead_time,
        time_limit=control.time_limit,
        arrival_tolerance=control.arrival_tolerance,
        directions=(PLACEHOLDER_DIRECTION,),
    )
    return parse_spec(with_controller(spec, section).text, spec.name)


class TruthWatch(Observer):
    """An observer that checks whether a robot has truly entered an obstacle or left the arena.

    It checks the true poses at camera frames, while the trial's result is computed from the finest
    samples. A `PathCheck` of the same frames would also compute distances, which no step needs, and
    take three to six times as long.
    """

    def __init__(self, setup: Setup) -> None:
        self._arena = setup.arena
        self._obstacles = Obstacles.from_shapes(setup.obstacles)
        self._last_poses: Poses | None = None
        self.failed = False
        """Whether any robot has truly entered an obstacle or left the arena so far."""

    def on_samples(self, samples: list[Sample]) -> None:
        """Check the true poses of new frames, and the straight lines that lead to them."""
        poses = [sample.truth for sample in samples if sample.truth is not None]
        if not poses:
            return
        previous_poses = [poses[0] if self._last_poses is None else self._last_poses, *poses[:-1]]
        self._last_poses = poses[-1]
        x = np.array([pose.x for pose in poses])
        y = np.array([pose.y for pose in poses])
        x_before = np.array([pose.x for pose in previous_poses])
        y_before = np.array([pose.y for pose in previous_poses])
        outside = self._arena.depth_inside(x, y) < 0
        entered = self._obstacles.meets_segments(x_before, y_before, x, y)
        self.failed = self.failed or bool(outside.any() or entered.any())


class DroppedError(BaseException):
    """The signal that ends a trial because its script has dropped it and needs no result."""


class AskingController:
    """The controller of a trial that a script steers, which asks the script for each direction.

    In `plan`, the trial's thread waits for the script's decision. The trial ends where `sequence`
    would end it: on arrival, at the time limit, or after an error.
    """

    def __init__(self, sequence: SequenceController) -> None:
        self._sequence = sequence
        self.messages_to_script = SimpleQueue[Observation | Result | BaseException]()
        """Frames for which the script has to decide, and finally the trial's result or error."""
        self.decisions = SimpleQueue[Plan | Outcome | None]()
        """The script's decisions. None if the script drops the trial."""

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome:
        """Return the script's decision, unless the trial is over; see `Controller.plan`."""
        state = self._sequence.step(observation, last_command)
        if isinstance(state, Outcome):
            return state
        self.messages_to_script.put(observation)
        decision = self.decisions.get()
        if decision is None:
            raise DroppedError
        return decision

    def run(self, trial: Trial) -> None:
        """Run a trial with this controller, and pass its result or error to the script."""
        try:
            self.messages_to_script.put(trial.run())
        except BaseException as error:  # the script raises it
            self.messages_to_script.put(error)


def drop_trial(decisions: SimpleQueue[Plan | Outcome | None], thread: threading.Thread) -> None:
    """End a trial that waits for the script's decision, and wait until its thread has ended."""
    decisions.put(None)
    thread.join()


class OpenTrial:
    """A simulated trial that waits for a direction at each control step.

    Call `step` until `result` is no longer None, or end the trial with `stop`. Then `save` writes
    its log. A trial runs once: open another trial for the next run. A trial that is dropped ends
    like a stopped trial, but without a result.

    Args:
        spec: The spec, from `directed_spec`.
        trial: Index of the trial, from 0.
        seed: Root seed, which determines the random numbers of all trials of the spec.
    """

    def __init__(self, spec: LoadedSpec, trial: int, seed: int) -> None:
        experiment = spec.experiment
        section: ControllerSection = experiment.controller
        assert isinstance(section, SequenceSection), "a spec by `directed_spec`"
        self._spec = spec
        self._trial = require_whole_number(trial, "a trial")
        self._seed = require_whole_number(seed, "a seed")
        self._directions: list[float] = []
        self._truth_watch = TruthWatch(experiment.setup)
        key, plant_seed = trial_seeds(self._seed, self._trial)
        self._controller = AskingController(SequenceController(section, experiment.setup, key))
        clock = experiment.plant.clock()
        control_loop = Trial(
            start=replace(
                create_start(spec, self._trial, UNOPENED_PLANT, SIMULATED_START_NS), seed=self._seed
            ),
            plant=experiment.plant.build(experiment.setup, clock, plant_seed, LabSupervision()),
            controller=self._controller,
            clock=clock,
            observers=[self._truth_watch],
            interrupt=Interrupt(),
        )
        thread = threading.Thread(target=self._controller.run, args=(control_loop,), daemon=True)
        self._drop_trial = weakref.finalize(self, drop_trial, self._controller.decisions, thread)
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
        """The newest camera frame that the trial has read.

        Its poses are measured, and read-only.
        """
        return self._observation

    @property
    def directions(self) -> tuple[float, ...]:
        """The directions that the script has sent to the robots so far [rad]."""
        return tuple(self._directions)

    @property
    def last_direction(self) -> float | None:
        """The direction sent last [rad].

        The value is None before the first direction.
        """
        return self._directions[-1] if self._directions else None

    @property
    def result(self) -> Result | None:
        """The result of the trial. None as long as it waits for a direction."""
        return self._result

    @property
    def failed(self) -> bool:
        """Whether a robot has truly entered an obstacle or left the arena so far."""
        if self._result is None:
            return self._truth_watch.failed
        verdict = self._result.verdict
        return any(verdict.entered) or any(edge < 0 for edge in verdict.edge)

    def step(self, direction: float) -> Observation:
        """Send a direction [rad] for one control period, and return the next observation.

        If the trial ends in this step, the observation before it is returned.

        Raises:
            UsageError: If the direction is not finite, or if the trial has ended. Such a direction
                does not count as sent.
        """
        self._demand_open()
        try:
            direction = float(direction)
        except (TypeError, ValueError):
            direction = math.nan
        if not math.isfinite(direction):
            raise UsageError("a direction must be a finite number [rad]")
        self._directions.append(direction)
        self._controller.decisions.put(self._single_direction_plan(direction))
        self._wait()
        return self.observation

    def stop(self) -> Result:
        """End the trial after the directions sent so far, and return the result.

        Raises:
            UsageError: If the trial has ended, or if no direction has been sent.
        """
        self._demand_open()
        if not self._directions:
            raise UsageError(
                "a trial must have at least one direction", "call step() before you stop the trial"
            )
        self._controller.decisions.put(Outcome.SEQUENCE_COMPLETED)
        self._wait()
        assert self._result is not None
        return self._result

    @property
    def spec(self) -> LoadedSpec:
        """The spec of this trial with the directions sent so far, for `tetractl run`.

        Raises:
            UsageError: If no direction was sent.
        """
        if not self._directions:
            raise UsageError(
                "no direction was sent in this trial", "call step() before you read this value"
            )
        section = self._spec.experiment.controller
        with_directions = section.model_copy(update={"directions": self.directions})
        return with_seed(with_controller(self._spec, with_directions), self._seed)

    def save(self, folder: str | Path) -> Path:
        """Run the same trial again, write its log to a folder, and return the path of the log.

        Raises:
            UsageError: If the trial has not ended, or if the log already exists.
            TetractlError: If the repeated trial ended differently.
        """
        if self._result is None:
            raise UsageError(
                "the trial has not ended yet",
                "call step() until the trial has a result, or call stop()",
            )
        require_type(folder, str | Path, "the folder must be a path")
        path = log_path(Path(folder), self._trial)
        if path.exists():
            raise UsageError(f"{path}: exists already", "name another folder")
        make_folder(Path(folder))
        logged = run_logged(self.spec, Path(folder), self._trial)
        if _outcome_of(logged) != _outcome_of(self._result):
            raise TetractlError(
                f"{path}: the trial ended differently when it was repeated to write this log"
            )
        return path

    def _demand_open(self) -> None:
        """Raise UsageError if the trial has ended."""
        if not self._drop_trial.alive:
            raise UsageError("the trial was cut short by an error", "open another trial")
        if self._result is not None:
            outcome = self._result.outcome.value
            raise UsageError(f"the trial has already ended: {outcome}", "open another trial")

    def _single_direction_plan(self, direction: float) -> Plan:
        """Create a plan with a single direction.

        It lacks the prediction that the log from `save` contains.
        """
        no_path = np.empty((0, len(self.setup.names), 3))
        return Plan(
            signals=np.array([direction]),
            path=no_path,
            cost=math.nan,
            target_cost=math.nan,
            obstacle_cost=math.nan,
            searches=(),
            chosen=0,
            generator=0,
        )

    def _wait(self) -> None:
        """Wait until the trial asks for the next decision or has ended.

        Anything that interrupts the wait, such as Ctrl-C, ends the trial without a result.
        """
        try:
            message = self._controller.messages_to_script.get()
            if isinstance(message, BaseException):
                raise message
        except BaseException:
            self._drop_trial()
            raise
        if isinstance(message, Observation):
            self._observation = message
            return
        # virtual time stands still while a script thinks: it is never late
        self._result = replace(message, solve_ns=(0,) * message.steps, deadline_misses=0)


def _outcome_of(result: Result) -> tuple[object, ...]:
    """Return the values of a result that are the same whenever a simulated trial is repeated."""
    return result.outcome, result.steps, result.duration_s, result.robot_errors
