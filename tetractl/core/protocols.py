"""The protocols of plants, controllers, observers and the lab's devices."""

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from tetractl.core.commands import Action, Command, Steer, Transmission, Turn
from tetractl.core.guard_findings import Finding, RobotPlace
from tetractl.core.plan import Decision, Limits, Problem, Search
from tetractl.core.poses import CameraFrame, Floats, Observation, Pose, Sample
from tetractl.core.trial import Note, PlantInfo, Result, Start, Step, Verdict


class Plant(Protocol):
    """N robots under one control signal, simulated or real.

    Calls come in this order: open, then any of observe, send, samples and news, then stop, settle,
    close. Times are nanoseconds on the clock with which the plant was created, 0 at the trial's
    start.
    """

    def open(self) -> PlantInfo:
        """Prepare the plant and return its description; raise AbortError if it cannot run."""
        ...

    def observe(self) -> Observation:
        """Return the newest camera frame."""
        ...

    def send(self, action: Action) -> Command:
        """Make all robots do what `action` says, and return the command that was really sent.

        `FieldOff` is allowed only for plants whose section has `switches_field`, `Stop` only for
        robots that can stand still, and `Turn` only for robots with wheels that stand.
        """
        ...

    def samples(self) -> list[Sample]:
        """Return every camera frame since the last call, oldest first."""
        ...

    def news(self) -> list[Command | Note]:
        """Return the commands sent outside `send`, and the notes, since the last call, oldest
        first."""
        ...

    def stop(self) -> Command:
        """Stop every robot; idempotent, never raises."""
        ...

    def settle(self) -> Verdict:
        """Wait, after `stop`, until the robots stand still, and return how the trial ended."""
        ...

    def close(self) -> None:
        """Release all resources that `open` acquired; idempotent, never raises."""
        ...


EMULATED_NAME = "EMULATED by tetractl"
"""Text in the name that an emulated device reports to its client."""


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a device of the lab before a run.

    `problems` prevent a run from starting, `warnings` do not, and `questions` need the operator's
    consent; all are lines of text. The log's metadata hold the `facts`. `emulated` is True if the
    device reports that it is not real; all tables and figures then mark the trial as emulated.
    """

    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    questions: tuple[str, ...] = ()
    emulated: bool = False


class Device(Protocol):
    """A device of the lab that is opened, checked and closed; a context manager.

    Entering connects to the device and raises AbortError if that fails; leaving releases
    everything, is idempotent and never raises.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def check(self) -> Health:
        """Return problems, warnings and facts, without moving a robot.

        `check` may be called several times between entering the device and a run.
        """
        ...


class Camera(Device, Protocol):
    """Tracks N robots in the spec's coordinates.

    Once its context is entered, the camera has a frame and receives further frames in the
    background. After each frame it calls the function `wake` that its constructor was given; times
    are ns on the clock that its constructor was given.
    """

    @property
    def damaged(self) -> int:
        """Number of messages dropped so far because they could not be decoded."""
        ...

    def frames(self) -> list[CameraFrame]:
        """Return every frame since the last call, oldest first."""
        ...


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The answer of one robot to a poll; `answers` is None for a robot that cannot answer. It gives
    the voltage of its battery [V], or its charge [%], or neither."""

    answers: bool | None
    battery_v: float | None = None
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    charge: int | None = None

    @property
    def battery(self) -> str | None:
        """The voltage or the charge, for display; None if neither is known."""
        if self.battery_v is not None:
            return f"{self.battery_v:.2f} V"
        return None if self.charge is None else f"{self.charge} %"


class Actuator(Device, Protocol):
    """Turns the common direction into motion of N robots.

    Sending raises AbortError if the device does not accept the command; `failure` then gives the
    reason. Times are ns on the clock with which the actuator was created.
    """

    @property
    def halts(self) -> bool:
        """Whether robots stand still after a stop; swimmers in a magnetic field go on."""
        ...

    @property
    def period_ns(self) -> int:
        """Time between two transmissions under a held direction [ns]."""
        ...

    @property
    def failure(self) -> str | None:
        """The reason why commands can no longer be sent, None if there is no fault."""
        ...

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Steer the robots or turn them on the spot, and return what was really sent.

        `poses` are the newest pose of each robot at the time `exposed_ns`, None for a robot that is
        not tracked; a pose measured earlier is brought to that time by the commands sent. Robots
        for which `moving` is false are held still; for robots that are stopped `together`, as the
        guard's checks say, `moving` is true for all. Raises AbortError for a `Turn` of robots that
        cannot stand still, as `halts` says.
        """
        ...

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop every robot; a device that can latch an emergency stop does so."""
        ...

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every robot for its status, for at most `timeout_s`, and return the answers; only
        before a run."""
        ...


class GuardCheck(Protocol):
    """One check of what robots do in a lab; an actuator's section names the list of its robots'. A
    check that inherits from this class answers some of these questions, and finds nothing else.

    `start` is called before each run, then `sent` for each transmission, `exposed` for each frame,
    then for each new pose that its robot can have reached `pose`, or `repeat` if it equals the last
    one, `frame` once the poses are accepted, and `tick` before each ruling. Between runs `pause` is
    called in place of `pose` and `repeat`. Findings take effect in the order in which they are
    yielded. Lengths are in the spec's length unit, times ns.
    """

    def start(self) -> None:
        """Forget what was seen before: robots start from rest."""

    def replace(self, robot: int) -> None:
        """Forget a lost robot, in place of which another body is followed from now on."""

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s]."""

    def exposed(self, times: tuple[int, ...]) -> None:
        """Take the times (N,) of the poses of a frame."""

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterable[Finding]:
        """Check the newest pose of a robot in a run, by its last accepted one."""
        return ()

    def repeat(self, robot: int) -> Iterable[Finding]:
        """Check a robot in a run whose newest pose equals its last accepted one to the bit."""
        return ()

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Check the newest pose of a robot in a pause between two runs."""
        return ()

    def frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> Iterable[Finding]:
        """Check the last accepted poses (N,) of a frame in a run, whose poses have the `times`."""
        return ()

    def tick(self, robots: Sequence[RobotPlace]) -> Iterable[Finding]:
        """Check where the robots (N,) are at a tick of a run."""
        return ()


class Optimizer(Protocol):
    """Finds a sequence of directions with a low cost."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Return the record of a search for the best sequence of `length` signals.

        `warm` (length,) is a sequence to start from, None for none; it is not changed. `key`
        determines all random numbers: the same arguments give the same bits. Raises ControlError if
        a cost is not finite.
        """
        ...


class Controller(Protocol):
    """Chooses the common direction at each control step; each trial has its own controller."""

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Return the plan whose `action` is sent next, or the end of the trial. Called once in each
        control step.

        `observation` is the newest camera frame; `earlier` are the frames exposed since the
        previous control step's observation, oldest first. `last_command` is the command of the
        previous control step, None at the first.
        """
        ...


class Observer(Protocol):
    """An object that is notified of the events of a trial, such as the log writer or live view.

    What a subclass does not define does nothing.
    """

    def on_start(self, start: Start) -> None:
        """Called before the first step."""

    def on_samples(self, samples: list[Sample]) -> None:
        """Called with new camera frames, oldest first, each once."""

    def on_step(self, step: Step) -> None:
        """Called after each control step, instead of `on_command` for the step's command."""

    def on_command(self, command: Command) -> None:
        """Called for a command outside control steps, as in the square before the first plan."""

    def on_note(self, note: Note) -> None:
        """Called for a message to the operator, such as that a robot does not move as commanded."""

    def on_stop(self, stop: Command, result: Result) -> None:
        """Called after the robots were stopped, for any reason."""


class PlacementPrompt(Protocol):
    """Asks a person to put robots on their starts."""

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Show the problems that prevent a start, one line each; without lines, all robots are
        ready.

        By letting the robots start, the operator answers yes to all `questions`, one line each.
        This method is called repeatedly while robots are placed.
        """
        ...

    def go(self) -> bool:
        """Return whether the operator lets the robots start."""
        ...


@dataclass(slots=True)
class LabSupervision:
    """How people supervise a run in the lab.

    Setting `emergency` triggers the emergency stop. If `prompt` is None, no person is asked, and
    the run ends if robots are not on their starts within the spec's `placing` time. `cancelled`
    returns whether the operator has cancelled the wait. An emulated lab calls `signalled` to ask
    the trial to end, as a signal does, and `fail_log` to fail the disk of its log.
    """

    emergency: threading.Event = field(default_factory=threading.Event)
    prompt: PlacementPrompt | None = None
    cancelled: Callable[[], bool] = lambda: False
    signalled: Callable[[], None] = lambda: None
    fail_log: Callable[[OSError], None] = lambda error: None
