"""Tests of the checks on a stream of camera frames: order, rate, repeats and damage."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.core.poses import CameraFrame, Pose
from tetractl.lab.camera_stream import (
    NOISE_FRAMES,
    RATE_MIN_HZ,
    CameraStream,
    DamagedCount,
    RateWindow,
    RepeatDetector,
    compute_rate_hz,
)

MS = SECOND // 1000


def frame(sampled_ns, poses=(), unknown=()):
    return CameraFrame(1, sampled_ns, sampled_ns, tuple(poses), tuple(unknown))


def poses(*values):
    return [None if value is None else Pose(float(value), 0.0, 0.0) for value in values]


def test_a_rate_counts_the_frames_that_were_lost_in_between():
    assert compute_rate_hz([5, 6, 7, 15], [0, 1, 2, SECOND // 4]) == pytest.approx(40.0)
    assert compute_rate_hz([5, 6], [SECOND, 3 * SECOND]) == pytest.approx(0.5)
    for numbers, received_ns in [([], []), ([1], [5]), ([1, 2], [5, 5]), ([1, 2], [5, 4])]:
        assert compute_rate_hz(numbers, received_ns) is None


@settings(max_examples=20)
@given(st.integers(3, 120), st.integers(0, 10**15))
def test_the_rate_of_a_window_is_that_of_its_frames_wherever_the_clock_is(hz, begin_ns):
    window = RateWindow()
    for k in range(3 * hz):
        window.add(begin_ns + k * SECOND // hz)
    assert window.rate_hz == pytest.approx(hz, rel=1e-6)


def test_a_window_has_no_rate_until_it_spans_half_a_second():
    window = RateWindow()
    assert window.rate_hz is None
    window.add(0)
    window.add(SECOND // 2 - 1)
    assert window.rate_hz is None
    window.add(SECOND // 2)
    assert window.rate_hz == pytest.approx(4.0)


def test_a_window_forgets_what_is_more_than_a_second_old():
    window = RateWindow()
    for time_ns in (0, 1, 2, SECOND):
        window.add(time_ns)
    assert window.rate_hz == pytest.approx(3.0), "a frame exactly a second old still counts"
    window.add(SECOND + 2)
    assert window.rate_hz == pytest.approx(2.0, rel=1e-6)


def test_what_was_damaged_within_the_last_second_is_counted():
    damaged = DamagedCount()
    assert damaged.recent == 0
    for now_ns, total, recent in [
        (0, 3, 0),  # before anybody counted
        (SECOND // 2, 5, 2),
        (SECOND, 6, 3),
        (SECOND + 1, 6, 1),
        (3 * SECOND, 6, 0),
    ]:
        damaged.add(now_ns, total)
        assert damaged.recent == recent


def fed(detector, rows, driven=False):
    """Show a detector frames with these poses, and return after which one it sees a repeat."""
    frames = [frame(k, poses(*row)) for k, row in enumerate(rows)]
    found = []
    for before, now in pairwise(frames):
        detector.add(now, before, driven)
        found.append(detector.repeats)
    return found


def noisy(count):
    return [(0.1 * k, 5 + 0.1 * k) for k in range(count)]


def test_equal_frames_are_repeats_once_so_many_frames_in_a_row_have_differed():
    for count, repeats in [(NOISE_FRAMES, False), (NOISE_FRAMES + 1, True)]:
        rows = noisy(count)
        found = fed(RepeatDetector(), [*rows, rows[-1], rows[-1], (7, 8), rows[-1]])
        assert not any(found[: count - 1])
        assert found[-4:] == [repeats, repeats, False, False]


def test_a_frame_in_which_one_body_is_the_same_starts_the_count_of_noisy_frames_again():
    rows = noisy(NOISE_FRAMES)
    same = (rows[-1][0], 99.0)
    more = [(100 + row[0], row[1]) for row in noisy(NOISE_FRAMES)]
    assert not any(fed(RepeatDetector(), [*rows, same, *more[:-1], more[-2]]))
    assert fed(RepeatDetector(), [*rows, same, *more, more[-1]])[-1]


def test_poses_on_a_grid_never_count_as_repeats():
    assert not any(fed(RepeatDetector(), [(1, 2)] * 100))


def test_robots_that_drive_do_not_show_whether_measurements_are_noisy():
    rows = noisy(2 * NOISE_FRAMES)
    assert not any(fed(RepeatDetector(), [*rows, rows[-1]], driven=True))
    detector = RepeatDetector()
    fed(detector, rows)
    assert fed(detector, [rows[-1], rows[-1]], driven=True) == [True]


def test_a_frame_without_any_body_shows_no_noise():
    assert not any(fed(RepeatDetector(), [(None, None)] * 100))


def test_a_body_that_is_seen_in_one_of_two_frames_differs():
    rows = [(0.1 * k if k % 2 else None,) for k in range(NOISE_FRAMES + 1)]
    assert fed(RepeatDetector(), [*rows, rows[-1]])[-1]


def test_a_frame_whose_unknown_objects_move_is_no_repeat():
    detector = RepeatDetector()
    rows = noisy(NOISE_FRAMES + 1)
    fed(detector, rows)
    last = frame(100, poses(*rows[-1]), poses(3))
    detector.add(replace(last, unknown_objects=tuple(poses(4))), last, False)
    assert not detector.repeats
    detector.add(last, last, False)
    assert detector.repeats


def test_only_a_frame_that_is_newer_than_all_others_advances_the_stream():
    stream = CameraStream()
    assert (stream.newest, stream.newest_ns) == (None, 0)
    taken = [stream.add_frame(frame(at * MS), False) for at in (50, 60, 60, 40, 61)]
    assert taken == [True, True, False, False, True]
    assert stream.newest_ns == 61 * MS
    assert (stream.dropped_count, stream.outdated_count) == (2, 0)


def test_outdated_frames_are_counted_with_the_age_of_the_last():
    stream = CameraStream()
    assert stream.describe_silence(SECOND // 2) == "no new camera frame for 0.50 s"
    for at in (1000, 900, 750):
        stream.add_frame(frame(at * MS), False)
    assert stream.outdated_count == stream.dropped_count == 2
    assert stream.outdated_by_ns == 250 * MS
    assert stream.describe_silence(SECOND) == (
        "no new camera frame for 1.00 s: 2 outdated frames came, and the last of them was exposed "
        "0.25 s before the newest frame"
    )
    stream.add_frame(frame(1001 * MS), False)
    assert stream.describe_silence(SECOND) == "no new camera frame for 1.00 s"


@pytest.mark.parametrize(
    ("hz", "slow"), [(10, True), (RATE_MIN_HZ - 1, True), (RATE_MIN_HZ, False), (120, False)]
)
def test_slow_frames_are_named_and_fast_ones_are_not(hz, slow):
    stream = CameraStream()
    assert stream.slow_hint == ""
    for k in range(int(2 * hz)):
        stream.add_frame(frame(round(k * SECOND / hz)), False)
    text = stream.slow_hint
    assert text.startswith(f"; only {hz:.0f} images per second came") if slow else text == ""


def test_a_camera_that_repeats_itself_is_noticed_in_the_stream():
    stream = CameraStream()
    for k, row in enumerate(noisy(NOISE_FRAMES + 1)):
        stream.add_frame(frame(k * MS, poses(*row)), False)
        assert not stream.repeats
    stream.add_frame(frame(SECOND, poses(*row)), False)
    assert stream.repeats
    stream.add_frame(frame(2 * SECOND, poses(1, 2)), False)
    assert not stream.repeats
