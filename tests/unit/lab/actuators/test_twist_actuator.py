"""Tests of sending speeds and turning rates instead of wheel speeds."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.lab.actuators.twist.actuator import TwistActuator
from tetractl.lab.actuators.twist.lines import SPEED_MAX, TURN_MAX

RADII_MM = np.array([40.0, 55.0])
speeds = st.lists(st.floats(-300, 300), min_size=4, max_size=4)


def actuator():
    made = object.__new__(TwistActuator)
    made.radii = RADII_MM
    return made


@given(speeds)
def test_a_twist_is_the_mean_of_the_wheels_and_their_difference_over_their_distance(values):
    wheels = np.array(values).reshape(2, 2)
    sent = actuator()._compute_twists(wheels)
    assert sent[0] == pytest.approx((wheels[0] + wheels[1]) / 2, abs=0.51)
    turning = (wheels[1] - wheels[0]) / (2 * RADII_MM)
    assert sent[1] == pytest.approx(1000 * turning, abs=0.51)
    assert (sent == np.rint(sent)).all()


@given(speeds)
def test_the_wheels_of_a_twist_are_those_that_were_wished_within_its_rounding(values):
    wheels = np.array(values).reshape(2, 2)
    made = actuator()
    assert made._compute_wheel_speeds(made._compute_twists(wheels)) == pytest.approx(
        wheels, abs=0.6
    )


def test_a_twist_beyond_what_a_line_can_hold_is_cut_off():
    sent = actuator()._compute_twists(1e6 * np.array([[1.0, -1.0], [1.0, 1.0]]))
    assert sent.tolist() == [[SPEED_MAX, 0], [0, TURN_MAX]]


@pytest.mark.parametrize("sends", ["twist", "wheels"])
def test_the_speeds_that_are_logged_are_those_at_which_the_wheels_then_turn(sends):
    """A wheel with a gain of 1.1 turns at 110 mm/s if it is sent 100 mm/s."""
    lines = []
    made = actuator()
    made.section = SimpleNamespace(sends=sends)
    made.link = SimpleNamespace(drive=lambda line: lines.append(line) or 7)
    made._gain = np.array([[1.1, 1.0], [0.9, 1.0]])
    outputs = np.array([[100, -30], [140, 50]])
    sent_ns, wheels = made._drive(outputs)
    assert sent_ns == 7
    assert wheels == pytest.approx(np.array([[110, -30], [126, 50]]), abs=0.6)
    (line,) = lines
    first = (120, 500) if sends == "twist" else (100, 140)
    assert line[0] == first
