"""Base classes of disturbances; each kind is named in `core.registries`."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.commands import Action
from tetractl.core.poses import Bools, Floats, Poses, Times
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model


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

        `a` and `speed` come from `parameters`, as varied by the disturbances before this one.
        Called before every exposure of a camera frame and before each command acts; a robot with a
        = 0 and speed 0 stands.
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
        """Return the true poses at `time_s`; `poses` are the poses without this disturbance.

        The disturbance acts over `seconds`, the time since the last call, on robots that move:
        `moving` (N,) is 1 for them, 0 for robots that stand. A robot that this disturbance itself
        holds, by a = 0 and speed 0 in `varied`, counts as moving while it is commanded to move.
        Called just before each `varied`.
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


def overriding(disturbances: Sequence[Disturbance], method: str) -> list[Disturbance]:
    """Return the disturbances whose class overrides a method, in order."""
    unchanged = getattr(Disturbance, method)
    return [
        disturbance
        for disturbance in disturbances
        if getattr(type(disturbance), method) is not unchanged
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
