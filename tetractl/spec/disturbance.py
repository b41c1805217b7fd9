"""Base classes of disturbances; each kind is named in `core.registries`."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.commands import Action
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.spec.base import Model


@dataclass(frozen=True, slots=True)
class DelayedCommand:
    """A command to N robots that has been sent but may not have taken effect yet.

    Attributes:
        sent_ns: When the command was sent [ns].
        due_ns: When the command takes effect [ns].
        action: The action that the robots are to perform.
        reached: Whether each robot receives the command, shape (N,).
        late_ns: Further delay until the command takes effect on each robot [ns], shape (N,). None
            for no further delay.
        wheels: Commanded speeds of the left and right wheels [length unit/s], shape (2, N). None if
            the robots receive the direction itself.
    """

    sent_ns: int
    due_ns: int
    action: Action
    reached: Bools
    late_ns: Times | None = None
    wheels: Floats | None = None


class Disturbance:
    """A disturbance of one trial with N robots. By default, it changes nothing.

    Several disturbances act one after another, in the order of the spec. Times are on the trial's
    clock, which starts when the plant is opened.
    """

    def parameters(self, a: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """Return the true turning rates and speeds of the robots, shape (N,) each.

        This method is called once, before all other methods.

        Args:
            a: The spec's turning rates [rad/s], shape (N,).
            speed: The spec's speeds [length unit/s], shape (N,).
        """
        return a, speed

    def placed(self, poses: Poses) -> Poses:
        """Return the true start poses, given the start poses in the spec.

        This method is called once, before the trial. By default, the poses stay the same.
        """
        return poses

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Change the true turning rates and speeds of the robots until the next call.

        This method is called when a camera frame is exposed and when a command takes effect, after
        `moved` for the same time.

        Args:
            a: Turning rates [rad/s], shape (N,): those that `parameters` returned, as varied by the
                disturbances before this one.
            speed: Speeds [length unit/s], shape (N,), like `a`.
            time_s: The present time [s].

        Returns:
            Turning rates and speeds, shape (N,) each. A robot with a = 0 and speed 0 is held still.
        """
        return a, speed

    def planning_s(self, time_s: float) -> float:
        """Return the planning time [s] for a frame that the controller reads at `time_s`.

        The planning time ends when the command or stop is sent. The times of all disturbances are
        added.
        """
        return 0.0

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Return a command or a repeated stop as the robots will receive it.

        Commands do not overtake each other: a command that would arrive before an earlier one acts
        together with it.
        """
        return command

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Change the true poses that the robots have reached since the last call.

        This method is called just before `varied`, for the same time: at every camera frame and
        every command.

        Args:
            poses: Poses that result from the motion and from the disturbances before this one.
            moving: 1 for a robot that was commanded to move and not held still by another
                disturbance, 0 for a robot that stood still, shape (N,).
            seconds: Time since the last call [s].
            time_s: The time [s].
        """
        return poses

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Change the contents of a camera frame: the measured poses, and which robots are tracked.

        Args:
            poses: Measured poses. The pose of an untracked robot is not used.
            valid: Whether each robot is tracked, shape (N,).
            time_s: Time of exposure [s].

        Returns:
            The poses, and whether each robot is tracked, shape (N,).
        """
        return poses, valid

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the time at which a camera frame arrives [ns]. None if it is lost.

        Frames arrive in order: a frame that would overtake another arrives together with it.

        Args:
            exposed_ns: Time of exposure [ns].
            received_ns: Time of arrival after the disturbances before this one [ns].
        """
        return received_ns


def overriding(
    disturbances: Sequence[Disturbance], method: Callable[..., Any]
) -> list[Disturbance]:
    """Return the disturbances whose class overrides a method of `Disturbance`, in their order."""
    name = method.__name__
    return [
        disturbance
        for disturbance in disturbances
        if getattr(type(disturbance), name) is not method
    ]


class DisturbanceSection(Model):
    """Base class of the sections of the spec that describe disturbances of a simulation."""

    type: Any  # the section's name, a Literal in each subclass

    @property
    def loses_frames(self) -> bool:
        """Whether this disturbance can lose camera frames; see `Disturbance.received`.

        False by default.
        """
        return False

    @property
    def planning_max_s(self) -> float:
        """The maximum planning time that this disturbance can cause [s]. 0 if it causes none."""
        return 0.0

    @abstractmethod
    def build(self, setup: Setup, rng: np.random.Generator) -> Disturbance:
        """Create the disturbance for one trial, with its own random generator `rng`.

        All random numbers of the disturbance must come from this generator.
        """
