"""Tests of which poses a robot can have reached since it was last seen."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.robot_track import JUMP_SPACING_NS, REMEMBERED_NS, PoseDecision, RobotTrack
from tetractl.spec.lab_section import UNTRACKED_STOP_S, LabLimits

LOWEST_MM, HIGHEST_MM = LabLimits().height_mm

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
    refusal = robot.find_refusal(pose, DT, is_driving=True)
    if jumps:
        assert (refusal.robot, refusal.text) == (0, "its pose jumped")
        assert refusal.excess.value > refusal.excess.limit
    else:
        assert refusal is None
    assert robot.find_refusal(pose, DT, is_driving=False) is None, "robots may be carried"


def test_the_allowance_is_given_once_in_a_second():
    """Each pose is 30 mm from the last, 1/50 s later; 2 x 100 mm/s x 0.8 s + 30 mm are allowed."""
    robot = RobotTrack("one", RULES, 0)
    robot.accept(Pose(0.0, 0.0, 0.0), 0)
    for k in range(1, 41):
        now_ns = k * SECOND // 50
        pose = Pose(robot.last_pose.x + 30.0, 0.0, 0.0)
        if robot.find_refusal(pose, now_ns, is_driving=True) is None:
            robot.accept(pose, now_ns)
    assert robot.last_pose.x <= 200.0 * 0.8 + 30.0


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
        if robot.find_refusal(pose, now_ns, is_driving=True) is not None:
            break
        robot.accept(pose, now_ns)
    spacing_s = 0.02
    creeps_s = (robot.last_pose_ns - since_ns) / SECOND
    assert robot.last_pose.x <= 200.0 * (creeps_s + spacing_s) + 30.0


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
    refusal = robot.find_refusal(pose, SECOND, is_driving=True)
    assert (refusal.text if refusal else "") == said
    assert robot.find_refusal(pose, SECOND, is_driving=False) is None, "robots may be carried"


def test_a_robot_lifted_in_a_pause_is_noticed_in_the_next_run():
    robot = started([60.0])
    lifted = Pose(0.0, 0.0, 0.0, height=120.0)
    assert "lifted" in robot.find_refusal(lifted, SECOND, is_driving=True).text
    robot.start_run()
    assert "lifted" in robot.find_refusal(lifted, 2 * SECOND, is_driving=True).text


def test_one_wrong_height_is_not_that_of_the_start():
    robot = started([60.0, 60.0, 130.0])
    assert robot.find_refusal(Pose(0.0, 0.0, 0.0, height=62.0), SECOND, is_driving=True) is None


def test_a_floor_out_of_level_is_followed_from_run_to_run():
    """A pause comes every 2 m; each time the floor is 35 mm higher."""
    robot = started([60.0])
    for k in range(1, 5):
        now_ns = k * 20 * SECOND
        pose = Pose(2000.0 * k, 0.0, 0.0, height=60.0 + 35.0 * k)
        assert robot.find_refusal(pose, now_ns, is_driving=True) is None
        robot.accept(pose, now_ns)
        robot.start_run()


def test_heights_are_compared_in_mm_also_of_a_spec_in_metres():
    metres = replace(RULES, speeds=(0.1,), mm_per_unit=1000.0)
    robot = started([0.06], metres)
    assert robot.find_refusal(Pose(0.0, 0.0, 0.0, height=0.095), SECOND, is_driving=True) is None
    assert (
        "60 mm higher"
        in robot.find_refusal(Pose(0.0, 0.0, 0.0, height=0.12), SECOND, is_driving=True).text
    )


def track(**fields):
    return RobotTrack("one", RULES, 0, **fields)


AT_START = Pose(0.0, 0.0, 0.0)


def test_a_pose_is_new_unless_it_has_its_own_time_which_is_not_later():
    robot = track(last_pose=AT_START, last_pose_ns=10)
    for read_ns, own_times, is_new in [
        (20, True, True),
        (20, True, False),
        (15, True, False),
        (5, False, True),
        (9, True, False),
        (11, True, True),
    ]:
        robot.record_times(100, read_ns, own_times)
        assert robot.is_new is is_new
        assert (robot.newest_frame_ns, robot.newest_pose_ns) == (100, read_ns)


def test_a_robot_must_stop_once_it_was_unseen_for_longer_than_the_limit():
    limit_ns = round(UNTRACKED_STOP_S * SECOND)
    for untracked_ns, hidden in [(limit_ns, False), (limit_ns + 1, True)]:
        robot = track(
            last_pose=AT_START, last_pose_ns=SECOND, newest_frame_ns=SECOND + untracked_ns
        )
        assert (robot.is_hidden, robot.is_tracked) == (hidden, not hidden)
        assert robot.untracked_ns == untracked_ns
    assert not track().is_tracked, "before its first pose"
    lost = track(last_pose=AT_START, lost_ns=0)
    assert lost.is_lost and not lost.is_tracked
    assert not track().is_lost


def test_a_robot_that_is_not_tracked_is_named_with_the_reason_and_the_time():
    robot = track(last_pose_ns=SECOND, newest_frame_ns=3 * SECOND // 2)
    assert robot.untracked_message == "one is not tracked (for 0.50 s)"
    robot.decision = PoseDecision(refusal="its pose jumped")
    assert robot.untracked_message == "one is not tracked: its pose jumped (for 0.50 s)"


def test_time_unseen_adds_up_and_a_quarter_of_the_time_seen_is_forgiven():
    robot = track()
    robot.accept(AT_START, SECOND)
    robot.start_run()
    unseen_s = []
    for newest_s, last_s in [(1.05, 1.0), (1.5, 1.0), (2.0, 1.0), (3.0, 3.0), (9.0, 9.0)]:
        robot.last_pose_ns = round(last_s * SECOND)
        robot.newest_frame_ns = round(newest_s * SECOND)
        robot.count_absence(SECOND / 10)
        unseen_s.append(robot.unseen_ns / SECOND)
    # unseen from 1.1 s, when its last pose is stale, until 2 s; then seen again
    forgiven_s = 0.25 * 0.05
    assert unseen_s == pytest.approx([0, 0.4 - forgiven_s, 0.9 - forgiven_s, 0.65 - forgiven_s, 0])


def test_poses_are_remembered_for_a_second_and_a_fiftieth_apart():
    robot = track()
    for k in range(400):
        robot.accept(AT_START, k * SECOND // 200)
    times_ns = [earlier.exposed_ns for earlier in robot._remembered]
    assert (robot.last_pose, robot.last_pose_ns) == (AT_START, 399 * SECOND // 200)
    gaps_ns = [after - before for before, after in pairwise(times_ns)]
    assert set(gaps_ns) == {JUMP_SPACING_NS}
    assert (
        robot.last_pose_ns - times_ns[0]
        <= REMEMBERED_NS
        < robot.last_pose_ns - times_ns[0] + gaps_ns[0]
    )


def test_a_run_starts_from_the_last_pose_because_robots_are_carried_before_it():
    robot = track()
    robot.accept(Pose(0.0, 0.0, 0.0), 0)
    robot.accept(Pose(900.0, 0.0, 0.0), SECOND // 10)
    robot.decision = PoseDecision(refusal="its pose jumped")
    near = Pose(905.0, 0.0, 0.0)
    assert robot.find_refusal(near, SECOND // 5, is_driving=True) is not None
    robot.start_run()
    assert robot.find_refusal(near, SECOND // 5, is_driving=True) is None
    assert robot.decision.refusal == ""
    assert robot.find_refusal(Pose(0.0, 0.0, 0.0), SECOND // 5, is_driving=True) is not None


@pytest.mark.parametrize(
    ("height", "tilt", "refused"),
    [
        (None, None, ""),
        (LOWEST_MM, 0.0, ""),
        (HIGHEST_MM, 0.0, ""),
        (LOWEST_MM - 1, 0.0, "at a height of"),
        (HIGHEST_MM + 1, 0.0, "at a height of"),
        (None, LabLimits().tilt, ""),
        (None, LabLimits().tilt + 0.01, "is tilted by"),
        (None, math.nan, "is tilted by"),
    ],
)
@pytest.mark.parametrize("driving", [True, False])
@pytest.mark.parametrize("mm", [1.0, 1000.0])
def test_a_body_is_upright_on_the_floor_whether_robots_drive_or_not(
    height, tilt, refused, driving, mm
):
    robot = RobotTrack("one", replace(RULES, mm_per_unit=mm), 0)
    pose = Pose(0.0, 0.0, 0.0, None if height is None else height / mm, tilt)
    refusal = robot.find_refusal(pose, 0, driving)
    assert (refused in refusal.text) if refused else refusal is None


def test_a_robot_whose_pose_is_a_ghosts_is_refused_whatever_it_shows():
    robot = track(ghost_reason="its pose moves by itself")
    assert robot.find_refusal(AT_START, 0, is_driving=False).text == "its pose moves by itself"


@pytest.mark.parametrize(
    ("changed_mm", "refused"), [(39, ""), (41, "41 mm higher"), (-41, "41 mm")]
)
def test_a_body_that_is_lifted_in_a_run_is_refused_while_robots_drive(changed_mm, refused):
    robot = track()
    robot.accept(Pose(0.0, 0.0, 0.0, 50.0), 0)
    robot.start_run()
    pose = Pose(0.0, 0.0, 0.0, 50.0 + changed_mm)
    refusal = robot.find_refusal(pose, 1, is_driving=True)
    assert (refused in refusal.text) if refused else refusal is None
    assert robot.find_refusal(pose, 1, is_driving=False) is None
    assert robot.find_refusal(AT_START, 1, is_driving=True) is None, (
        "without a height nothing is compared"
    )
