"""`{type: frozen-camera}`: for some time the camera repeats its last picture, or sends none."""

from typing import Literal

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import Disturbance
from tetractl.plant.disturbances.spells import Spells, SpellsSection


class FrozenCameraSection(SpellsSection):
    """Intervals in which every frame repeats the last one before, or none comes."""

    type: Literal["frozen-camera"]
    repeats: bool = True
    """Whether frames repeat the last picture as a new one; else no frame reaches the host."""

    @property
    def loses_frames(self) -> bool:
        """Whether frames stop coming."""
        return not self.repeats

    def build(self, setup: Setup, rng: np.random.Generator) -> "FrozenCamera":
        """Return the intervals of one trial."""
        return FrozenCamera(self.repeats, self.draw(rng))


class FrozenCamera(Disturbance):
    """Repeats, or loses, the frames of an interval."""

    def __init__(self, repeats: bool, spells: Spells) -> None:
        self._repeats, self._spells = repeats, spells
        self._last: tuple[Poses, Bools] | None = None

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the last picture before the interval while one is on."""
        if self._last is None or not (self._repeats and self._spells.at(time_s)):
            self._last = poses, valid
        return self._last

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the time of arrival unchanged, None for a frame that does not come."""
        lost = not self._repeats and self._spells.at(exposed_ns / SECOND)
        return None if lost else received_ns
