"""Random intervals of a trial, for disturbances that act only in some intervals."""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field

from tetractl.core.poses import Bools
from tetractl.spec.base import NonNegative, Positive
from tetractl.spec.disturbance import DisturbanceSection


class IntervalsSection(DisturbanceSection):
    """Base class of sections for disturbances that act only in a few random intervals of a trial.

    A subclass builds its disturbance with the intervals that `draw` returns.
    """

    times: Annotated[int, Field(ge=0, le=1000)] = 1
    """Number of intervals in a trial. They may overlap."""
    duration: Positive
    """Duration of each interval [s]."""
    between: tuple[NonNegative, NonNegative] = (1.0, 14.0)
    """Earliest and latest start of an interval in the trial, uniformly distributed [s]."""

    def draw(self, rng: np.random.Generator) -> "ActiveIntervals":
        """Sample the intervals of one trial in which the disturbance is active."""
        return ActiveIntervals(self, rng)


class ActiveIntervals:
    """The intervals of one trial during which a disturbance acts."""

    def __init__(self, section: IntervalsSection, rng: np.random.Generator) -> None:
        self._starts_s = rng.uniform(*section.between, section.times)
        self._ends_s = self._starts_s + section.duration

    def include(self, time_s: float) -> bool:
        """Check whether a time since the start of the trial [s] lies in one of the intervals."""
        return bool(((self._starts_s <= time_s) & (time_s < self._ends_s)).any())


class AlternatingStates:
    """The states of N robots that alternate independently between undisturbed and disturbed.

    All robots are undisturbed at first.

    Args:
        n_robots: Number of robots.
        draw_undisturbed_s: Function that samples how long a robot is undisturbed [s].
        draw_disturbed_s: Function that samples how long a robot is disturbed [s].
    """

    def __init__(
        self,
        n_robots: int,
        draw_undisturbed_s: Callable[[], float],
        draw_disturbed_s: Callable[[], float],
    ) -> None:
        self._draw_undisturbed_s = draw_undisturbed_s
        self._draw_disturbed_s = draw_disturbed_s
        self._is_undisturbed = np.ones(n_robots, dtype=np.bool_)
        self._change_times_s = [
            draw_undisturbed_s() for _ in range(n_robots)
        ]  # when each robot's state changes next

    def advance(self, time_s: float) -> Bools:
        """Advance all robots to a time, and return which of them are then undisturbed, shape (N,).

        Args:
            time_s: Time since the start of the trial [s], not earlier than in the previous call.
        """
        for i, change_s in enumerate(self._change_times_s):
            while change_s <= time_s:
                self._is_undisturbed[i] = not self._is_undisturbed[i]
                draw_duration_s = (
                    self._draw_undisturbed_s if self._is_undisturbed[i] else self._draw_disturbed_s
                )
                change_s += draw_duration_s()
                self._change_times_s[i] = change_s
        return self._is_undisturbed
