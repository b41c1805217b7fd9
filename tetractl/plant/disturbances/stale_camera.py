"""`{type: stale-camera}`: the camera shows old poses for a while, with the times of new ones."""

from collections import deque
from typing import Literal

import numpy as np

from tetractl.core.poses import Bools, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Positive
from tetractl.experiment.disturbance import Disturbance
from tetractl.plant.disturbances.spells import Spells, SpellsSection


class StaleCameraSection(SpellsSection):
    """Spells in which frames hold poses of some time ago."""

    type: Literal["stale-camera"]
    age: Positive = 0.1
    """How old the poses are [s]; at the start the oldest there are."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "StaleCamera":
        """Return the intervals of one trial."""
        return StaleCamera(self.age, self.draw(rng))


class StaleCamera(Disturbance):
    """Keeps what was measured, and shows it `age_s` later while a spell is on."""

    def __init__(self, age_s: float, spells: Spells) -> None:
        self._age_s, self._spells = age_s, spells
        self._kept: deque[tuple[float, Poses, Bools]] = deque()

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the newest poses that are `age_s` old or older, in a spell."""
        self._kept.append((time_s, poses, valid))
        while len(self._kept) > 1 and self._kept[1][0] <= time_s - self._age_s:
            self._kept.popleft()
        return self._kept[0][1:] if self._spells.at(time_s) else (poses, valid)
