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
    """A disturbance that carries all swimming cells with a constant flow.

    Args:
        velocity: Velocity x, y of the flow [length unit/s], shape (2,).
    """

    def __init__(self, velocity: Floats) -> None:
        self.velocity = velocity

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Move the cells with the flow; see `Disturbance.moved`."""
        moving_s = moving * seconds
        velocity_x, velocity_y = self.velocity
        return Poses(
            poses.x + velocity_x * moving_s, poses.y + velocity_y * moving_s, poses.heading
        )


class WobbleSection(DisturbanceSection):
    """A disturbance: each cell swims on a helix, and the field turns the axis of the helix.

    Seen from above, the cell swings from side to side of the axis, and its body points along its
    path.
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
    """A disturbance that moves swimming cells sideways, as seen from above, along their helices.

    The true heading is the direction of the helix's axis. The camera measures the direction of the
    cell's body instead.

    Args:
        section: The fields of the disturbance in the spec.
        speeds: Speeds of the cells [length unit/s], shape (N,).
        phases_rad: Phases of the helices at the start [rad], shape (N,).
    """

    def __init__(self, section: WobbleSection, speeds: Floats, phases_rad: Floats) -> None:
        self._radius = section.radius
        self._phase_rate_rad_s = 2 * np.pi * section.frequency
        self._speeds = speeds
        self._phases_rad = phases_rad
        self._moving = np.zeros_like(phases_rad)  # 1 for the cells that swam until the last call

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        """Move the swimming cells along their helices; see `Disturbance.moved`."""
        old_phases_rad = self._phases_rad
        self._moving = moving
        self._phases_rad = old_phases_rad + self._phase_rate_rad_s * seconds * moving
        left_shift = self._radius * (
            elementwise.sin(self._phases_rad) - elementwise.sin(old_phases_rad)
        )
        x = poses.x - left_shift * elementwise.sin(poses.heading)
        y = poses.y + left_shift * elementwise.cos(poses.heading)
        return Poses(x, y, poses.heading)

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Replace the headings of the axes by those of the bodies; see `Disturbance.measured`."""
        sideways_speed = (
            self._radius * self._phase_rate_rad_s * elementwise.cos(self._phases_rad) * self._moving
        )
        body_angle_rad = elementwise.atan2(
            sideways_speed, np.maximum(self._speeds, np.finfo(float).tiny)
        )
        return Poses(poses.x, poses.y, poses.heading + body_angle_rad), valid
