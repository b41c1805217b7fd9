"""Camera frames after the guard has decided which of their poses to accept.

Times are on the run's clock [ns].
"""

from collections.abc import Iterable
from dataclasses import dataclass

from tetractl.core.poses import CameraFrame, Pose


@dataclass(frozen=True, slots=True)
class AcceptedFrame:
    """A camera frame with the poses of the N robots that the guard has accepted.

    It was exposed after all earlier frames.

    Attributes:
        frame: The frame.
        poses: Last accepted pose of each robot. None before a robot's first pose.
        is_fresh: Whether each pose comes from this frame. If not, the robot was untracked, or its
            pose was refused.
        exposed_ns: Time of each pose [ns], if poses have their own times. Otherwise empty.
    """

    frame: CameraFrame
    poses: tuple[Pose | None, ...]
    is_fresh: tuple[bool, ...]
    exposed_ns: tuple[int, ...] = ()

    def pose_time_ns(self, i: int) -> int:
        """Return the time at which the pose of robot i was measured [ns]."""
        return self.exposed_ns[i] if self.exposed_ns else self.frame.sampled_ns

    def pose(self, i: int) -> Pose | None:
        """Return the pose of robot i that was accepted from this frame.

        The result is None if no pose of the robot was accepted.
        """
        return self.poses[i] if self.is_fresh[i] else None


@dataclass(frozen=True, slots=True)
class TimedPose:
    """A measured pose of a robot with the time of its exposure.

    Attributes:
        exposed_ns: The time of exposure [ns].
        pose: The pose.
    """

    exposed_ns: int
    pose: Pose


def collect_timed_poses(frames: Iterable[AcceptedFrame], i: int) -> list[TimedPose]:
    """Collect the poses of robot i that were accepted from some frames, with their times."""
    timed: list[TimedPose] = []
    for frame in frames:
        pose = frame.pose(i)
        if pose is not None:
            timed.append(TimedPose(frame.pose_time_ns(i), pose))
    return timed


def accept_all_poses(frame: CameraFrame) -> AcceptedFrame:
    """Wrap a camera frame as if the guard had accepted every pose in it."""
    fresh = tuple(pose is not None for pose in frame.poses)
    return AcceptedFrame(frame, frame.poses, fresh, frame.exposed_ns)
