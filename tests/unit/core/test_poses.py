"""Tests of poses, of how precisely a camera sees, and of frames as arrays."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.poses import (
    CameraFrame,
    Frames,
    Observation,
    Pose,
    Poses,
    Sample,
    Sight,
    describe_excess_angle,
    wrap,
)

ROWS = np.array([[1.0, 2.0, 0.3], [4.0, 6.0, -0.5]])


def test_poses_and_rows_are_the_same():
    poses = Poses.from_array(ROWS)
    assert poses.x.tolist() == [1, 4]
    assert poses.y.tolist() == [2, 6]
    assert poses.heading.tolist() == [0.3, -0.5]
    assert poses.array().tolist() == ROWS.tolist()
    assert poses.xy.tolist() == [[1, 2], [4, 6]]


def test_distances_are_each_robots_to_its_own_point():
    poses = Poses.from_array(ROWS)
    assert poses.distances(np.array([[4.0, 6.0], [4.0, 6.0]])) == pytest.approx([5, 0])
    assert Pose(1, 2, 0).distance_to(Pose(4, 6, 9)) == pytest.approx(5)
    assert Pose(4, 2, 0).distance_to(Pose(1, 6, 9)) == pytest.approx(5)


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    wrapped = float(wrap(np.array([angle]))[0])
    assert abs(wrapped) <= math.pi + 1e-9
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_angles_within_half_a_turn_are_not_changed_and_nan_stays():
    angles = np.array([-3.0, 0.0, 3.0, math.nan])
    np.testing.assert_array_equal(wrap(angles), angles)


@pytest.mark.parametrize("angle", [0.0, 6.28, -6.28, 2 * math.pi, math.nan])
def test_an_angle_of_up_to_a_turn_has_no_problem(angle):
    assert describe_excess_angle(angle) is None


@pytest.mark.parametrize(("angle", "radians"), [(90.0, "1.571"), (-90.0, "-1.571"), (6.3, "0.11")])
def test_an_angle_of_more_is_probably_in_degrees(angle, radians):
    problem, hint = describe_excess_angle(angle)
    assert problem == "is more than a whole turn, which is 6.283 rad"
    assert hint.startswith(f"if this is an angle in degrees, write {radians}")


def test_all_poses_of_a_frame_have_its_time_unless_each_has_its_own():
    seen = (Pose(0, 0, 0), None, Pose(1, 1, 1))
    assert CameraFrame(1, 50, 60, seen).times((1, 2, 3)) == (50, 50, 50)
    own = CameraFrame(1, 50, 60, seen, exposed_ns=(40, 45, 50))
    assert own.times((30, 20, 10)) == (40, 20, 50)
    assert own.times((41, 20, 50)) == (41, 20, 50)  # none goes back


NOTHING = Sight()


@pytest.mark.parametrize(
    ("sight", "coarse"),
    [
        (NOTHING, False),
        (Sight(noise_mm=1, noise_rad=1, rate_hz=50), False),
        (Sight(grid_mm=1), True),
        (Sight(grid_rad=0.1), True),
    ],
)
def test_a_camera_is_coarse_if_it_measures_on_a_grid(sight, coarse):
    assert sight.has_grid is coarse


def test_the_largest_error_is_four_deviations_and_half_a_grid():
    assert Sight(noise_mm=0.5, noise_rad=0.01).largest_error_mm == pytest.approx(2.0)
    assert Sight(noise_mm=0.5, noise_rad=0.01).largest_error_rad == pytest.approx(0.04)
    # a corner of the grid's square is half of its diagonal away
    assert Sight(grid_mm=2.0, noise_mm=0.5).largest_error_mm == pytest.approx(
        2.0 + math.hypot(1, 1)
    )
    assert Sight(grid_rad=0.1, noise_rad=0.01).largest_error_rad == pytest.approx(0.04 + 0.05)
    assert NOTHING.largest_error_mm == NOTHING.largest_error_rad == 0


def test_the_spread_of_a_grid_is_that_of_an_even_error():
    rng = np.random.default_rng(5)
    even = rng.uniform(-1, 1, 200_000)
    x, y, heading = Sight(grid_mm=2.0, grid_rad=0.2).pose_std
    assert x == y == pytest.approx(even.std(), rel=0.01)
    assert heading == pytest.approx(0.1 * even.std(), rel=0.01)
    both = Sight(grid_mm=2.0, noise_mm=0.7, noise_rad=0.3).pose_std
    assert both == pytest.approx((math.hypot(x, 0.7), math.hypot(x, 0.7), 0.3))
    assert NOTHING.pose_std == (0, 0, 0)


def observation(frame, valid=(True, False), exposed_ns=()):
    return Observation(
        frame, frame * 100, frame * 100 + 7, Poses.from_array(ROWS + frame), np.array(valid),
        exposed_ns,
    )  # fmt: skip


def test_the_time_of_each_pose_is_in_seconds():
    assert observation(1, exposed_ns=(30, 50)).seconds.tolist() == [3e-8, 5e-8]
    assert observation(1).seconds.tolist() == [1e-7, 1e-7]


def test_an_observation_cannot_be_changed():
    for array in (observation(1).poses.x, observation(1).poses.heading, observation(1).valid):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


TRUTH = Poses.from_array(-ROWS)
SAMPLES = [
    Sample(observation(1), TRUTH),
    Sample(observation(2, (False, True), (150, 200)), TRUTH),
    Sample(observation(3), TRUTH),
]


def test_frames_hold_what_samples_do():
    frames = Frames.from_samples(SAMPLES, 2)
    assert frames.numbers.tolist() == [1, 2, 3]
    assert frames.sampled_ns.tolist() == [100, 200, 300]
    assert frames.received_ns.tolist() == [107, 207, 307]
    assert frames.poses.tolist() == [(ROWS + k).tolist() for k in (1, 2, 3)]
    assert frames.valid.tolist() == [[True, False], [False, True], [True, False]]
    assert frames.truth.tolist() == [(-ROWS).tolist()] * 3
    assert frames.exposed_ns.tolist() == [[100, 100], [150, 200], [300, 300]]


def test_the_truth_of_frames_is_known_only_if_that_of_each_is():
    unknown = Sample(observation(4), None)
    assert Frames.from_samples([*SAMPLES, unknown], 2).truth is None
    assert Frames.from_samples([], 2).truth.shape == (0, 2, 3)
    known = Frames.from_samples(SAMPLES, 2)
    joined = Frames.join([known, Frames.from_samples([], 2), known])
    assert joined.truth.shape == (6, 2, 3)
    assert Frames.join([known, Frames.from_samples([unknown], 2)]).truth is None


def test_parts_of_frames_join_to_the_whole():
    whole = Frames.from_samples(SAMPLES, 2)
    again = Frames.join([whole.select(slice(0, 1)), whole.select(np.array([1, 2]))])
    for ours, theirs in zip(again, whole, strict=True):
        assert ours.tolist() == theirs.tolist()
    assert Frames.from_samples([Sample(observation(1), None)], 2).select(slice(0, 1)).truth is None
