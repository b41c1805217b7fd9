"""Measure how accurately robots pass their way-points and stay at their targets.

All robots pass their M way-points together. Leg j = 0, ..., M - 1 ends when the robots are nearest
to their way-points j + 1. Leg M ends at the targets, and leg M + 1 is the hold.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tetractl.core.losses import LossRule, LossTracker
from tetractl.core.poses import Bools, Floats, Observation, Sample


@dataclass(frozen=True, slots=True)
class HoldTask:
    """The task to stay within `radius` [length unit] of the targets for `seconds`."""

    radius: float
    seconds: float


class RouteMeasure:
    """A measurement of how accurately N robots pass their way-points and hold at their targets.

    For each control step, call `record_step` with its leg and observation, then `add_samples` with
    its camera frames.

    Args:
        legs: The M way-points of each robot and then its target [length unit], shape (M + 1, N, 2).
        hold: The task at the targets. None if there is none.
        loss: The rule by which a robot is lost. None if no robot can be lost.
        speed: Speeds of the robots [length unit/s], shape (N,).
    """

    def __init__(
        self, legs: Floats, hold: HoldTask | None, loss: LossRule | None, speed: Floats
    ) -> None:
        self.losses = LossTracker(loss, speed)
        """The tracker of which robots are lost and which are dead."""
        self._legs = legs
        self._hold = hold
        self._leg = 0
        self._hold_began_ns: int | None = None
        """Time of the trial at which the hold began [ns]. None before that."""
        self._passed: list[float] = []
        self._hold_frames = 0
        """Number of camera frames since the hold began."""
        self._frames_inside = np.zeros(legs.shape[1], dtype=np.int64)
        """Number of `_hold_frames` in which each robot was within the hold's radius, shape (N,)."""

    def record_step(self, leg: int, observation: Observation) -> str:
        """Record the leg of a control step, and describe a new leg for the operator.

        Args:
            leg: Number of way-points passed. During the hold, one more than there are way-points.
            observation: The observation of the control step.

        Returns:
            The message for the operator. Empty if no new leg begins.
        """
        way_point_count = len(self._legs) - 1
        for way_point in self._legs[self._leg : min(leg, way_point_count)]:
            distances = observation.poses.distances(way_point)
            self._passed.append(float(distances.sum()))
        begins_leg = leg > self._leg
        self._leg = leg
        if leg == len(self._legs) and self._hold_began_ns is None:
            self._hold_began_ns = observation.sampled_ns
            return "the robots have arrived and hold"
        return f"way-point {leg} of {way_point_count} is passed" if begins_leg else ""

    def add_samples(self, samples: Iterable[Sample], until_ns: int | None = None) -> None:
        """Add the camera frames that arrived in a control step.

        Args:
            samples: The frames.
            until_ns: Time after which frames are ignored [ns]. None to use all frames.
        """
        for sample in samples:
            if until_ns and sample.observation.sampled_ns > until_ns:
                continue
            self.losses.add_frame(sample.observation)
            if self._hold is None or self._hold_began_ns is None:
                continue
            if sample.observation.sampled_ns >= self._hold_began_ns:
                self._hold_frames += 1
                self._frames_inside += self._are_inside(sample, self._hold.radius)

    def _are_inside(self, sample: Sample, radius: float) -> Bools:
        """Check which robots are within a radius [length unit] of their targets, shape (N,).

        True poses are used if they are known. Otherwise, an untracked robot counts as outside.
        """
        targets = self._legs[-1]
        if sample.truth:
            return sample.truth.distances(targets) <= radius
        observation = sample.observation
        return (observation.poses.distances(targets) <= radius) & observation.valid

    @property
    def passed(self) -> tuple[float, ...]:
        """The sum of the robots' observed distances to each way-point passed [length unit].

        It is measured at the control step in which the way-point counts as passed.
        """
        return tuple(self._passed)

    @property
    def dead_not_lost(self) -> Bools:
        """Which robots are dead but do not count as lost, shape (N,)."""
        return self.losses.dead & self.losses.present

    @property
    def lost(self) -> tuple[int, ...]:
        """How often each robot was lost, N entries. Empty if no robot was lost."""
        loss_counts = self.losses.loss_counts
        return tuple(loss_counts.tolist()) if loss_counts.any() else ()

    @property
    def inside(self) -> tuple[float, ...]:
        """Fraction of the hold's frames in which each robot was near its target, N entries.

        Near means within the hold's radius. The result is empty if there was no hold.
        """
        if self._hold_frames == 0:
            return ()
        return tuple((self._frames_inside / self._hold_frames).tolist())
