"""The guard's memory of one robot, from which it decides whether a new pose can be that robot's.

A pose is refused if the body is not upright on the floor. Once a run has begun, it is also refused
if the height of the body has changed by more than LIFTED_MM since the beginning, because somebody
has lifted the robot or set it down. And it is refused if the robot cannot have come there from a
remembered pose: the last one, and some of the last second (`lab.kernel.check_speed`).

Lengths are in the spec's length unit. Times are in ns on the run's clock.
"""

import statistics
from collections import deque
from dataclasses import dataclass, field

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Excess, Finding, Refuse
from tetractl.core.poses import Pose
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import check_speed
from tetractl.spec.lab_section import UNTRACKED_STOP_S

FORGIVEN_FRACTION = 0.25
"""Fraction of the time in which a robot is seen that cancels earlier time unseen."""
REMEMBERED_NS = SECOND
"""Maximum age of the accepted poses with which a new pose is compared [ns]."""
JUMP_SPACING_NS = SECOND // 50
"""Minimum time between two remembered poses.

A pose may additionally jump by `SPEED_FACTOR` times the robot's path in this time, because a new
pose may be this much later than the one remembered.
"""
POSE_JUMPED = "its pose jumped"
LIFTED_MM = 40.0
"""Maximum change of a body's height since the start of the run [mm].

A floor that is 1 degree off the camera's zero changes the height by 35 mm over 2 m, and heights of
a webcam's tags are off by up to 16 mm.
"""
HEIGHT_NS = SECOND // 4
"""Time before a run over which a body's height is averaged, while robots stand still [ns]."""


@dataclass(frozen=True, slots=True)
class PoseDecision:
    """The guard's decision on a new pose of a robot: whether it is accepted and, if not, why.

    Attributes:
        accepted: The pose if it is accepted. None otherwise.
        refusal: Why it is refused. Empty if it is accepted, or if there is no pose.
        disobeys: Whether it is refused because the robot disobeys.
        findings: Further findings of the guard's checks.
        excess: The value that led to the refusal. None if the reason has no number.
    """

    accepted: Pose | None = None
    refusal: str = ""
    disobeys: bool = False
    findings: tuple[Finding, ...] = ()
    excess: Excess | None = None


MISSING = PoseDecision()
"""The decision if a frame contains no pose of the robot."""


@dataclass(slots=True)
class RobotTrack:
    """The guard's memory of one robot: its last poses, and since when it is untracked.

    A body that replaces a lost robot gets its own track.
    """

    name: str
    rules: GuardRules
    index: int
    """Index of the robot."""
    last_pose: Pose | None = None
    """The last accepted pose of the robot. None before the first."""
    last_pose_ns: int = 0
    """When that pose was exposed [ns]. 0 before the first."""
    newest_frame_ns: int = 0
    """When the newest frame was exposed [ns]. 0 before the first.

    Everything below refers to this time.
    """
    newest_pose_ns: int = 0
    """Time of the robot's pose in the newest frame [ns].

    If the frame does not show the robot, it is the time of the last accepted pose.
    """
    is_new: bool = True
    """Whether the robot's pose in the newest frame, if there is one, is a new measurement."""
    unseen_ns: float = 0.0
    """How long the robot was unseen in runs [ns], minus a part of the time it was seen.

    This part is FORGIVEN_FRACTION.
    """
    _counted_ns: int = 0
    """Time up to which `unseen_ns` is counted [ns]."""
    decision: PoseDecision = MISSING
    """The guard's decision on the robot's newest pose."""
    ghost_reason: str = ""
    """Why all further poses of the robot are refused. Empty if they are not."""
    lost_ns: int | None = None
    """When the robot was last seen before it was lost [ns]. None if it is not lost."""
    pause_motion: str = ""
    """How the robot was first seen to move in a pause. Empty if it was not."""
    _height: float | None = None
    """Height of the robot's body at the start of the run [length unit]. None if unknown."""
    _remembered: deque[TimedPose] = field(default_factory=deque)
    """Accepted poses that a new pose is compared with, oldest first."""

    @property
    def is_lost(self) -> bool:
        """Whether the robot is lost, so that the run continues without it."""
        return self.lost_ns is not None

    @property
    def untracked_ns(self) -> int:
        """How much older the last accepted pose of the robot is than the newest frame [ns]."""
        return self.newest_frame_ns - self.last_pose_ns

    @property
    def untracked_message(self) -> str:
        """A message that the robot is not tracked, for how long and, if known, why."""
        reason = f": {self.decision.refusal}" if self.decision.refusal else ""
        return f"{self.name} is not tracked{reason} (for {self.untracked_ns / SECOND:.2f} s)"

    @property
    def is_hidden(self) -> bool:
        """Whether no pose was accepted for so long that the robot must stop."""
        return self.untracked_ns > UNTRACKED_STOP_S * SECOND

    @property
    def is_tracked(self) -> bool:
        """Whether the robot has a recent accepted pose and is not lost, so that it may move."""
        return self.last_pose is not None and not self.is_lost and not self.is_hidden

    def start_run(self) -> None:
        """Forget how the robot moved before a run, because it may have been carried.

        After this, new poses are compared only with the last pose, and with the present height of
        the body.
        """
        heights = [
            remembered.pose.height
            for remembered in self._remembered
            if self.last_pose_ns - remembered.exposed_ns <= HEIGHT_NS
            and remembered.pose.height is not None
        ]
        self._height = statistics.median(heights) if heights else None
        self._remembered.clear()
        if self.last_pose is not None:
            self._remembered.append(TimedPose(self.last_pose_ns, self.last_pose))
        self._counted_ns = self.last_pose_ns
        self.decision = MISSING

    # ---- its poses ----

    def record_times(self, newest_ns: int, read_ns: int, has_own_times: bool) -> None:
        """Record the times of the newest frame and of the robot's pose in it.

        If poses have their own times, a frame may repeat a pose that was measured for an earlier
        frame. The pose is new only if it is later than the last accepted pose, and than the pose in
        the previous frame.

        Args:
            newest_ns: Time of the frame [ns].
            read_ns: Time of the pose [ns].
            has_own_times: Whether poses have their own times.
        """
        self.is_new = not has_own_times or read_ns > max(self.last_pose_ns, self.newest_pose_ns)
        self.newest_frame_ns = newest_ns
        self.newest_pose_ns = read_ns

    def count_absence(self, stale_ns: float) -> None:
        """Add up how long the robot was not seen, until the newest frame of a run.

        It counts as seen until its last pose is `stale_ns` old.
        """
        seen_until_ns = self.last_pose_ns + stale_ns
        unseen_ns = max(0.0, self.newest_frame_ns - max(self._counted_ns, seen_until_ns))
        seen_ns = self.newest_frame_ns - self._counted_ns - unseen_ns
        self.unseen_ns = max(0.0, self.unseen_ns + unseen_ns - FORGIVEN_FRACTION * seen_ns)
        self._counted_ns = self.newest_frame_ns

    def accept(self, pose: Pose, exposed_ns: int) -> None:
        """Store an accepted pose, exposed at `exposed_ns`, after the last accepted one."""
        self.last_pose = pose
        self.last_pose_ns = exposed_ns
        remembered = self._remembered
        while remembered and exposed_ns - remembered[0].exposed_ns > REMEMBERED_NS:
            remembered.popleft()
        if not remembered or exposed_ns - remembered[-1].exposed_ns >= JUMP_SPACING_NS:
            remembered.append(TimedPose(exposed_ns, pose))

    def find_refusal(self, pose: Pose, exposed_ns: int, is_driving: bool) -> Refuse | None:
        """Find the reason why a pose cannot belong to the robot.

        Args:
            pose: The pose.
            exposed_ns: Its time [ns].
            is_driving: Whether robots drive. Robots that do not drive may be carried, so only the
                limits of height and tilt are checked.

        Returns:
            The refusal, with its reason. None if the pose can belong to the robot.
        """
        reason = self.ghost_reason or self._describe_wrong_height(pose)
        if not reason and is_driving:
            reason = self._describe_lift(pose)
        if reason:
            return Refuse(self.index, reason)
        jump = self._find_jump(pose, exposed_ns) if is_driving else None
        return None if jump is None else Refuse(self.index, POSE_JUMPED, jump)

    def _describe_wrong_height(self, pose: Pose) -> str:
        """Explain why a body's height or tilt is wrong for a robot on the floor.

        The result is empty if both are within the limits.
        """
        mm_per_unit = self.rules.mm_per_unit
        lowest_mm, highest_mm = self.rules.limits.height_mm
        if (
            pose.height is not None
            and not lowest_mm / mm_per_unit <= pose.height <= highest_mm / mm_per_unit
        ):
            return (
                f"its body is at a height of {pose.height * mm_per_unit:.0f} mm, but "
                f"limits.height_mm allows only {lowest_mm:g} to {highest_mm:g} mm"
            )
        tilt_max = self.rules.limits.tilt
        if pose.tilt is not None and not pose.tilt <= tilt_max:
            return (
                f"its body is tilted by {pose.tilt:.2f} rad, but limits.tilt allows only "
                f"{tilt_max:g} rad"
            )
        return ""

    def _describe_lift(self, pose: Pose) -> str:
        """Describe how much higher or lower the body is than at the start of the run.

        The result is empty if the height has not changed by more than LIFTED_MM.
        """
        if pose.height is None or self._height is None:
            return ""
        higher_mm = (pose.height - self._height) * self.rules.mm_per_unit
        if higher_mm > LIFTED_MM:
            return f"its body is {higher_mm:.0f} mm higher than at the start: was it lifted?"
        if higher_mm < -LIFTED_MM:
            return f"its body is {-higher_mm:.0f} mm lower than at the start: was it set down?"
        return ""

    def _find_jump(self, pose: Pose, exposed_ns: int) -> Excess | None:
        """Find a remembered pose from which the robot cannot have come to a new pose.

        Returns:
            The distance or angle that is too large, and its limit. None if the robot can have come
            from each of the remembered poses.
        """
        if self.last_pose is None:
            return None
        for remembered in (*self._remembered, TimedPose(self.last_pose_ns, self.last_pose)):
            dt_ns = exposed_ns - remembered.exposed_ns
            excess = check_speed(self.rules, self.index, remembered.pose, pose, dt_ns)
            if excess is not None:
                return excess
        return None
