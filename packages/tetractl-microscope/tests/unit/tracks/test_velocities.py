"""Tests of the velocity along straight lines and of the length of a path."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.tracks.velocities import compute_vsl_um_s, measure_path_um

HZ = 20.0


def straight(seconds, velocity, hz=HZ, begin_s=0.0):
    times = begin_s + np.arange(round(seconds * hz) + 1) / hz
    return times, np.outer(times - begin_s, velocity)


@given(
    st.floats(0.3, 9.0),
    st.floats(-500, 500),
    st.floats(-500, 500),
    st.sampled_from([2.0, 7.0, 30.0]),
    st.floats(-1e3, 1e3),
)
def test_a_straight_path_has_its_speed_however_long_and_often_it_is_seen(
    seconds, vx, vy, hz, begin
):
    times, places = straight(seconds + 1 / hz, (vx, vy), hz, begin)
    assert compute_vsl_um_s(times, places) == pytest.approx(math.hypot(vx, vy), rel=1e-6, abs=1e-6)
    length = math.hypot(vx, vy) * (times[-1] - times[0])
    assert measure_path_um(places) == pytest.approx(length, rel=1e-6, abs=1e-6)


def test_a_cell_that_turns_back_every_second_is_as_fast_as_one_that_does_not():
    times, places = straight(4.0, (100.0, 0.0))
    there_and_back = np.abs((times % 2.0) - 1.0)
    assert compute_vsl_um_s(
        times, 100 * np.column_stack([there_and_back, 0 * times])
    ) == pytest.approx(100)
    assert compute_vsl_um_s(times, places) == pytest.approx(100)


def test_a_circle_of_a_second_has_no_velocity_and_its_circumference():
    times = np.arange(0, 3 * HZ + 1) / HZ
    angle = math.tau * times
    places = 30 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert compute_vsl_um_s(times, places) == pytest.approx(0.0, abs=1e-9)
    assert measure_path_um(places) == pytest.approx(3 * math.tau * 30, rel=0.01)


def test_what_remains_after_the_last_whole_second_does_not_count():
    times, places = straight(2.8, (50.0, 0.0))
    places[times > 2.0] = (9999.0, 9999.0)
    assert compute_vsl_um_s(times, places) == pytest.approx(50.0)


def test_a_track_of_less_than_a_second_is_one_part():
    times, places = straight(0.5, (0.0, 0.0))
    places[-1] = (3.0, 4.0)
    assert compute_vsl_um_s(times, places) == pytest.approx(5.0 / 0.5)


def test_a_gap_in_a_track_does_not_change_the_speed():
    times, places = straight(8.0, (40.0, 30.0))
    seen = (times < 2.2) | (times > 5.7)
    assert compute_vsl_um_s(times[seen], places[seen]) == pytest.approx(50.0)


def test_a_single_place_has_no_velocity():
    assert compute_vsl_um_s(np.array([1.0]), np.zeros((1, 2))) is None
    assert measure_path_um(np.zeros((1, 2))) == 0.0
