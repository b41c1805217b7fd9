"""`{type: battery}`: the batteries run down during a trial."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Positive
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class BatterySection(DisturbanceSection):
    """All robots slow down steadily, and then stay as slow as they are."""

    type: Literal["battery"]
    speed: Fraction
    """Share of its speed that each robot loses."""
    a: Fraction = 0.0
    """Share of its a that each robot loses."""
    over: Positive = 30.0
    """Time of the trial until these fractions are lost [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Battery":
        """Return the batteries of one trial."""
        return Battery(self)


class Battery(Disturbance):
    """Takes a share of a and speed that grows with time."""

    def __init__(self, section: BatterySection) -> None:
        self._section = section

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return a and speed minus the present loss."""
        used = min(1.0, time_s / self._section.over)
        return a * (1 - self._section.a * used), speed * (1 - self._section.speed * used)
