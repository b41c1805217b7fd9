"""`{type: tracking-loss}`: the camera loses a robot for a while, as behind a cable or a hand."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Bools, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Positive
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection
from tetractl.plant.disturbances.spells import ByTurns


class TrackingLossSection(DisturbanceSection):
    """The camera loses each robot occasionally, independently of the others."""

    type: Literal["tracking-loss"]
    every: Positive
    """Mean time a robot is tracked between two losses [s], exponentially distributed."""
    duration: Positive = 0.2
    """Mean time it then stays lost [s], exponentially distributed."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "TrackingLoss":
        """Return the losses of one trial."""
        return TrackingLoss(self, len(setup.names), rng)


class TrackingLoss(Disturbance):
    """Each robot is tracked and lost by turns; it is tracked initially."""

    def __init__(self, section: TrackingLossSection, robots: int, rng: np.random.Generator) -> None:
        self._tracked = ByTurns(
            robots,
            lambda: rng.exponential(section.every),
            lambda: rng.exponential(section.duration),
        )

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses as they are, the robots lost at this time as not tracked."""
        return poses, valid & self._tracked.well(time_s)
