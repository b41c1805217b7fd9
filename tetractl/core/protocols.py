"""The protocols of plants, controllers, observers and the lab's devices."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from tetractl.core.commands import (
    Command,
    Health,
    Note,
    PlantInfo,
    RobotStatus,
    Sample,
    Transmission,
    Verdict,
)
from tetractl.core.plan import End, Limits, Outcome, Plan, Problem, Search
from tetractl.core.poses import CameraFrame, Floats, Observation, Pose
from tetractl.core.trial import Result, Start, Step


class Plant(Protocol):
    """N robots under one control signal, simulated or real.

    Calls come in this order: open, then any of observe, steer, samples and news, then stop, settle,
    close.
    Times are nanoseconds on the clock the plant was made with, 0 at the trial's start.
    """

    def open(self) -> PlantInfo:
        """Make ready; raise AbortError if the plant cannot run."""
        ...

    def observe(self) -> Observation:
        """Return the newest camera frame."""
        ...

    def steer(self, direction: float | None) -> Command:
        """Send the common direction u [rad] and return what was really sent.

        None switches the field off: no robot is turned, and all go straight on. Only plants whose
        section `switches_field` are given None.
        """
        ...

    def pause(self) -> Command:
        """Stop every robot until the next `steer`; only on plants whose robots can stand still."""
        ...

    def samples(self) -> list[Sample]:
        """Return, once, every camera frame since the last call, oldest first."""
        ...

    def news(self) -> list[Command | Note]:
        """Return, once, what was sent outside `steer` and what was noted, oldest first."""
        ...

    def stop(self) -> Command:
        """Stop every robot; idempotent, never raises."""
        ...

    def settle(self) -> Verdict:
        """After stop: wait until the robots stand still, and evaluate the path."""
        ...

    def close(self) -> None:
        """Release what open took; idempotent, never raises."""
        ...


class Device(Protocol):
    """A device of the lab that is opened, checked and closed; a context manager.

    Entering connects and raises AbortError if that cannot be; leaving releases everything, is
    idempotent and never raises.
    """

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def check(self) -> Health:
        """Return problems, warnings and facts; moves nothing.

        Called after the device was entered and before a run, perhaps many times.
        """
        ...


class Camera(Device, Protocol):
    """Tracks N robots in the spec's coordinates.

    Once entered, the camera has a frame, and further ones come in by themselves: it calls the
    `wake` it was made with after each. Times are ns on the clock it was made with.
    """

    @property
    def newest(self) -> CameraFrame | None:
        """The newest frame, None before the first."""
        ...

    @property
    def damaged(self) -> int:
        """Deliveries dropped so far because they could not be read; never falls."""
        ...

    def frames(self) -> list[CameraFrame]:
        """Return, once, every frame since the last call, oldest first."""
        ...


class Actuator(Device, Protocol):
    """Turns the common direction into motion of N robots.

    Sending raises AbortError if the device does not take it; from then on `failure` says why.
    Times are ns on the clock it was made with.
    """

    @property
    def individual(self) -> bool:
        """Whether one robot can be held still while the others move."""
        ...

    @property
    def halts(self) -> bool:
        """Whether robots stand still once they are stopped; cells under a field swim on."""
        ...

    @property
    def period_ns(self) -> int:
        """Time between two transmissions under a held direction [ns]."""
        ...

    @property
    def failure(self) -> str | None:
        """Why nothing can be sent any more, None while there is no fault."""
        ...

    def steer(
        self,
        direction: float,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Send the common direction u [rad] and return what was really sent.

        `poses` are the newest of each robot, exposed at `exposed_ns`; None if a robot is not
        tracked. Robots that may not be `moving` are held still if that is possible; an actuator
        that is not `individual` is only steered while all may move.
        """
        ...

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop every robot; an emergency stop latches if the device can."""
        ...

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every robot for its status; only before a run."""
        ...


class Optimizer(Protocol):
    """Finds a sequence of directions of small cost."""

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Return the best sequence of `length` signals found, and how the search went.

        `warm` (length,) is a sequence to start from, None for none; it is not changed. `key` fixes
        every random draw: the same arguments give the same bits. Raises ControlError if a cost
        is not finite.
        """
        ...


class Controller(Protocol):
    """Chooses the common direction at each control step; one object lasts one trial."""

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Decide the next `direction` of a plan, or that the trial is over.

        `observation` is the newest camera frame, `earlier` are those exposed since the observation
        of the control step before, oldest first. `last_command` is the command that sent that
        step's direction, None at the first step.
        """
        ...


class Observer(Protocol):
    """Watches a trial: the log writer, the live view and the progress are observers."""

    def on_start(self, start: Start) -> None:
        """Called before the first step."""
        ...

    def on_samples(self, samples: list[Sample]) -> None:
        """Called with new camera frames, oldest first, each once."""
        ...

    def on_step(self, step: Step) -> None:
        """Called after each control step; `on_command` is not called for `step.command`."""
        ...

    def on_command(self, command: Command) -> None:
        """Called for a command outside control steps, as in the square before the first plan."""
        ...

    def on_note(self, note: Note) -> None:
        """Called for a message to the operator, such as that a robot does not move as commanded."""
        ...

    def on_stop(self, stop: Command, result: Result) -> None:
        """Called after the robots were stopped, for any reason."""
        ...


class PlacementPrompt(Protocol):
    """Asks a person to put robots on their starts."""

    def place(self, lines: Sequence[str], questions: Sequence[str] = ()) -> None:
        """Show the problems that keep the robots from starting, one line each; no line means ready.

        Letting the robots start means yes to all `questions`, one line each. Called repeatedly
        while robots are placed.
        """
        ...

    def go(self) -> bool:
        """Return whether the operator lets the robots start."""
        ...


@dataclass(slots=True)
class LabSupervision:
    """How people supervise a run in the lab.

    Setting `emergency` is the emergency stop. If `prompt` is None, no person is asked, and the run
    ends if robots are not on their starts within the spec's `placing` time. `cancelled` returns
    whether the operator gave up waiting.
    """

    emergency: threading.Event = field(default_factory=threading.Event)
    prompt: PlacementPrompt | None = None
    cancelled: Callable[[], bool] = lambda: False
