"""Random intervals of a trial, for disturbances that act only in some intervals."""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.poses import Bools
from tetractl.spec.base import NonNegative, Positive
from tetractl.spec.disturbance import DisturbanceSection


class SpellsSection(DisturbanceSection):
    """Base class of sections for disturbances that act only in a few random intervals of a trial.

    A subclass defines the disturbance, and calls `draw` for the intervals.
    """

    times: Annotated[int, Field(ge=0, le=1000)] = 1
    """Number of intervals in a trial. They may overlap."""
    duration: Positive
    """Duration of each interval [s]."""
    between: tuple[NonNegative, NonNegative] = (1.0, 14.0)
    """Earliest and latest start of an interval in the trial, uniformly distributed [s]."""

    def draw(self, rng: np.random.Generator) -> "Spells":
        """Sample the intervals of one trial in which the disturbance is active."""
        return Spells(self, rng)


class Spells:
    """The intervals of one trial during which a disturbance acts."""

    def __init__(self, section: SpellsSection, rng: np.random.Generator) -> None:
        self._begin_s = rng.uniform(*section.between, section.times)
        self._end_s = self._begin_s + section.duration

    def include(self, time_s: float) -> bool:
        """Check whether a time since the start of the trial [s] is within one of the intervals."""
        return bool(((self._begin_s <= time_s) & (time_s < self._end_s)).any())


class ByTurns:
    """The state of N robots, each of which alternates between undisturbed and disturbed.

    Each robot does so independently of the others. All are undisturbed (well) at first.

    Args:
        robots: Number of robots.
        well_s: Samples how long a robot is undisturbed [s].
        unwell_s: Samples how long it is disturbed [s].
    """

    def __init__(
        self, robots: int, well_s: Callable[[], float], unwell_s: Callable[[], float]
    ) -> None:
        self._well_s = well_s
        self._unwell_s = unwell_s
        self._well = np.ones(robots, dtype=np.bool_)
        self._until_s = [well_s() for _ in range(robots)]  # when each robot's state changes next

    def well(self, time_s: float) -> Bools:
        """Return which robots are undisturbed at a time of the trial [s], shape (N,).

        A call must not have an earlier time than the call before.
        """
        for i, until_s in enumerate(self._until_s):
            while until_s <= time_s:
                self._well[i] = not self._well[i]
                draw_duration_s = self._well_s if self._well[i] else self._unwell_s
                until_s += draw_duration_s()
                self._until_s[i] = until_s
        return self._well
