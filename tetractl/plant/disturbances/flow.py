"""`{type: flow}`: the fluid flows, and takes swimming cells along."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Floats, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Finite, NonNegative
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class FlowSection(DisturbanceSection):
    """One flow for all cells, the same everywhere and all the time of a trial."""

    type: Literal["flow"]
    speed: NonNegative
    """Speed of the flow [length unit/s]."""
    direction: Finite | None = None
    """Direction of the flow, anticlockwise from +x [rad]; by default drawn in every trial."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Flow":
        """Return the flow of one trial."""
        drawn = rng.uniform(-np.pi, np.pi)
        angle = drawn if self.direction is None else self.direction
        return Flow(self.speed * np.array([np.cos(angle), np.sin(angle)]))


class Flow(Disturbance):
    """Carries each cell that swims at a velocity (2,) [length unit/s]."""

    def __init__(self, velocity: Floats) -> None:
        self._velocity = velocity

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Return the poses carried by `seconds` of the flow."""
        along = moving * seconds
        x, y = self._velocity
        return Poses(poses.x + x * along, poses.y + y * along, poses.heading)
