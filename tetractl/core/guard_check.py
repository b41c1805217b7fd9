"""The base class of the checks with which the guard of a lab watches the robots."""

from collections.abc import Iterable, Sequence
from typing import ClassVar, Protocol

from tetractl.core.guard_findings import Finding, RobotPlace
from tetractl.core.poses import Pose


class GuardCheck(Protocol):
    """A check of the robots' motion in a lab, which can warn the operator or end a run.

    The section of an actuator names the checks for its robots. A check derives from this class and
    overrides the methods that it needs; the others find nothing. The guard calls the methods in
    this order:

    1. `start` before each run.
    2. `record_transmission` for each transmission.
    3. `record_exposures` for each frame. Then, for each robot, `check_pose` if the frame shows a
       new pose that the robot can have reached, or `check_repeat` if the pose equals the last one.
       Then `check_frame`, once the poses are accepted. Between two runs, the guard calls
       `check_pause` instead of `check_pose` and `check_repeat`.
    4. `check_places` each time before the guard decides whether the robots may continue.

    Findings take effect in the order in which they are yielded. Lengths are in the spec's length
    unit, times in ns.

    Attributes:
        statistical: Whether its limits depend on how well robots follow their commands. Such a
            check only reports in a run with `lab.limits.observe`.

    Example:
        >>> from tetractl.core.guard_findings import Abort
        >>> class Fence(tetractl.core.guard_check.GuardCheck):
        ...     def check_pose(self, robot, before, pose):
        ...         if pose.x > 1000:
        ...             yield Abort(f"robot {robot} crossed the fence", suspect=robot)
    """

    statistical: ClassVar[bool] = False

    def start(self) -> None:
        """Forget all earlier runs, because a new run begins. The robots stand still."""

    def replace(self, robot: int) -> None:
        """Forget a lost robot, because another body is now tracked under its name.

        Args:
            robot: Index of the robot.
        """

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record that an action was transmitted to the robots.

        Args:
            now_ns: When the action was sent [ns].
            speed: Commanded speed of each robot [length unit/s], N entries.
            turning: Commanded turning rate of each robot [rad/s], N entries.
        """

    def record_exposures(self, times: tuple[int, ...]) -> None:
        """Record when the poses of a camera frame were measured.

        Args:
            times: Time of each pose [ns], N entries.
        """

    def check_pose(self, robot: int, before: Pose, pose: Pose) -> Iterable[Finding]:
        """Check a new pose of a robot during a run, and yield the findings.

        Args:
            robot: Index of the robot.
            before: Last accepted pose of the robot.
            pose: New pose of the robot, which is not accepted yet.

        Returns:
            The findings. Empty if nothing is wrong.
        """
        return ()

    def check_repeat(self, robot: int) -> Iterable[Finding]:
        """Check a robot whose new pose equals its last accepted pose exactly.

        Args:
            robot: Index of the robot.
        """
        return ()

    def check_pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Check a robot's new pose in a pause between two runs.

        Args:
            robot: Index of the robot.
            before: Last accepted pose of the robot.
            pose: New pose of the robot.
            now_ns: The current time [ns].
        """
        return ()

    def check_frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> Iterable[Finding]:
        """Check all accepted poses of a frame during a run.

        Args:
            now_ns: The current time [ns].
            times: When each pose was measured [ns], N entries.
            poses: Last accepted pose of each robot, N entries. None before the first.
        """
        return ()

    def check_places(self, robots: Sequence[RobotPlace]) -> Iterable[Finding]:
        """Check where the robots are, whether or not a frame has arrived.

        Args:
            robots: Where each robot is, N entries.
        """
        return ()
