"""`{type: marker-off}`: markers are attached at an angle, so that every measured heading has an
offset."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import NonNegative
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class MarkerOffSection(DisturbanceSection):
    """Each robot's measured heading is off by this, to one side or the other, drawn once a
    trial."""

    type: Literal["marker-off"]
    heading: NonNegative
    """Offset of the measured heading, in either direction [rad]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "MarkerOff":
        """Return the sides of one trial."""
        return MarkerOff(self.heading * rng.choice([-1.0, 1.0], len(setup.names)))


class MarkerOff(Disturbance):
    """Turns what the camera shows by an offset for each robot (N,) [rad]."""

    def __init__(self, off: Floats) -> None:
        self._off = off

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses with their headings off."""
        return Poses(poses.x, poses.y, poses.heading + self._off), valid
