"""Tests of which poses a robot can have reached since it was last seen."""

from dataclasses import replace

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.robot_track import RobotTrack
from tetractl.spec.lab_section import LabLimits

RULES = GuardRules(
    names=("green",),
    speeds=(100.0,),
    turning=(2.0,),
    arena=Bounds(0.0, 0.0, 2000.0, 2000.0),
    limits=LabLimits(jump_mm=30.0),
)
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
    robot = RobotTrack("one", RULES, 0)
    robot.accept(Pose(0.0, 0.0, 0.0), 0)
    refusal = robot.refusal(pose, DT, driving=True)
    if jumps:
        assert (refusal.robot, refusal.text) == (0, "its pose jumped")
        assert refusal.excess.value > refusal.excess.limit
    else:
        assert refusal is None
    assert robot.refusal(pose, DT, driving=False) is None, "robots may be carried"


def test_the_allowance_is_given_once_in_a_second():
    """Each pose is 30 mm from the last, 1/50 s later; 2 x 100 mm/s x 0.8 s + 30 mm are allowed."""
    robot = RobotTrack("one", RULES, 0)
    robot.accept(Pose(0.0, 0.0, 0.0), 0)
    for k in range(1, 41):
        now_ns = k * SECOND // 50
        pose = Pose(robot.last.x + 30.0, 0.0, 0.0)
        if robot.refusal(pose, now_ns, driving=True) is None:
            robot.accept(pose, now_ns)
    assert robot.last.x <= 200.0 * 0.8 + 30.0


def test_a_pose_that_creeps_faster_than_a_robot_drives_soon_jumps():
    """Regression: poses 0.1 s apart were remembered, in which a creeping pose went 20 mm further.

    Poses come every 1/120 s and are true for 0.49 s; then each is 10 mm from the last.
    """
    robot = RobotTrack("one", RULES, 0)
    since_ns = 49 * SECOND // 100
    x_mm = 0.0
    for k in range(120):
        now_ns = k * SECOND // 120
        x_mm += 10.0 if now_ns > since_ns else 0.0
        pose = Pose(x_mm, 0.0, 0.0)
        if robot.refusal(pose, now_ns, driving=True) is not None:
            break
        robot.accept(pose, now_ns)
    spacing_s = 0.02
    creeps_s = (robot.last_ns - since_ns) / SECOND
    assert robot.last.x <= 200.0 * (creeps_s + spacing_s) + 30.0


def started(heights_mm, rules=RULES):
    """Return the poses of a robot that stood for half a second, whose heights were seen in turn,
    when a run began."""
    robot = RobotTrack("one", rules, 0)
    for k in range(51):
        height = heights_mm[k % len(heights_mm)]
        robot.accept(Pose(0.0, 0.0, 0.0, height=height), k * SECOND // 100)
    robot.start_run()
    return robot


@pytest.mark.parametrize(
    ("height_mm", "said"),
    [
        (120.0, "its body is 60 mm higher than at the start: was it lifted?"),
        (260.0, "its body is 200 mm higher than at the start: was it lifted?"),
        (10.0, "its body is 50 mm lower than at the start: was it set down?"),
        (95.0, ""),  # 2 m further on a floor that is 1 degree off
        (25.0, ""),
        (None, ""),  # a tag too small to measure
    ],
)
def test_a_robot_stays_as_high_as_when_its_run_began(height_mm, said):
    robot = started([60.0])
    pose = Pose(0.0, 0.0, 0.0, height=height_mm)
    refusal = robot.refusal(pose, SECOND, driving=True)
    assert (refusal.text if refusal else "") == said
    assert robot.refusal(pose, SECOND, driving=False) is None, "robots may be carried"


def test_a_robot_lifted_in_a_pause_is_noticed_in_the_next_run():
    robot = started([60.0])
    lifted = Pose(0.0, 0.0, 0.0, height=120.0)
    assert "lifted" in robot.refusal(lifted, SECOND, driving=True).text
    robot.start_run()
    assert "lifted" in robot.refusal(lifted, 2 * SECOND, driving=True).text


def test_one_wrong_height_is_not_that_of_the_start():
    robot = started([60.0, 60.0, 130.0])
    assert robot.refusal(Pose(0.0, 0.0, 0.0, height=62.0), SECOND, driving=True) is None


def test_a_floor_out_of_level_is_followed_from_run_to_run():
    """A pause comes every 2 m; each time the floor is 35 mm higher."""
    robot = started([60.0])
    for k in range(1, 5):
        now_ns = k * 20 * SECOND
        pose = Pose(2000.0 * k, 0.0, 0.0, height=60.0 + 35.0 * k)
        assert robot.refusal(pose, now_ns, driving=True) is None
        robot.accept(pose, now_ns)
        robot.start_run()


def test_heights_are_compared_in_mm_also_of_a_spec_in_metres():
    metres = replace(RULES, speeds=(0.1,), mm=1000.0)
    robot = started([0.06], metres)
    assert robot.refusal(Pose(0.0, 0.0, 0.0, height=0.095), SECOND, driving=True) is None
    assert (
        "60 mm higher" in robot.refusal(Pose(0.0, 0.0, 0.0, height=0.12), SECOND, driving=True).text
    )
