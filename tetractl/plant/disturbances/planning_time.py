"""`{type: planning-time}`: the host computes before it sends."""

from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class PlanningTimeSection(DisturbanceSection):
    """Every command is sent some time after the frame that it answers was read."""

    type: Literal["planning-time"]
    least: float = Field(ge=0, le=10, allow_inf_nan=False)
    """Shortest time of a control step [s]."""
    spread: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """A control step takes up to this much longer, uniformly distributed [s]."""

    @property
    def planning_max_s(self) -> float:
        """Longest time of a control step [s]."""
        return self.least + self.spread

    def build(self, setup: Setup, rng: np.random.Generator) -> "PlanningTime":
        """Return the times of one trial."""
        return PlanningTime(self, rng)


class PlanningTime(Disturbance):
    """Draws the time of each control step."""

    def __init__(self, section: PlanningTimeSection, rng: np.random.Generator) -> None:
        self._section, self._rng = section, rng

    def planning_s(self, time_s: float) -> float:
        """Return the time of one control step [s]."""
        return self._section.least + self._section.spread * self._rng.random()
