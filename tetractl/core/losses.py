"""Find the robots that are lost in a trial: untracked for too long, or dead.

An untracked robot may have swum away. A robot on wheels counts as dead if it stands still while
others drive, for example because its battery is empty. This module finds such robots on all plants,
from camera frames only. The spec's `LossRule` decides what happens then.

    losses = LossTracker(rule, speed)
    replaced = losses.add_frame(frame)      for each frame, in order
    losses.present, losses.dead
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats, Integers, Observation

CHECK_PERIOD_NS = SECOND // 10
"""Time between two camera frames in which the detector looks for stationary robots [ns]."""
STRIDE_MIN_S = 0.05
"""Minimum distance after which a robot counts as having moved, as a time of driving [s]."""
STRIDE_MAX_S = 0.2
"""Maximum distance counted between two checked frames, as a time of driving [s].

A longer distance is a jump of the measured pose.
"""
DEAD_AFTER_S = 5.0
"""Distance that one robot drives until a stationary robot counts as dead [s].

It is measured as a time of driving.
"""


@dataclass(frozen=True, slots=True)
class LossRule:
    """The rule by which a robot counts as lost, and whether the trial then goes on without it.

    Attributes:
        after_s: Time for which a robot must be untracked to be lost [s].
        replaces_lost: Whether a body that is tracked again under a lost robot's name counts as
            another robot, which takes over the lost robot's target.
        includes_dead: Whether a dead robot also counts as lost, although it is tracked. See
            `StandstillDetector`.
        ends_trial: Whether a lost robot ends the trial. Then `LossTracker` marks no robot as lost.
    """

    after_s: float
    replaces_lost: bool
    includes_dead: bool = False
    ends_trial: bool = False


class StandstillDetector:
    """A detector of dead robots, which stand still while another robot drives.

    All robots receive the same commands. A robot that stands still for a long time while another
    robot drives is therefore dead. Camera frames decide this, not commands: if all robots stand
    still, none is dead. Distances are measured as the time in which a robot drives so far at the
    spec's speed. A robot with speed 0 is never dead.

    Args:
        speed: Speeds of the robots [length unit/s], shape (N,).
    """

    def __init__(self, speed: Floats) -> None:
        robot_count = len(speed)
        self.due_ns = 0
        """Time before which camera frames need not be checked [ns]."""
        self._can_drive = speed > 0
        self._speed = np.where(self._can_drive, speed, np.inf)
        self._moved_at = np.full((robot_count, 2), np.nan)
        """Position of each robot when it last moved [length unit], shape (N, 2).

        NaN until the robot has been tracked.
        """
        self._driven_s = np.zeros(robot_count)
        """Distance each robot has travelled, as a time of driving at its speed [s], shape (N,)."""
        self._driven_when_moved_s = np.zeros((robot_count, robot_count))
        """Row i: the entries of `_driven_s` when robot i last moved, shape (N, N) [s]."""

    def add_frame(self, frame: Observation) -> Bools | None:
        """Check in a new camera frame which robots stand still although others drive.

        Returns:
            Which robots have stood still while another one drove for DEAD_AFTER_S, shape (N,). None
            if no robot moved.
        """
        self.due_ns = (frame.sampled_ns // CHECK_PERIOD_NS + 1) * CHECK_PERIOD_NS
        positions = frame.poses.xy
        moved_s = elementwise.hypot(*(positions - self._moved_at).T) / self._speed
        has_moved = frame.valid & ~(moved_s < STRIDE_MIN_S)  # one seen for the first time has
        if not has_moved.any():
            return None
        self._driven_s[has_moved] += np.fmin(moved_s, STRIDE_MAX_S)[has_moved]
        self._moved_at[has_moved] = positions[has_moved]
        self._driven_when_moved_s[has_moved | ~frame.valid] = self._driven_s
        others_drove_s = (self._driven_s - self._driven_when_moved_s).max(axis=1)
        return self._can_drive & (others_drove_s >= DEAD_AFTER_S)


class LossTracker:
    """A tracker of which of N robots are lost or dead in a trial, from frame to frame.

    The controller, the log's reader and `verify` all pass every camera frame to `add_frame`, in
    order, and so get the same result.

    Args:
        rule: The rule by which robots are lost. Without a rule, no robot is ever lost, but the
            tracker still finds dead robots.
        speed: Speeds of the robots [length unit/s], shape (N,).
    """

    def __init__(self, rule: LossRule | None, speed: Floats) -> None:
        robot_count = len(speed)
        self.dead: Bools = np.zeros(robot_count, dtype=np.bool_)
        """Which robots are dead, because they stood still while others drove, shape (N,)."""
        self.lost: Bools = np.zeros(robot_count, dtype=np.bool_)
        """Which robots are lost now, shape (N,)."""
        self.change_count = 0
        """How often the set of lost robots has changed."""
        self.loss_counts: Integers = np.zeros(robot_count, dtype=np.int64)
        """How often each robot has been lost, shape (N,)."""
        self._rule = rule
        self._standstill_detector = StandstillDetector(speed)
        self._tracked_ns: Integers | None = None
        """Time of the last frame in which each robot was tracked [ns], shape (N,).

        None before the first frame.
        """
        self._pending_frames = list[Observation]()
        """Frames that are not evaluated yet, because no robot can become lost or return in them."""
        self._due_ns = 0
        """Earliest time at which a robot can become lost, or a lost robot can return [ns]."""

    @property
    def present(self) -> Bools:
        """True for each robot that is not lost, shape (N,)."""
        return ~self.lost

    def add_frame(self, frame: Observation) -> list[int]:
        """Add the next camera frame, and return the indices of robots that were replaced.

        A lost robot is replaced when it is tracked again, if the rule says so. Without a rule, or
        if a loss ends the trial, only dead robots are found, and the result is empty.
        """
        if frame.sampled_ns >= self._standstill_detector.due_ns:
            self._mark_dead(self._standstill_detector.add_frame(frame))
        if self._rule is None or self._rule.ends_trial:
            return []
        self._pending_frames.append(frame)
        if frame.sampled_ns < self._due_ns:
            return []
        return self._evaluate_waiting(self._rule)

    def _mark_dead(self, dead: Bools | None) -> None:
        """Mark robots as dead, shape (N,).

        Dead robots that are present also become lost if the rule has `includes_dead` and not
        `ends_trial`. None marks no robot.
        """
        if dead is None or not (dead & ~self.dead).any():
            return
        self.dead = self.dead | dead
        if self._rule and self._rule.includes_dead and not self._rule.ends_trial:
            newly_lost = dead & self.present
            self._store_lost(newly_lost, self.lost | newly_lost)

    def _evaluate_waiting(self, rule: LossRule) -> list[int]:
        """Evaluate the pending frames by the rule, and return the indices of replaced robots."""
        after_ns = round(rule.after_s * SECOND)
        tracked_ns = self._tracked_ns
        if tracked_ns is None:
            tracked_ns = np.full(len(self.lost), self._pending_frames[-1].sampled_ns)
        is_back = np.zeros_like(self.lost)
        for frame in self._pending_frames:
            newly_lost = self.present & (frame.sampled_ns - tracked_ns >= after_ns)
            tracked_ns[frame.valid] = frame.sampled_ns
            lost_now = self.lost | newly_lost
            is_back = lost_now & frame.valid & rule.replaces_lost
            if newly_lost.any() or is_back.any():
                self._store_lost(newly_lost, lost_now & ~is_back)
        self._tracked_ns = tracked_ns
        self._due_ns = int(tracked_ns.min()) + after_ns if self.present.all() else 0
        self._pending_frames.clear()
        return np.flatnonzero(is_back).tolist()

    def _store_lost(self, newly_lost: Bools, lost_now: Bools) -> None:
        """Count the newly lost robots, shape (N,), and store which robots are lost now, (N,)."""
        self.loss_counts = self.loss_counts + newly_lost
        self.lost = lost_now
        self.change_count += 1


STOOD_STILL_ENDINGS = "while others drive", "though commanded to move"
"""Endings of a result's reason if a robot stood still: in new logs, and in older logs."""


def describe_dead(names: Sequence[str], dead: Bools) -> str:
    """Describe which robots are dead, for example "A, B do not move while others drive".

    The result is empty if no robot is dead.

    Args:
        names: Names of the robots.
        dead: Which robots are dead, shape (N,).
    """
    dead_names = [name for name, is_dead in zip(names, dead.tolist(), strict=True) if is_dead]
    if not dead_names:
        return ""
    verb = "do" if len(dead_names) > 1 else "does"
    return f"{', '.join(dead_names)} {verb} not move {STOOD_STILL_ENDINGS[0]}"
