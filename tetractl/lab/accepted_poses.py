"""The poses of one robot that the guard has accepted, and why a new pose cannot be the robot's.

A pose is wrong if the body is not upright on the floor. While robots may drive, it is also wrong if
the robot cannot have come there: after a time dt since each pose that is remembered, which are the
last one and some of the last second,

    distance <= FASTER speed dt + jump,    angle <= FASTER turning dt + jump_heading.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

import math
from collections import deque
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose

FASTER = 2.0
"""Multiple of a robot's speed and turning limits above which its pose jumped."""
REMEMBERED_NS = SECOND
"""Largest age of the accepted poses with which a new one is compared."""
JUMP_SPACING_NS = SECOND // 50
"""Least time between two of these: FASTER times a robot's way in it is what a pose may jump by in
addition, because up to so much time lies between a pose that is remembered and one that is not."""
JUMPED = "its pose jumped"


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of a robot's motion: the greatest `speed` [length unit/s] and `turning` [rad/s].

    `jump` [length unit] and `jump_heading` [rad] are what a pose may differ by in no time. `lowest`
    and `highest` bound the height of the body [length unit], `tilt` its angle to the vertical
    [rad]; `mm` is the number of millimetres per length unit.
    """

    speed: float
    turning: float
    jump: float
    jump_heading: float
    lowest: float = -math.inf
    highest: float = math.inf
    tilt: float = math.pi
    mm: float = 1.0


@dataclass(frozen=True, slots=True)
class TimedPose:
    """A pose and the time of its exposure."""

    exposed_ns: int
    pose: Pose


@dataclass(slots=True)
class AcceptedPoses:
    """The `last` accepted pose of a robot, exposed at `last_ns`; None, at 0, before the first."""

    limits: MotionLimits
    last: Pose | None = None
    last_ns: int = 0
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

    def forget_the_past(self) -> None:
        """Compare new poses with the last one only: before it the robot may have been carried."""
        self._remembered.clear()
        if self.last is not None:
            self._remembered.append(TimedPose(self.last_ns, self.last))

    def fault(self, pose: Pose, exposed_ns: int, driving: bool) -> str:
        """Return why a pose cannot be the robot's, "" if it can.

        Robots that are not `driving` may be carried: only height and tilt are checked.
        """
        fault = self._off_the_floor(pose)
        if not fault and driving and self._jumps(pose, exposed_ns):
            return JUMPED
        return fault

    def _off_the_floor(self, pose: Pose) -> str:
        """Return why a body's height or tilt is wrong for a robot on the floor; "" if both fit."""
        limits = self.limits
        if pose.height is not None and not limits.lowest <= pose.height <= limits.highest:
            return f"its body is at a height of {pose.height * limits.mm:.0f} mm"
        if pose.tilt is not None and not pose.tilt <= limits.tilt:
            return f"its body is tilted by {pose.tilt:.2f} rad"
        return ""

    def _jumps(self, pose: Pose, exposed_ns: int) -> bool:
        """Return whether the robot cannot have come to `pose` from a pose that is remembered."""
        if self.last is None:
            return False
        limits = self.limits
        fastest = FASTER * limits.speed
        fastest_turning = FASTER * limits.turning
        for earlier in (*self._remembered, TimedPose(self.last_ns, self.last)):
            dt_s = (exposed_ns - earlier.exposed_ns) / SECOND
            distance = math.hypot(pose.x - earlier.pose.x, pose.y - earlier.pose.y)
            if distance > fastest * dt_s + limits.jump:
                return True
            angle = abs(math.remainder(pose.heading - earlier.pose.heading, math.tau))
            if angle > fastest_turning * dt_s + limits.jump_heading:
                return True
        return False
