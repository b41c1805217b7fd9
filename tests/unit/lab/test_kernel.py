"""Tests of the kernel: the rules that decide when robots may move."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.core.plan import PAUSE_S
from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import (
    ControlPace,
    PlaceCheck,
    check_direction,
    check_frame_age,
    check_program,
    check_speed,
    check_tracking,
    compute_edge_excess,
    distance_outside,
    drive_ahead,
    find_too_close,
    may_move,
)
from tetractl.spec.lab_section import LabLimits

DISC = Shape(np.array([[500.0, 500.0]]), 100.0)


RULES = GuardRules(
    names=("green",),
    speeds=(200.0,),
    turning=(math.pi,),
    arena=Bounds(0.0, 0.0, 1000.0, 1000.0),
    limits=LabLimits(reaction=0.5),
    obstacles=(DISC,),
)


def places(speed=0.0, turning=0.0):
    checked_places = PlaceCheck(RULES)
    checked_places.record_transmission(0, (speed,), (turning,))
    return checked_places


def test_a_robot_in_an_obstacle_is_found_there_whatever_it_is_commanded():
    checked_places = places()
    assert not checked_places.check_obstacles(0, Pose(395.0, 500.0, 0.0))
    assert checked_places.check_obstacles(0, Pose(401.0, 500.0, 0.0))


def test_a_robot_is_predicted_on_the_arc_that_it_is_commanded():
    """By 100 mm ahead in half a second, or round an eighth of a circle."""
    assert places(speed=200.0).check_obstacles(0, Pose(310.0, 500.0, 0.0))
    assert not places(speed=200.0).check_obstacles(0, Pose(290.0, 500.0, 0.0))
    assert not places(speed=200.0, turning=math.pi).check_obstacles(0, Pose(330.0, 500.0, 0.0))
    assert not places(speed=200.0).check_obstacles(0, Pose(310.0, 500.0, math.pi))


@given(
    bearing=st.floats(-math.pi, math.pi),
    away=st.floats(60, 140),
    heading=st.floats(-math.pi, math.pi),
    speed=st.floats(100, 400),
    turning=st.floats(-math.pi, math.pi),
)
def test_a_robot_enters_an_obstacle_if_the_end_of_its_arc_is_inside(
    bearing, away, heading, speed, turning
):
    """The arc is that of half a second, the reaction time, in a thousand straight pieces."""
    moments_s = (np.arange(1000) + 0.5) / 2000
    courses = heading + turning * moments_s
    x = 500 + away * math.cos(bearing) - speed * 0.5 * np.cos(courses).mean()
    y = 500 + away * math.sin(bearing) - speed * 0.5 * np.sin(courses).mean()
    assume(math.hypot(x - 500, y - 500) > 120)  # it does not touch the obstacle yet
    assume(abs(away - 100) > 0.1)
    entered = places(speed, turning).check_obstacles(0, Pose(x, y, heading)) is not None
    assert entered == (away < 100)


def test_a_robot_that_touches_an_obstacle_at_the_start_may_leave_but_not_go_deeper_again():
    checked_places = places(speed=200.0)
    assert not checked_places.check_obstacles(0, Pose(410.0, 500.0, 0.0))
    assert not checked_places.check_obstacles(0, Pose(405.0, 500.0, 0.0))
    assert checked_places.check_obstacles(0, Pose(408.0, 500.0, 0.0))
    checked_places.start()
    assert not checked_places.check_obstacles(0, Pose(408.0, 500.0, 0.0))


def test_the_depth_beyond_its_limit_is_stated_where_it_was_found():
    """The disc begins at x = 400. The limit is 0, or for a robot that has touched the disc the
    least depth so far, plus 2 mm of noise."""
    standing = places()
    assert standing.check_obstacles(0, Pose(395.0, 500.0, 0.0)) is None
    now = standing.check_obstacles(0, Pose(401.0, 500.0, 0.0))
    assert (now.check, now.unit, now.robot) == ("obstacle", "mm", 0)
    assert (now.value, now.limit) == (pytest.approx(1.0), 0.0)
    after_reaction = places(speed=200.0).check_obstacles(0, Pose(310.0, 500.0, 0.0))
    assert (after_reaction.value, after_reaction.limit) == (pytest.approx(10.0), 0.0)
    touching = places(speed=200.0)
    touching.check_obstacles(0, Pose(405.0, 500.0, 0.0))
    deeper = touching.check_obstacles(0, Pose(408.0, 500.0, math.pi))  # it would leave
    assert (deeper.value, deeper.limit) == (pytest.approx(8.0), pytest.approx(5.0 + 2.0))


@pytest.mark.parametrize(
    ("pose", "dt_s", "excess"),
    [
        (Pose(130.0, 0.0, 0.0), 0.25, None),  # twice 200 mm/s for 0.25 s, and 30 mm
        (Pose(131.0, 0.0, 0.0), 0.25, (131.0, 130.0, "mm")),
        (Pose(0.0, 0.0, 0.7 + 0.5 * math.pi), 0.25, None),  # twice pi for 0.25 s, and 0.7
        (Pose(0.0, 0.0, -2.3), 0.25, (2.3, 0.7 + 0.5 * math.pi, "rad")),
    ],
)
def test_a_pose_is_too_fast_beyond_twice_the_robots_speed(pose, dt_s, excess):
    found = check_speed(RULES, 0, Pose(0.0, 0.0, 0.0), pose, round(dt_s * SECOND))
    if excess is None:
        assert found is None
    else:
        value, limit, unit = excess
        assert (found.value, found.limit) == (pytest.approx(value), pytest.approx(limit))
        assert (found.check, found.unit, found.robot) == ("speed", unit, 0)


def test_nobody_moves_by_a_frame_that_is_older_than_stale():
    assert may_move(RULES, ControlPace(), frame_ns=0, now_ns=SECOND // 10)
    assert not may_move(RULES, ControlPace(), frame_ns=0, now_ns=SECOND // 10 + 1)


def test_robots_that_turn_wait_for_a_direction_longer_than_robots_that_drive_but_not_for_ever():
    """Driving, the limit is `silence_ns`, 2 s; turning, half a second comes on top."""
    ahead = ControlPace(drives_ahead=True)
    turning = ControlPace(drives_ahead=False)
    assert check_direction(RULES, ahead, 2 * SECOND) is not None
    assert check_direction(RULES, turning, 9 * SECOND) is None
    still_ns = RULES.silence_ns + SECOND
    assert not may_move(RULES, turning, frame_ns=still_ns, now_ns=still_ns)


def test_an_age_at_its_limit_counts_as_too_old():
    assert check_tracking(RULES, 0, 299_999_999) is None
    assert check_tracking(RULES, 0, 300_000_000).value == 0.3
    assert (
        check_program(RULES, ControlPace(last_step_ns=None), 9 * SECOND) is None
    )  # nothing was decided yet
    assert check_program(RULES, ControlPace(last_step_ns=0), SECOND // 2).limit == 0.5


@given(
    since_ns=st.integers(0, 10**12),
    age_ns=st.integers(0, 4 * SECOND),
    limit_s=st.sampled_from([0.3, 0.5, 1.0]),
)
def test_an_age_counts_from_what_was_last_done(since_ns, age_ns, limit_s):
    limits = LabLimits(stream_lost=limit_s, untracked_abort=limit_s)
    rules = replace(RULES, limits=limits, silence_ns=round(limit_s * SECOND))
    now_ns = since_ns + age_ns
    pace = ControlPace(last_step_ns=since_ns, last_direction_ns=since_ns)
    found = {
        "program": check_program(rules, pace, now_ns),
        "direction": check_direction(rules, pace, now_ns),
        "frame": check_frame_age(rules, since_ns, now_ns),
        "tracking": check_tracking(rules, 0, age_ns),
    }
    for name, excess in found.items():
        assert (excess is not None) == (age_ns >= limit_s * SECOND)
        if excess is not None:
            assert (excess.check, excess.unit) == (name, "s")
            assert (excess.value, excess.limit) == pytest.approx((age_ns / SECOND, limit_s))
            assert excess.robot == (0 if name == "tracking" else None)


@given(
    frame_ns=st.integers(0, 10**12),
    age_ns=st.integers(0, SECOND),
    waited_ns=st.integers(0, 9 * SECOND),
)
def test_robots_move_by_fresh_frames_and_turn_for_a_while_without_a_direction(
    frame_ns, age_ns, waited_ns
):
    now_ns = frame_ns + age_ns
    fresh = age_ns <= RULES.limits.stale * SECOND
    assert may_move(RULES, ControlPace(drives_ahead=True), frame_ns, now_ns) == fresh
    turning = ControlPace(drives_ahead=False, last_direction_ns=now_ns - waited_ns)
    waits = waited_ns < PAUSE_S * SECOND + RULES.silence_ns
    assert may_move(RULES, turning, frame_ns, now_ns) == (fresh and waits)


IN_METRES = replace(
    RULES,
    mm_per_unit=1000.0,
    speeds=(0.2,),
    arena=Bounds(0.0, 0.0, 1.0, 1.0),
    names=("green", "blue", "red"),
    limits=LabLimits(separation_mm=90.0),
)


def test_a_distance_is_told_in_millimetres_whatever_the_unit_of_the_spec():
    jump_m = IN_METRES.limits.jump_mm / 1000
    far = check_speed(IN_METRES, 0, Pose(0.1, 0.1, 0.0), Pose(0.9, 0.1, 0.0), SECOND // 10)
    assert (far.value, far.limit) == pytest.approx((800.0, 40.0 + 1000 * jump_m))
    assert (
        check_speed(IN_METRES, 0, Pose(0, 0, 0), Pose(0.039 + jump_m, 0, 0), SECOND // 10) is None
    )
    beyond = compute_edge_excess(IN_METRES, 0, Pose(1.03, -0.04, 0.0))
    assert (beyond.value, beyond.unit) == (pytest.approx(50.0), "mm")


@pytest.mark.parametrize(
    ("x", "y", "distance"),
    [(0.5, 0.5, 0.0), (0.0, 1.0, 0.0), (-0.2, 0.5, 0.2), (1.3, 0.5, 0.3), (0.5, -0.1, 0.1),
     (0.5, 1.4, 0.4), (1.3, 1.4, 0.5)],
)  # fmt: skip
def test_a_pose_outside_has_its_distance_from_the_arena(x, y, distance):
    assert distance_outside(IN_METRES.arena, Pose(x, y, 0.0)) == pytest.approx(distance)


@given(st.floats(-math.pi, math.pi), st.floats(-5, 5))
def test_a_robot_is_driven_along_its_heading(heading, way):
    pose = drive_ahead(Pose(3.0, 4.0, heading), way)
    assert (pose.x - 3.0, pose.y - 4.0) == pytest.approx(
        (way * math.cos(heading), way * math.sin(heading))
    )
    assert pose.heading == heading


def pairs(now, then):
    names = IN_METRES.names
    poses = [
        {name: Pose(x, 0.5, 0.0) for name, x in zip(names, row, strict=True)} for row in (now, then)
    ]
    return [(abort.text, abort.excess.value) for abort in find_too_close(*poses, IN_METRES)]


def test_robots_that_come_too_close_are_named_and_those_that_part_are_not():
    assert pairs((0.1, 0.5, 0.9), (0.3, 0.5, 0.9)) == []
    assert pairs((0.3, 0.5, 0.9), (0.42, 0.5, 0.9)) == [
        ("green and blue are too close: 200 mm", pytest.approx(80.0))
    ]
    assert pairs((0.45, 0.5, 0.9), (0.42, 0.5, 0.9)) == []  # they part
    assert len(pairs((0.4, 0.5, 0.6), (0.45, 0.5, 0.55))) == 2
