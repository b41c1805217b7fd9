"""Disturbances of swimming cells: the flow that carries them, and their helical path."""

from typing import Annotated, Literal

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.spec.base import ANGLE_MARK, Finite, NonNegative, Positive
from tetractl.spec.disturbance import Disturbance, DisturbanceSection


class FlowSection(DisturbanceSection):
    """A disturbance: one flow carries all cells, constant in space and during a trial."""

    type: Literal["flow"]
    speed: NonNegative
    """Speed of the flow [length unit/s]."""
    direction: Annotated[Finite | None, ANGLE_MARK] = None
    """Direction of the flow, anticlockwise from +x [rad]. Default: sampled in every trial."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Flow":
        """Create the disturbance that this section of the spec describes, for one trial."""
        angle = rng.uniform(-np.pi, np.pi)  # drawn in any case: it is part of the result
        if self.direction is not None:
            angle = self.direction
        return Flow(self.speed * np.array([elementwise.cos(angle), elementwise.sin(angle)]))


class Flow(Disturbance):
    """A disturbance that carries each swimming cell with a flow [length unit/s], shape (2,)."""

    def __init__(self, velocity: Floats) -> None:
        self.velocity = velocity

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Move the cells with the flow; see `Disturbance.moved`."""
        moving_s = moving * seconds
        x_rate, y_rate = self.velocity
        return Poses(poses.x + x_rate * moving_s, poses.y + y_rate * moving_s, poses.heading)


class WobbleSection(DisturbanceSection):
    """A disturbance: each cell swims on a helix about an axis that the field turns.

    Seen from above, the cell swings across the axis, and its body points along its path.
    """

    type: Literal["wobble"]
    radius: NonNegative
    """Radius of the helix [length unit]."""
    frequency: Positive
    """Frequency of the helix [Hz]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Wobble":
        """Create this disturbance for one trial, with a random phase for each cell."""
        return Wobble(self, setup.speed, rng.uniform(-np.pi, np.pi, len(setup.names)))


class Wobble(Disturbance):
    """A disturbance that moves cells sideways along their helices.

    The true heading is the axis's direction. The camera measures the body's direction.

    Args:
        section: The fields of the disturbance in the spec.
        speed: Speeds of the cells [length unit/s], shape (N,).
        phase: Phases of the helices at the start [rad], shape (N,).
    """

    def __init__(self, section: WobbleSection, speed: Floats, phase: Floats) -> None:
        self._radius = section.radius
        self._rate_rad_s = 2 * np.pi * section.frequency
        self._speed = speed
        self._phase = phase
        self._moving = np.zeros_like(phase)  # which cells swam up to now

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Move the swimming cells along their helices; see `Disturbance.moved`."""
        before = self._phase
        self._moving = moving
        self._phase = before + self._rate_rad_s * seconds * moving
        across = self._radius * (elementwise.sin(self._phase) - elementwise.sin(before))
        x = poses.x - across * elementwise.sin(poses.heading)
        y = poses.y + across * elementwise.cos(poses.heading)
        return Poses(x, y, poses.heading)

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses with the headings of the bodies; see `Disturbance.measured`."""
        sideways = self._radius * self._rate_rad_s * elementwise.cos(self._phase) * self._moving
        tilt = elementwise.atan2(sideways, np.maximum(self._speed, np.finfo(float).tiny))
        return Poses(poses.x, poses.y, poses.heading + tilt), valid
