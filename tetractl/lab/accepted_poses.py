"""The poses of one robot that the guard has accepted, and why a new pose cannot be the robot's.

A pose is wrong if the body is not upright on the floor. Once a run has begun, it is also wrong if
the body is not as high as when the run began, within LIFTED_MM: somebody has lifted the robot, or
set it down. And it is wrong if the robot cannot have come there: after a time dt since each pose
that is remembered, which are the last one and some of the last second,

    distance <= FASTER speed dt + jump,    angle <= FASTER turning dt + JUMP_HEADING.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

import math
import statistics
from collections import deque
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.lab.guard_records import GuardRules

JUMP_HEADING = 0.7
"""A heading may differ by so much in no time [rad], as `jump_mm` of the limits says it of a
position."""
FASTER = 2.0
"""Multiple of a robot's speed and turning limits above which its pose jumped."""
REMEMBERED_NS = SECOND
"""Largest age of the accepted poses with which a new one is compared."""
JUMP_SPACING_NS = SECOND // 50
"""Least time between two of these: FASTER times a robot's way in it is what a pose may jump by in
addition, because up to so much time lies between a pose that is remembered and one that is not."""
JUMPED = "its pose jumped"
LIFTED_MM = 40.0
"""By how much a body may be higher or lower than when the run began [mm]: a floor that is 1 degree
off the camera's zero makes 35 mm of 2 m, and heights of a webcam's tags are off by up to 16 mm."""
HEIGHT_NS = SECOND // 4
"""Time before a run begins over which a body's height is measured: robots stand then."""


@dataclass(frozen=True, slots=True)
class TimedPose:
    """A pose and the time of its exposure."""

    exposed_ns: int
    pose: Pose


@dataclass(slots=True)
class AcceptedPoses:
    """The `last` accepted pose of robot `i` of the rules, exposed at `last_ns`; None, at 0, before
    the first."""

    rules: GuardRules
    i: int
    last: Pose | None = None
    last_ns: int = 0
    _height: float | None = None  # when the run began; None if the camera measures none
    _remembered: deque[TimedPose] = field(default_factory=deque)  # oldest first

    def accept(self, pose: Pose, exposed_ns: int) -> None:
        """Take a pose that was exposed after the last one."""
        self.last = pose
        self.last_ns = exposed_ns
        remembered = self._remembered
        while remembered and exposed_ns - remembered[0].exposed_ns > REMEMBERED_NS:
            remembered.popleft()
        if not remembered or exposed_ns - remembered[-1].exposed_ns >= JUMP_SPACING_NS:
            remembered.append(TimedPose(exposed_ns, pose))

    def start_run(self) -> None:
        """Compare new poses with the last one only, before which the robot may have been carried,
        and with the height at which the body is now."""
        heights = [
            earlier.pose.height
            for earlier in self._remembered
            if self.last_ns - earlier.exposed_ns <= HEIGHT_NS and earlier.pose.height is not None
        ]
        self._height = statistics.median(heights) if heights else None
        self._remembered.clear()
        if self.last is not None:
            self._remembered.append(TimedPose(self.last_ns, self.last))

    def fault(self, pose: Pose, exposed_ns: int, driving: bool) -> str:
        """Return why a pose cannot be the robot's, "" if it can.

        Robots that are not `driving` may be carried: only the limits of height and tilt are
        checked.
        """
        fault = self._off_the_floor(pose)
        if fault or not driving:
            return fault
        return self._lifted(pose) or (JUMPED if self._jumps(pose, exposed_ns) else "")

    def _off_the_floor(self, pose: Pose) -> str:
        """Return why a body's height or tilt is wrong for a robot on the floor; "" if both fit."""
        mm = self.rules.mm
        lowest_mm, highest_mm = self.rules.limits.height_mm
        if pose.height is not None and not lowest_mm / mm <= pose.height <= highest_mm / mm:
            return f"its body is at a height of {pose.height * mm:.0f} mm"
        if pose.tilt is not None and not pose.tilt <= self.rules.limits.tilt:
            return f"its body is tilted by {pose.tilt:.2f} rad"
        return ""

    def _lifted(self, pose: Pose) -> str:
        """Return how much higher or lower the body is than when the run began, "" if it is not."""
        if pose.height is None or self._height is None:
            return ""
        higher_mm = (pose.height - self._height) * self.rules.mm
        if higher_mm > LIFTED_MM:
            return f"its body is {higher_mm:.0f} mm higher than at the start: was it lifted?"
        if higher_mm < -LIFTED_MM:
            return f"its body is {-higher_mm:.0f} mm lower than at the start: was it set down?"
        return ""

    def _jumps(self, pose: Pose, exposed_ns: int) -> bool:
        """Return whether the robot cannot have come to `pose` from a pose that is remembered."""
        if self.last is None:
            return False
        jump = self.rules.limits.jump_mm / self.rules.mm
        fastest = FASTER * self.rules.speeds[self.i]
        fastest_turning = FASTER * self.rules.turning[self.i]
        for earlier in (*self._remembered, TimedPose(self.last_ns, self.last)):
            dt_s = (exposed_ns - earlier.exposed_ns) / SECOND
            distance = math.hypot(pose.x - earlier.pose.x, pose.y - earlier.pose.y)
            if distance > fastest * dt_s + jump:
                return True
            angle = abs(math.remainder(pose.heading - earlier.pose.heading, math.tau))
            if angle > fastest_turning * dt_s + JUMP_HEADING:
                return True
        return False
