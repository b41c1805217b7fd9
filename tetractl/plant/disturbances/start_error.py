"""`{type: start-error}`: the robots do not stand exactly on the spec's starts."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import NonNegative
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class StartErrorSection(DisturbanceSection):
    """Each robot is put down near its start, uniformly distributed, again in every trial."""

    type: Literal["start-error"]
    position: NonNegative = 0.0
    """x and y are off by up to this [length unit]."""
    heading: NonNegative = 0.0
    """The heading is off by up to this [rad]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "StartError":
        """Return the error of one trial."""
        return StartError(self, rng)


class StartError(Disturbance):
    """Draws the errors of the start poses."""

    def __init__(self, section: StartErrorSection, rng: np.random.Generator) -> None:
        self._section, self._rng = section, rng

    def placed(self, poses: Poses) -> Poses:
        """Return the poses with their errors."""
        x, y, heading = self._rng.uniform(-1, 1, (3, poses.x.size))
        off, turned = self._section.position, self._section.heading
        return Poses(poses.x + off * x, poses.y + off * y, poses.heading + turned * heading)
