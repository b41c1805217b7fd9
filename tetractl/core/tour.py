"""Way-points, a hold at the targets, and measures of how accurately robots kept to them.

All robots pass their M way-points together: leg j = 0, ..., M - 1 ends when the robots are nearest
to their way-points j + 1, leg M at the targets, and leg M + 1 is the hold.

A robot, for example one that swam away, is lost if it was not tracked for too long.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Sample
from tetractl.core.poses import Bools, Floats, Integers, Observation


@dataclass(frozen=True, slots=True)
class LossRule:
    """A robot that was not tracked for `after_s` is lost, and the trial goes on without it.

    If `replaced`, a body that is tracked again under the robot's name counts as another robot,
    which takes over the lost robot's target.
    """

    after_s: float
    replaced: bool


class Losses:
    """Which of N robots are `lost` (N,) or `left` (N,), new arrays whenever that changes, and how
    often each has been lost, `times` (N,).

    The controller, the log's reader and `verify` all pass every camera frame to `see`, in order,
    and so get the same result. Without a rule no robot is ever lost.
    """

    def __init__(self, rule: LossRule | None, count: int) -> None:
        self._rule = rule
        self.lost: Bools = np.zeros(count, dtype=np.bool_)
        self.left: Bools = ~self.lost
        self.times: Integers = np.zeros(count, dtype=np.int64)
        self._seen_ns: Integers | None = None
        self._waiting = list[Observation]()  # frames that are not yet counted
        self._due_ns = 0  # the earliest time at which a robot can be lost or back

    def see(self, frame: Observation) -> list[int]:
        """Update the losses by the next frame; return the indices of robots replaced in it."""
        if self._rule is None:
            return []
        self._waiting.append(frame)
        if frame.sampled_ns < self._due_ns:
            return []
        after_ns, back = round(self._rule.after_s * SECOND), np.zeros_like(self.lost)
        seen_ns = np.full(len(back), frame.sampled_ns) if self._seen_ns is None else self._seen_ns
        for one in self._waiting:
            gone = self.left & (one.sampled_ns - seen_ns >= after_ns)
            seen_ns[one.valid] = one.sampled_ns
            lost = self.lost | gone
            back = lost & one.valid & self._rule.replaced
            if gone.any() or back.any():
                self.times, self.lost = self.times + gone, lost & ~back
                self.left = ~self.lost
        self._seen_ns = seen_ns
        self._due_ns = int(seen_ns.min()) + after_ns if self.left.all() else 0
        self._waiting.clear()
        return np.flatnonzero(back).tolist()


@dataclass(frozen=True, slots=True)
class HoldTask:
    """The task to stay within `radius` [length unit] of the targets for `seconds`."""

    radius: float
    seconds: float


class TourMeasure:
    """Measures how accurately N robots passed their way-points and held at their targets.

    `legs` (M + 1, N, 2) are the M way-points of each robot and then its target [length unit].

    For each control step, call `step` with its leg and observation, then `add` with its frames;
    frames after `until_ns` are ignored. `loss` is the rule by which a robot is lost.
    """

    def __init__(self, legs: Floats, hold: HoldTask | None, loss: LossRule | None = None) -> None:
        self._legs, self._hold, self._leg = legs, hold, 0
        self._began_ns: int | None = None
        self._inside, self._frames = np.zeros(legs.shape[1], dtype=np.int64), 0
        self._passed: list[float] = []
        self._losses = Losses(loss, legs.shape[1])

    def step(self, leg: int, observation: Observation) -> str:
        """Set the leg of a control step; return a message if a new leg begins, otherwise ""."""
        for past in self._legs[self._leg : min(leg, len(self._legs) - 1)]:
            self._passed.append(float(observation.poses.distances(past).sum()))
        begins, self._leg = leg > self._leg, leg
        if leg == len(self._legs) and self._began_ns is None:
            self._began_ns = observation.sampled_ns
            return "the robots have arrived and hold"
        return f"way-point {leg} of {len(self._legs) - 1} is passed" if begins else ""

    def add(self, samples: Iterable[Sample], until_ns: int | None = None) -> None:
        """Count how often robots are lost and, for each robot, in how many frames of the hold it
        is within the hold's radius of its target, by its true pose if that is known; otherwise a
        robot that is not tracked counts as outside."""
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
        """The sum of the robots' observed distances to each way-point, at the control step in which
        the way-point counts as passed [length unit]."""
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
        """Fraction of the hold's frames in which each robot was within the hold's radius of its
        target, (N,); empty without a hold."""
        return tuple((self._inside / self._frames).tolist()) if self._frames else ()
