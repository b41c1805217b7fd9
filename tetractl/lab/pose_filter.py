"""Why a camera's pose cannot be a robot's: the body is not upright on the floor or, while robots
may drive, could not come there from its poses of the last second; and how long a robot was unseen.
The guard decides which poses it accepts.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

import math
from collections import deque
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose

FASTER = 2.0  # multiple of a robot's speed and turning limits above which its pose jumped
WINDOW_NS = SECOND  # largest age of accepted poses with which a pose is compared


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of a robot's motion: the greatest `speed` [length unit/s] and `turning` [rad/s].

    A pose may differ from an earlier one by motion at `FASTER` times these limits, plus `jump`
    [length unit] and `jump_heading` [rad]. `lowest` and `highest` bound the height of the body
    [length unit], `tilt` its angle to the vertical [rad]; `mm` is the number of millimetres per
    length unit.
    """

    speed: float
    turning: float
    jump: float
    jump_heading: float
    lowest: float = -math.inf
    highest: float = math.inf
    tilt: float = math.pi
    mm: float = 1.0


@dataclass(slots=True)
class PoseFilter:
    """The accepted poses of one robot: the last pose, and some poses of the last second.

    `refused` is why the newest pose was refused, "" if it was accepted or missing.
    """

    limits: MotionLimits
    pose: Pose | None = None
    seen_ns: int = 0
    refused: str = ""
    # time of the runs without a recent pose, less a part of their time with one
    unseen_ns: float = 0.0
    _frame_ns: int = 0  # time of the newest frame
    _past: deque[tuple[int, Pose]] = field(default_factory=deque)

    def forget(self) -> None:
        """Forget all poses except the last; called before a run, since robots were carried."""
        self._past = deque([(self.seen_ns, self.pose)] if self.pose is not None else [])
        self.refused, self._frame_ns = "", self.seen_ns

    def frame(self, now_ns: int, stale_ns: float) -> None:
        """Take the time of a frame of a run, before its pose; a pose is recent for `stale_ns`."""
        unseen_ns = max(0.0, now_ns - max(self._frame_ns, self.seen_ns + stale_ns))
        seen_ns = now_ns - self._frame_ns - unseen_ns
        # a quarter of the time seen is taken off the time unseen
        self.unseen_ns = max(0.0, self.unseen_ns + unseen_ns - 0.25 * seen_ns)
        self._frame_ns = now_ns

    def lost(self) -> None:
        """Note that the robot is not tracked in the newest frame."""
        self.refused = ""

    def fault(self, pose: Pose, at_ns: int, driving: bool) -> str:
        """Return why a pose exposed at `at_ns` cannot be the robot's, "" if it can.

        Robots that are not `driving` may be carried: only height and tilt are checked.
        """
        fault = self._off_the_floor(pose)
        return "its pose jumped" if not fault and driving and self._jumps(pose, at_ns) else fault

    def add(self, pose: Pose, at_ns: int, refused: str) -> bool:
        """Take a pose exposed at `at_ns`, unless `refused` says why not; return whether it is
        accepted.
        """
        self.refused = refused
        if self.refused:
            return False
        self.pose, self.seen_ns = pose, at_ns
        while self._past and at_ns - self._past[0][0] > WINDOW_NS:
            self._past.popleft()
        if not self._past or at_ns - self._past[-1][0] >= SECOND // 10:
            self._past.append((at_ns, pose))
        return True

    def _jumps(self, pose: Pose, at_ns: int) -> bool:
        """Return whether the robot cannot have reached `pose` from earlier poses in the window."""
        if self.pose is None:
            return False
        limits, x, y, heading = self.limits, pose.x, pose.y, pose.heading
        for then_ns, then in (*self._past, (self.seen_ns, self.pose)):
            dt = (at_ns - then_ns) / SECOND
            gone = math.hypot(x - then.x, y - then.y)
            turned = abs(math.remainder(heading - then.heading, math.tau))
            if (
                gone > FASTER * limits.speed * dt + limits.jump
                or turned > FASTER * limits.turning * dt + limits.jump_heading
            ):
                return True
        return False

    def _off_the_floor(self, pose: Pose) -> str:
        """Return why a body's height or tilt is wrong for a robot on the floor; "" if both fit."""
        limits = self.limits
        if pose.height is not None and not limits.lowest <= pose.height <= limits.highest:
            return f"its body is at a height of {pose.height * limits.mm:.0f} mm"
        if pose.tilt is not None and not pose.tilt <= limits.tilt:
            return f"its body is tilted by {pose.tilt:.2f} rad"
        return ""
