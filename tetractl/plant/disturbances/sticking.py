"""`{type: sticking}`: robots occasionally stand still for a moment."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.experiment.base import NonNegative, Positive
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection
from tetractl.plant.disturbances.spells import ByTurns


class StickingSection(DisturbanceSection):
    """Each robot sticks occasionally, as at a cable or on dust, independently of the others."""

    type: Literal["sticking"]
    every: Positive
    """Mean time between two times that a robot sticks [s], exponentially distributed."""
    duration: NonNegative = 0.5
    """Time for which it then neither moves nor turns [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Sticking":
        """Return the sticking of one trial."""
        return Sticking(self, len(setup.names), rng)


class Sticking(Disturbance):
    """Holds each robot independently."""

    def __init__(self, section: StickingSection, robots: int, rng: np.random.Generator) -> None:
        free_s, stuck_s = section.every, section.duration
        self._free = ByTurns(robots, lambda: rng.exponential(free_s), lambda: stuck_s)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return no turning and no speed for the robots that stick."""
        free = self._free.well(time_s)
        return a * free, speed * free
