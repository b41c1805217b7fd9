"""`{type: wander}`: a and speed of each robot wander during a trial."""

from typing import Literal

import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.experiment.base import NonNegative, Positive
from tetractl.experiment.disturbance import Disturbance, DisturbanceSection


class WanderSection(DisturbanceSection):
    """Relative errors of a and speed that change slowly, independently for each robot and quantity.
    Their logarithms are stationary Ornstein-Uhlenbeck processes.
    """

    type: Literal["wander"]
    a: NonNegative = 0.0
    """Standard deviation of ln a."""
    speed: NonNegative = 0.0
    """Standard deviation of ln speed."""
    time: Positive = 5.0
    """Correlation time of the errors [s]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "Wander":
        """Return the errors of one trial."""
        return Wander(self, len(setup.names), rng)


class Wander(Disturbance):
    """Draws the errors at each requested time; their statistics do not depend on the frame rate."""

    def __init__(self, section: WanderSection, robots: int, rng: np.random.Generator) -> None:
        self._size = np.array([[section.a], [section.speed]])
        self._time_s, self._rng = section.time, rng
        self._state = rng.standard_normal((2, robots))
        self._last_s = 0.0

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return a and speed with the errors of this time."""
        kept = np.exp(-(time_s - self._last_s) / self._time_s)
        self._last_s = time_s
        drawn = self._rng.standard_normal(self._state.shape)
        self._state = kept * self._state + np.sqrt(1 - kept**2) * drawn
        in_a, in_speed = np.exp(self._size * self._state)
        return a * in_a, speed * in_speed
