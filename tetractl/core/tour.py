"""Way-points and a hold, and measures of how well the robots kept to them.

All robots pass their way-points together: leg j ends when the robots are nearest to their j-th
way-points, and the last leg at the targets. Leg M + 1, after M way-points, is the hold.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tetractl.core.commands import Sample
from tetractl.core.losses import Losses, LossRule
from tetractl.core.poses import Floats, Observation


@dataclass(frozen=True, slots=True)
class HoldTask:
    """The task to stay within `radius` [length unit] of the targets for `seconds`."""

    radius: float
    seconds: float


class TourMeasure:
    """Measures how N robots passed `legs` (M + 1, N, 2), their way-points and targets, and held.

    `step` is called with each control step's leg and observation, before that step's frames, which
    `add` counts up to `until_ns`; the true poses are used if known. `loss` is the rule by which a
    robot is lost.
    """

    def __init__(self, legs: Floats, hold: HoldTask | None, loss: LossRule | None = None) -> None:
        self._legs, self._hold, self._leg = legs, hold, 0
        self._began_ns: int | None = None
        self._inside, self._frames = np.zeros(legs.shape[1], dtype=np.int64), 0
        self._passed: list[float] = []
        self._losses = Losses(loss, legs.shape[1])

    def step(self, leg: int, observation: Observation) -> str:
        """Take the leg of a control step; return a text that announces a new leg, otherwise ""."""
        for past in self._legs[self._leg : min(leg, len(self._legs) - 1)]:
            self._passed.append(float(observation.poses.distances(past).sum()))
        begins, self._leg = leg > self._leg, leg
        if leg == len(self._legs) and self._began_ns is None:
            self._began_ns = observation.sampled_ns
            return "the robots have arrived and hold"
        return f"way-point {leg} of {len(self._legs) - 1} is passed" if begins else ""

    def add(self, samples: Iterable[Sample], until_ns: int | None = None) -> None:
        """Count lost robots and the frames of the hold, in which an untracked robot counts as
        outside.
        """
        for one in samples:
            seen = one.observation
            if until_ns and seen.sampled_ns > until_ns:
                continue
            self._losses.see(seen)
            if self._hold is None or self._began_ns is None or seen.sampled_ns < self._began_ns:
                continue
            near = (one.truth or seen.poses).distances(self._legs[-1]) <= self._hold.radius
            self._inside += near if one.truth else near & seen.valid
            self._frames += 1

    @property
    def passed(self) -> tuple[float, ...]:
        """The sum of distances at each way-point passed, as observed [length unit]."""
        return tuple(self._passed)

    @property
    def gone(self) -> tuple[bool, ...]:
        """Whether each robot is lost at the end, (N,)."""
        return tuple(self._losses.lost.tolist())

    @property
    def lost(self) -> tuple[int, ...]:
        """How often each robot was lost, (N,); empty if none ever was."""
        times = self._losses.times
        return tuple(times.tolist()) if times.any() else ()

    @property
    def inside(self) -> tuple[float, ...]:
        """Share of the hold's frames in which each robot was within the radius, (N,); empty without
        frames.
        """
        return tuple((self._inside / self._frames).tolist()) if self._frames else ()
