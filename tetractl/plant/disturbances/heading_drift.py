"""`{type: heading-drift}`: robots that turn by themselves, each always to the same side."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import NonNegative
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class HeadingDriftSection(DisturbanceSection):
    """A turning rate is added to that of (3), as by uneven wheels or a bent cell."""

    type: Literal["heading-drift"]
    rate: NonNegative
    """Greatest rate; each robot's is uniform in [-rate, rate], drawn once per trial [rad/s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "HeadingDrift":
        """Return the drift of one trial."""
        return HeadingDrift(self.rate * rng.uniform(-1, 1, len(setup.names)))


class HeadingDrift(Disturbance):
    """Turns each robot that moves at its own rate (N,) [rad/s]."""

    def __init__(self, rates: Floats) -> None:
        self._rates = rates

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Return the poses turned by `seconds` of the drift."""
        return Poses(poses.x, poses.y, poses.heading + self._rates * moving * seconds)
