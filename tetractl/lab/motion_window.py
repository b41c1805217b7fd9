"""Compares the motion of one robot with its bounds, over several times of about the last second.

A motion has three parts: the displacement along the robot's heading, that across it, and the angle
turned around. Arrays (3,) hold them in this order. Times are ns on the run's clock. `motion_check`
says what the bounds are.

Each consistent pose may become a *moment*, since which later motion is compared. Few poses
contradict anything, so there is a quick comparison with all moments at once, which nearly all pass.
Let M be the motion since the robot started from rest, L the integral of its least rate, and M_k and
L_k their values at a moment k. The motion since then is below its bound by more than the slack if

    M - M_k < L - L_k - slack,    which is    (M - L) - (M_k - L_k) < -slack.

If this holds for any moment, it holds for that of the greatest M_k - L_k: only this value need be
kept. Likewise, the upper bound only needs the least value of M_k less the integral of the greatest
rate. Both are kept for each part of the motion.
"""

from collections import deque
from dataclasses import dataclass
from typing import Self

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats

COMPARED_NS = SECOND
"""Age up to which a moment is kept."""
SPACING_NS = SECOND // 20
"""Least time between two moments."""
ROUNDING = 1e-9
"""Share of the slack by which the quick comparison allows less than the exact one: far more than
numbers are rounded by, so that the quick one misses nothing."""


@dataclass(frozen=True, slots=True)
class BoundedMotion:
    """A robot's motion (3,) over some time, and the least and the greatest (3,) that its commands
    allow in that time."""

    travelled: Floats
    least: Floats
    most: Floats

    def since(self, earlier: "BoundedMotion") -> "BoundedMotion":
        """Return what was added since an earlier moment; both count from the same start."""
        return BoundedMotion(
            self.travelled - earlier.travelled,
            self.least - earlier.least,
            self.most - earlier.most,
        )

    def out_of_bounds(self, slack: Floats) -> Bools:
        """Return which parts (3,) are out of their bounds by more than `slack` (3,)."""
        return (self.travelled < self.least - slack) | (self.travelled > self.most + slack)


@dataclass(frozen=True, slots=True)
class MotionMoment:
    """The time of a pose, and its robot's motion until then since it started from rest, with the
    integrals of its bounds. `above_least` and `above_most` (3,) are the motion less either
    integral.
    """

    at_ns: int
    motion: BoundedMotion
    above_least: list[float]
    above_most: list[float]

    @classmethod
    def of(cls, at_ns: int, motion: BoundedMotion) -> Self:
        """Return the moment of a motion."""
        above_least = (motion.travelled - motion.least).tolist()
        above_most = (motion.travelled - motion.most).tolist()
        return cls(at_ns, motion, above_least, above_most)


class MotionWindow:
    """The moments of one robot, oldest first, SPACING_NS apart or more; `slack` (3,) is by how much
    motion may be out of its bounds.

    Moments older than COMPARED_NS are dropped when a consistent pose is added. This is after it was
    compared: the first pose after a gap is compared with older moments too.
    """

    def __init__(self, slack: Floats) -> None:
        self._slack = slack
        self._quick_slack: list[float] = ((1.0 - ROUNDING) * slack).tolist()
        self._moments: deque[MotionMoment] = deque()
        # extremes (3,) of all moments; they mean nothing while there is none
        self._max_above_least: list[float] = []
        self._min_above_most: list[float] = []

    @property
    def empty(self) -> bool:
        """Whether there is no moment."""
        return not self._moments

    def clear(self) -> None:
        """Drop all moments."""
        self._moments.clear()

    def add(self, now: MotionMoment) -> None:
        """Make a consistent pose a moment unless the newest one is too young; drop those that are
        too old."""
        moments = self._moments
        has_changed = False
        if not moments or now.at_ns - moments[-1].at_ns >= SPACING_NS:
            moments.append(now)
            has_changed = True
        while now.at_ns - moments[0].at_ns > COMPARED_NS:  # the newest is younger: it stays
            moments.popleft()
            has_changed = True
        if has_changed:
            above_least = [moment.above_least for moment in moments]
            above_most = [moment.above_most for moment in moments]
            self._max_above_least = [max(part) for part in zip(*above_least, strict=True)]
            self._min_above_most = [min(part) for part in zip(*above_most, strict=True)]

    def contradiction(self, now: MotionMoment) -> BoundedMotion | None:
        """Return the motion since the newest moment since which it is out of its bounds by more
        than the slack; None if there is no such moment."""
        if self.empty or not self._may_contradict(now):
            return None
        for moment in reversed(self._moments):
            since = now.motion.since(moment.motion)
            if since.out_of_bounds(self._slack).any():
                return since
        return None

    def _may_contradict(self, now: MotionMoment) -> bool:
        """Return whether motion since any moment may be out of its bounds by more than the slack;
        if False, it is not."""
        for part, slack in enumerate(self._quick_slack):
            if now.above_least[part] - self._max_above_least[part] < -slack:
                return True
            if now.above_most[part] - self._min_above_most[part] > slack:
                return True
        return False
