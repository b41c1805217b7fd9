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
    """A command on its way to N robots: sent at `sent_ns`, it acts from `due_ns` on.

    `reached` (N,) is True for robots that receive the command; it acts on each robot `late_ns` (N,)
    after `due_ns`, None for no further delay. `headings` (N,) are the headings that the host had
    measured when it sent the command [rad]; `wheels` (2, N) are the left and right wheel speeds
    commanded [length unit/s], None if robots are sent the direction itself.
    """

    sent_ns: int
    due_ns: int
    action: Action
    reached: Bools
    late_ns: Times | None = None
    headings: Floats | None = None
    wheels: Floats | None = None


class Disturbance:
    """A disturbance of one trial of N robots; by default each method returns its argument
    unchanged.

    Several disturbances act one after another, in the order of the spec. Times are on the trial's
    clock, which starts when the plant is opened.
    """

    def parameters(self, a: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """Return the true turning rates [rad/s] and speeds [length unit/s], (N,), given the spec's.

        Called once, before all other methods.
        """
        return a, speed

    def placed(self, poses: Poses) -> Poses:
        """Return the true start poses, given the spec's start poses; called once."""
        return poses

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return the true turning rates a and speeds from `time_s` to the next call, (N,) each.

        `a` and `speed` are what `parameters` returned, as varied by the disturbances before this
        one. A robot with a = 0 and speed 0 is held still. Called when a camera frame is exposed and
        when a command acts, after `moved` for the same time.
        """
        return a, speed

    def planning_s(self, time_s: float) -> float:
        """Return the planning time [s]: from `time_s`, when the frame is read, to the sending of
        the command or stop. The times of all disturbances are added.
        """
        return 0.0

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Return a command or a repeated stop as the robots will receive it.

        Commands do not overtake each other: a command that would arrive before an earlier one acts
        together with it.
        """
        return command

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Return the true poses at `time_s`, given the poses that the motion and the disturbances
        before this one led to.

        What is returned is what happened in `seconds`, the time since the last call; `moving` (N,)
        says to which robots: 1 for a robot that was commanded to move and was not held still by
        another disturbance, 0 for one that stood. Called when `varied` is, just before it.
        """
        return poses

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return a camera frame's content: poses, and whether each robot was tracked, (N,).

        `time_s` is the time of exposure. The pose of a robot that is not tracked is not used.
        """
        return poses, valid

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the time [ns] when a frame exposed at `exposed_ns` arrives; None if it is lost.

        `received_ns` is the time of arrival after the disturbances before this one. Frames arrive
        in order: a frame that would overtake another arrives together with it.
        """
        return received_ns


def overriding(
    disturbances: Sequence[Disturbance], method: Callable[..., Any]
) -> list[Disturbance]:
    """Return the disturbances that have their own form of a method of `Disturbance`, in order."""
    name = method.__name__
    return [
        disturbance
        for disturbance in disturbances
        if getattr(type(disturbance), name) is not method
    ]


class DisturbanceSection(Model):
    """A disturbance and its parameters."""

    type: Any  # the section's name, a Literal in each subclass

    @property
    def loses_frames(self) -> bool:
        """Whether `Disturbance.received` may lose a frame."""
        return False

    @property
    def planning_max_s(self) -> float:
        """Upper bound of `Disturbance.planning_s` [s]."""
        return 0.0

    @abstractmethod
    def build(self, setup: Setup, rng: np.random.Generator) -> Disturbance:
        """Return the disturbance of one trial; `rng` is used by this disturbance alone."""
