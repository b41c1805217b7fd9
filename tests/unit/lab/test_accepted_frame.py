"""Tests of the buffer of accepted frames: each reader gets each frame once, in order."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.frame_buffer import FrameBuffer
from tetractl.lab.frames import AcceptedFrame
from tetractl.tools.worker import QUEUE_MAX


def frame(number):
    pose = Pose(float(number), 0.0, 0.0)
    return AcceptedFrame(CameraFrame(number, 10 * number, 10 * number, (pose,)), (pose,), (True,))


@given(st.lists(st.integers(0, 5), max_size=20))
def test_a_reader_gets_every_frame_once_and_in_order(arrivals):
    buffer = FrameBuffer()
    numbers = itertools.count(1)
    read = 0
    numbers_read = []
    for count in arrivals:
        for _ in range(count):
            buffer.append(frame(next(numbers)))
        frames, read = buffer.since(read)
        numbers_read += [frame.frame.number for frame in frames]
    total = sum(arrivals)
    assert numbers_read == list(range(1, total + 1))
    assert buffer.count == total


def test_the_oldest_frames_make_room_and_a_window_counts_back_from_the_newest():
    buffer = FrameBuffer()
    for number in range(QUEUE_MAX + 5):
        buffer.append(frame(number))
    frames, read = buffer.since(0)
    assert [frame.frame.number for frame in frames] == list(range(5, QUEUE_MAX + 5))
    assert buffer.since(read) == ([], QUEUE_MAX + 5), "none comes twice"
    newest = QUEUE_MAX + 4
    in_20_ns = [frame.frame.number for frame in buffer.recent(20)]  # one frame every 10 ns
    assert in_20_ns == [newest - 2, newest - 1, newest]


def test_a_pose_that_is_not_of_the_frame_is_none():
    old = Pose(1.0, 2.0, 3.0)
    accepted = AcceptedFrame(CameraFrame(1, 0, 0, (None, old)), (old, old), (False, True))
    assert (accepted.pose(0), accepted.pose(1)) == (None, old)


def test_the_newest_frame_is_the_last_one_if_there_is_any():
    buffer = FrameBuffer()
    assert buffer.newest is None
    for number in (1, 2):
        buffer.append(frame(number))
        assert buffer.newest.frame.number == number


def test_a_reader_that_counted_more_frames_than_came_gets_none():
    buffer = FrameBuffer()
    buffer.append(frame(1))
    assert buffer.since(7) == ([], 1)
