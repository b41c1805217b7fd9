"""The protocols of plants, controllers, observers and the lab's devices."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from tetractl.core.commands import Action, Command, Steer, Transmission, Turn
from tetractl.core.plan import Decision, Limits, Problem, Search
from tetractl.core.poses import CameraFrame, Floats, Observation, Pose, Sample
from tetractl.core.trial import Note, PlantInfo, Result, Start, Step, Verdict


class Plant(Protocol):
    """The robots of a trial, simulated or real, under one control signal.

    Calls come in this order: `open`, then any of `observe`, `send`, `samples` and `events`, then
    `stop`, `settle` and `close`. Times are nanoseconds on the clock with which the plant was
    created. That clock is at 0 when the trial starts.
    """

    def open(self) -> PlantInfo:
        """Prepare the robots and devices for a trial, and return their description.

        Raises:
            AbortError: If the plant cannot run.
        """
        ...

    def observe(self) -> Observation:
        """Return the newest camera frame, with the measured poses of all robots.

        An untracked robot keeps its last pose, and its entry in `valid` is False.
        """
        ...

    def send(self, action: Action) -> Command:
        """Make all robots perform an action: drive in a direction, or stand still.

        Args:
            action: What the robots are to do. `FieldOff` is allowed only if the plant's section has
                `switches_field`, `Stop` only if the robots can stand still, and `Turn` only if they
                can turn on the spot with their wheels.

        Returns:
            The command that was really sent.
        """
        ...

    def samples(self) -> list[Sample]:
        """Return every camera frame since the last call, oldest first.

        The list is empty if there is no new frame.
        """
        ...

    def events(self) -> list[Command | Note]:
        """Return everything else that happened since the last call, oldest first.

        This includes notes to the operator, and commands that the plant sent without a call of
        `send`.
        """
        ...

    def stop(self) -> Command:
        """Stop every robot, and return the command that was sent.

        It may be called repeatedly and never raises. Later calls need not send anything, and return
        the command of the first call.
        """
        ...

    def settle(self) -> Verdict:
        """Wait until the robots stand still after `stop`, and measure how the trial ended."""
        ...

    def close(self) -> None:
        """Release everything that `open` acquired. It may be called repeatedly and never raises."""
        ...


EMULATED_NAME = "EMULATED by tetractl"
"""Part of the name that an emulated device reports to its client."""


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a camera or an actuator of the lab before a run.

    Attributes:
        problems: What prevents a run from starting, one line each.
        warnings: What the operator should know, one line each. Warnings do not prevent a run.
        facts: Facts about the device for the log's metadata.
        questions: What the operator has to agree to before a run, one line each.
        emulated: Whether the device reports that it is not real. All tables and figures then mark
            the trial as emulated.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    questions: tuple[str, ...] = ()
    emulated: bool = False


class Device(Protocol):
    """A lab device that is opened, checked and closed.

    A device is a context manager. Entering it connects to the device, and raises AbortError if that
    fails. Leaving it releases everything. Leaving may be repeated and never raises.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def check(self) -> Health:
        """Check the device without moving a robot.

        It may be called several times between entering the device and a run.

        Returns:
            Problems, warnings, questions and facts.
        """
        ...


class Camera(Device, Protocol):
    """A device that tracks N robots in the spec's coordinates.

    Once its context is entered, the camera has a frame, and receives more frames in the background.
    After each frame, it calls the function `wake` that its constructor received. Times are ns on
    the clock that its constructor received.
    """

    @property
    def damaged(self) -> int:
        """Number of messages dropped so far because they could not be decoded."""
        ...

    def frames(self) -> list[CameraFrame]:
        """Return every camera frame that has arrived since the last call, oldest first."""
        ...


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The answer of one robot to a poll, such as its battery's voltage.

    Attributes:
        answers: Whether the robot answered. None if it cannot answer.
        battery_v: Battery voltage [V]. None if the robot does not report it.
        problems: What prevents a run with this robot, one line each.
        warnings: What the operator should know about this robot, one line each.
        charge: Battery charge [%]. None if the robot does not report it.
    """

    answers: bool | None
    battery_v: float | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    charge: int | None = None

    @property
    def battery(self) -> str | None:
        """The battery's voltage, such as "4.10 V", or else its charge, such as "80 %".

        None if neither is known.
        """
        if self.battery_v is not None:
            return f"{self.battery_v:.2f} V"
        return None if self.charge is None else f"{self.charge} %"


class Actuator(Device, Protocol):
    """A device that turns the common direction into motion of N robots.

    `send` and `stop` raise AbortError if the device does not accept the command, and `failure` then
    gives the reason. Times are ns on the clock with which the actuator was created.
    """

    @property
    def halts(self) -> bool:
        """Whether robots stand still after a stop. False for swimmers in a magnetic field."""
        ...

    @property
    def period_ns(self) -> int:
        """Time between two transmissions of the same direction while it is held [ns]."""
        ...

    @property
    def failure(self) -> str | None:
        """Why commands can no longer be sent. None if there is no fault."""
        ...

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Steer all robots towards one common direction, or let them turn on the spot.

        Args:
            action: The common direction to steer in, or the direction to turn to.
            poses: Newest pose of each robot at the time `exposed_ns`, N entries. None if a robot is
                untracked. The commands sent since then have already been used to bring an older
                pose to that time.
            moving: Whether each robot may move, N entries. The actuator holds all other robots
                still. If the guard's checks stop robots `together`, all entries are True.
            exposed_ns: The time of the poses [ns].

        Returns:
            The command that was really sent.

        Raises:
            AbortError: If the device does not accept the command, or if the action is a `Turn` and
                the robots cannot stand still (see `halts`).
        """
        ...

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop every robot as fast as possible.

        Args:
            emergency: Whether to latch the stop, if the device can do that.

        Returns:
            The command that was really sent.
        """
        ...

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every robot for its status before a run.

        Args:
            timeout_s: How long to wait for all answers [s].

        Returns:
            The status of each robot, N entries.
        """
        ...


class Optimizer(Protocol):
    """A search for a sequence of directions with a low cost.

    Example:
        >>> import numpy as np
        >>> from tetractl.core.plan import Search, StopReason
        >>> class StraightOn:
        ...     def search(self, problem, length, warm, key, limits):
        ...         signals = np.zeros(length)
        ...         return Search(length, signals, 0.0, np.zeros(1), 0, StopReason.CRITERION)
    """

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search for the best sequence of signals with a given length.

        The same arguments give the same result, to the bit.

        Args:
            problem: The planning problem: the robots, their targets and the obstacles.
            length: Number of signals in the sequence.
            warm: Warm start: a sequence to start from [rad], shape (length,). The search must not
                change it. None if there is none.
            key: Key that determines all random numbers of the search.
            limits: Limits at which the search has to end early.

        Returns:
            The record of the search, with the best sequence found.

        Raises:
            ControlError: If a cost is not finite.
        """
        ...


class Controller(Protocol):
    """An object that chooses the common direction at each control step of one trial.

    Example:
        >>> class EndAtOnce:
        ...     def plan(self, observation, last_command=None, earlier=()):
        ...         return tetractl.Outcome.ARRIVED
    """

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Decide what to send next, or that the trial ends.

        This method is called once in each control step.

        Args:
            observation: The newest camera frame.
            last_command: The command of the previous control step. None at the first step.
            earlier: Frames since the observation of the previous control step, oldest first.

        Returns:
            The plan whose `action` is sent next, or the end of the trial.
        """
        ...


class Observer(Protocol):
    """An object that is notified of the events of a trial, such as the log writer or the live view.

    Derive from this class, and override the methods that you need. The others do nothing.

    Example:
        >>> class Printer(tetractl.Observer):
        ...     def on_stop(self, stop, result):
        ...         print(f"{result.outcome.value} after {result.steps} steps")
        >>> trial = tetractl.run_trial("experiments/single_cell.yaml", observers=[Printer()])
        arrived after 38 steps
    """

    def on_start(self, start: Start) -> None:
        """Called once, before the first control step."""

    def on_samples(self, samples: list[Sample]) -> None:
        """Called with new camera frames, oldest first. Each frame is passed once."""

    def on_step(self, step: Step) -> None:
        """Called after each control step. `on_command` is not called for the step's command."""

    def on_command(self, command: Command) -> None:
        """Called for a command outside control steps, for example before the first plan."""

    def on_note(self, note: Note) -> None:
        """Called for a message to the operator, for example that a robot does not move."""

    def on_stop(self, stop: Command, result: Result) -> None:
        """Called once at the end, after the robots were stopped for any reason."""


class PlacementPrompt(Protocol):
    """A prompt that asks a person to place the robots on their starts."""

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Show the problems that still prevent the start.

        This method is called repeatedly while robots are placed. If the operator lets the robots
        start, this counts as yes to all questions.

        Args:
            lines: The problems, one line each. Empty if all robots are ready.
            questions: What the operator has to agree to, one line each.
        """
        ...

    def go(self) -> bool:
        """Check whether the operator has let the robots start. It is called repeatedly."""
        ...


@dataclass(slots=True)
class LabSupervision:
    """The means by which people supervise a run in the lab: emergency stop and placing of robots.

    Attributes:
        emergency: Event that triggers the emergency stop when it is set.
        prompt: Prompt that asks a person to place the robots. If None, nobody is asked, and the run
            ends if the robots are not on their starts within the spec's `placing` time.
        cancelled: Function that returns whether the operator has cancelled the wait.
        signalled: Function that an emulated lab calls to end the trial, as a signal would.
        fail_log: Function that an emulated lab calls to make the log's disk fail with an error.
    """

    emergency: threading.Event = field(default_factory=threading.Event)
    prompt: PlacementPrompt | None = None
    cancelled: Callable[[], bool] = lambda: False
    signalled: Callable[[], None] = lambda: None
    fail_log: Callable[[OSError], None] = lambda error: None
