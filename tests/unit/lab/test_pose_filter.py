"""Which poses a robot can have reached since it was last seen."""

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.lab.pose_filter import MotionLimits, PoseFilter

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
    seen = PoseFilter(LIMITS)
    assert seen.add(Pose(0.0, 0.0, 0.0), 0, "")
    assert seen.fault(pose, DT, driving=True) == ("its pose jumped" if jumps else "")
    assert seen.fault(pose, DT, driving=False) == "", "robots may be carried"


def test_the_allowance_is_given_once_in_a_second():
    seen = PoseFilter(LIMITS)
    accepted = [0.0]
    seen.add(Pose(0.0, 0.0, 0.0), 0, "")
    for k in range(1, 41):
        pose = Pose(accepted[-1] + 30.0, 0.0, 0.0)
        fault = seen.fault(pose, k * SECOND // 50, driving=True)
        accepted.append(pose.x if seen.add(pose, k * SECOND // 50, fault) else accepted[-1])
    assert accepted[-1] <= 200.0 * 0.8 + 30.0
