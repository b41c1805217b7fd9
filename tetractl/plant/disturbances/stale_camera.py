"""`{type: stale-camera}`: for some time the camera shows old poses with new times."""

from collections import deque
from typing import Literal

import numpy as np

from tetractl.core.poses import Bools, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Positive
from tetractl.experiment.disturbance import Disturbance
from tetractl.plant.disturbances.spells import Spells, SpellsSection


class StaleCameraSection(SpellsSection):
    """Intervals in which frames hold old poses."""

    type: Literal["stale-camera"]
    age: Positive = 0.1
    """Age of the poses [s]; early in the trial, that of the oldest ones."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "StaleCamera":
        """Return the intervals of one trial."""
        return StaleCamera(self.age, self.draw(rng))


class StaleCamera(Disturbance):
    """Keeps the measurements, and shows them `age_s` later while an interval is on."""

    def __init__(self, age_s: float, spells: Spells) -> None:
        self._age_s, self._spells = age_s, spells
        self._kept: deque[tuple[float, Poses, Bools]] = deque()

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses; in an interval, the newest that are at least `age_s` old."""
        self._kept.append((time_s, poses, valid))
        while len(self._kept) > 1 and self._kept[1][0] <= time_s - self._age_s:
            self._kept.popleft()
        return self._kept[0][1:] if self._spells.at(time_s) else (poses, valid)
