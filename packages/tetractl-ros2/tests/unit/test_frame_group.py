"""Tests of joining single poses to frames."""

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from tetractl_ros2.frame_group import FrameGroup, RobotReading

from tetractl.core.poses import Pose


def at(ns):
    return RobotReading(Pose(float(ns), 0.0, 0.0), ns)


def times(frames):
    return [tuple(reading.exposed_ns for reading in frame) for frame in frames]


def feed(group, *messages):
    """The frames that these messages complete: each a stamp and a robot."""
    complete = []
    for stamp, robot in messages:
        complete += group.add(stamp, {robot: at(stamp)})
    return times(complete)


def in_step():
    group = FrameGroup(3)
    feed(group, (1, 0), (1, 1), (1, 2))
    return group


def test_a_message_with_all_robots_is_a_frame():
    group = FrameGroup(2)
    assert times(group.add(5, {0: at(5), 1: at(5)})) == [(5, 5)]


def test_poses_with_one_stamp_are_one_frame():
    assert feed(in_step(), (2, 0), (2, 1)) == []
    assert feed(in_step(), (2, 0), (2, 1), (2, 2)) == [(2, 2, 2)]
    assert feed(in_step(), (2, 2), (2, 0), (2, 1), (3, 1)) == [(2, 2, 2)]


def test_a_frame_without_a_robot_that_kept_step_is_complete_when_the_next_begins():
    group = in_step()
    assert feed(group, (2, 0), (2, 1), (3, 0)) == [(2, 2, 1)]
    assert feed(group, (3, 1), (4, 0), (4, 1)) == [(3, 3, 1), (4, 4, 1)]


def test_a_robot_that_comes_back_is_waited_for_again():
    group = in_step()
    feed(group, (2, 0), (2, 1), (3, 0), (3, 1))
    assert feed(group, (3, 2)) == []
    assert feed(group, (4, 0), (4, 1)) == []
    assert feed(group, (4, 2)) == [(4, 4, 4)]


def test_robots_with_stamps_of_their_own_wait_for_nobody():
    group = FrameGroup(3)
    feed(group, (1, 0), (2, 1), (3, 2))
    assert feed(group, (4, 0), (5, 1), (6, 2)) == [(4, 2, 3), (4, 5, 3), (4, 5, 6)]


def test_a_message_that_comes_twice_is_no_new_frame():
    group = FrameGroup(1)
    assert feed(group, (1, 0), (1, 0), (1, 0), (2, 0)) == [(1,), (2,)]


def test_a_pose_that_another_has_overtaken_does_not_move_a_robot_back():
    group = FrameGroup(1)
    feed(group, (5, 0))
    group.add(4, {0: at(4)})
    assert group.last[0].exposed_ns == 5
