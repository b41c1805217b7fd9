"""Which poses a robot can have reached since it was last seen."""

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.lab.accepted_poses import AcceptedPoses, MotionLimits

LIMITS = MotionLimits(speed=100.0, turning=2.0, jump=30.0, jump_heading=0.7)
DT = SECOND // 2


@pytest.mark.parametrize(
    ("pose", "jumps"),
    [
        (Pose(129.0, 0.0, 0.0), False),  # twice the speed and the allowance
        (Pose(131.0, 0.0, 0.0), True),
        (Pose(0.0, -131.0, 0.0), True),
        (Pose(0.0, 0.0, 2.69), False),
        (Pose(0.0, 0.0, 2.71), True),
        (Pose(0.0, 0.0, -2.71), True),
    ],
)
def test_a_pose_beyond_twice_the_speed_and_one_allowance_is_a_jump(pose, jumps):
    poses = AcceptedPoses(LIMITS)
    poses.accept(Pose(0.0, 0.0, 0.0), 0)
    assert poses.fault(pose, DT, driving=True) == ("its pose jumped" if jumps else "")
    assert poses.fault(pose, DT, driving=False) == "", "robots may be carried"


def test_the_allowance_is_given_once_in_a_second():
    """Each pose is 30 mm from the last, 1/50 s later; 2 x 100 mm/s x 0.8 s + 30 mm are allowed."""
    poses = AcceptedPoses(LIMITS)
    poses.accept(Pose(0.0, 0.0, 0.0), 0)
    for k in range(1, 41):
        now_ns = k * SECOND // 50
        pose = Pose(poses.last.x + 30.0, 0.0, 0.0)
        if not poses.fault(pose, now_ns, driving=True):
            poses.accept(pose, now_ns)
    assert poses.last.x <= 200.0 * 0.8 + 30.0


def test_a_pose_that_creeps_faster_than_a_robot_drives_soon_jumps():
    """Regression: poses 0.1 s apart were remembered, in which a creeping pose went 20 mm further.

    Poses come every 1/120 s and are true for 0.49 s; then each is 10 mm from the last.
    """
    poses = AcceptedPoses(LIMITS)
    since_ns = 49 * SECOND // 100
    x_mm = 0.0
    for k in range(120):
        now_ns = k * SECOND // 120
        x_mm += 10.0 if now_ns > since_ns else 0.0
        pose = Pose(x_mm, 0.0, 0.0)
        if poses.fault(pose, now_ns, driving=True):
            break
        poses.accept(pose, now_ns)
    spacing_s = 0.02
    creeps_s = (poses.last_ns - since_ns) / SECOND
    assert poses.last.x <= 200.0 * (creeps_s + spacing_s) + 30.0
