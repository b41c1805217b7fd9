"""What every disturbance of a simulation has; each is one file, named in `experiment.kinds`."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model


@dataclass(frozen=True, slots=True)
class Order:
    """A command on its way to N robots: it acts from `due_ns` on those `reached` (N,).

    `direction` is u [rad], None for a stop.
    """

    due_ns: int
    direction: float | None
    reached: Bools


class Disturbance:
    """A disturbance of one trial of N robots; what a method does not change, it returns.

    Several disturb one after another, in the order of the spec.
    """

    def parameters(self, a: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """Return the true a [rad/s] and speed [length unit/s], (N,) each; called once, first."""
        return a, speed

    def sent(self, order: Order) -> Order:
        """Return what becomes of a command; stops are not disturbed.

        Where it would act before one that was sent earlier, it acts together with that.
        """
        return order

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


class DisturbanceSection(Model):
    """A disturbance and its parameters."""

    type: Any  # each section's own name, as a Literal

    @abstractmethod
    def build(self, setup: Setup, rng: np.random.Generator) -> Disturbance:
        """Return the disturbance of one trial; `rng` feeds it and nothing else."""
