"""Tests of arcs and wheel speeds against integrals, inverses and mirror images."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from tetractl.model.motion.wheel_equations import (
    SERIES_HALF_TURN_RAD,
    arc_displacement,
    wheel_speeds,
)
from tetractl.model.wheels import compute_body_velocity

angles = st.floats(-8, 8)
numbers = st.floats(-500, 500)
LIMIT = 2 * SERIES_HALF_TURN_RAD
turns = angles | st.sampled_from([-LIMIT, LIMIT, LIMIT - 1e-9, LIMIT + 1e-9, 0.0, 1e-9])


@given(angles, turns, numbers)
def test_an_arc_is_the_integral_of_its_heading(heading, turn, distance):
    def part(component):
        return quad(lambda share: distance * component(heading + share * turn), 0, 1)[0]

    east, north = arc_displacement(heading, turn, distance)
    assert east == pytest.approx(part(math.cos), abs=1e-6)
    assert north == pytest.approx(part(math.sin), abs=1e-6)


@given(angles, turns, numbers)
def test_the_mirror_image_of_an_arc_turns_the_other_way(heading, turn, distance):
    east, north = arc_displacement(heading, turn, distance)
    assert arc_displacement(-heading, -turn, distance) == pytest.approx((east, -north), abs=1e-9)
    back_east, back_north = arc_displacement(heading + turn, -turn, -distance)
    assert (back_east, back_north) == pytest.approx((-east, -north), abs=1e-9)


@given(st.floats(-1, 1), st.floats(0.1, 9), st.floats(0, 400), st.floats(5, 80))
def test_wheel_speeds_make_a_robot_drive_and_turn_by_1_to_3(sine, a, speed, radius):
    left, right = wheel_speeds(sine, a, speed, radius)
    assert compute_body_velocity(left, right, radius) == pytest.approx((speed, a * sine), abs=1e-9)
    if sine > 0:  # to the left, so that the right wheel is the faster one
        assert right >= left
