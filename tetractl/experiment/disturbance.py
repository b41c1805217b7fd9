"""What every disturbance of a simulation has; each is one file, named in `experiment.kinds`."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model


@dataclass(frozen=True, slots=True)
class DelayedCommand:
    """A command on its way to N robots: it acts from `due_ns` on those `reached` (N,).

    `direction` is u [rad], None for a stop and where it switches the `field_off`. `headings` (N,)
    are those that the host had measured when it sent the command [rad]; `wheels` (2, N) are the
    left and right wheel speeds that the command makes [length unit/s], None where robots are sent
    the direction itself.
    """

    due_ns: int
    direction: float | None
    reached: Bools
    headings: Floats | None = None
    wheels: Floats | None = None
    field_off: bool = False


class Disturbance:
    """A disturbance of one trial of N robots; what a method does not change, it returns.

    Several disturb one after another, in the order of the spec.
    """

    def parameters(self, a: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """Return the true a [rad/s] and speed [length unit/s], (N,) each; called once, first."""
        return a, speed

    def placed(self, poses: Poses) -> Poses:
        """Return the true poses before the first command, from those of the spec; called once."""
        return poses

    def planning_s(self) -> float:
        """Return the time from a frame's being given to the controller to the sending of its
        command, or of the stop, in addition to that of the other disturbances [s].
        """
        return 0.0

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        """Return what becomes of a command or of one of the repeated stops.

        Where it would act before one that was sent earlier, it acts together with that.
        """
        return command

    def moved(self, poses: Poses, moving: Floats, seconds: float) -> Poses:
        """Return the true poses after the `seconds` between two camera frames.

        `moving` (N,) is 1 for robots that move, 0 for those that stand.
        """
        return poses

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return what a camera frame shows: poses, and whether each robot was tracked, (N,).

        `time_s` is the time of exposure. The pose of a robot that is not tracked is not used.
        """
        return poses, valid

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return when a frame exposed at `exposed_ns` reaches the host [ns]; None where it is lost.

        `received_ns` is the time after the disturbances before this one. Frames arrive in order:
        one that would overtake another arrives together with that.
        """
        return received_ns


class DisturbanceSection(Model):
    """A disturbance and its parameters."""

    type: Any  # each section's own name, as a Literal

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
        """Return the disturbance of one trial; `rng` feeds it and nothing else."""
