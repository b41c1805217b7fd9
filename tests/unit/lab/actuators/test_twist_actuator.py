"""Speeds and turning rates that are sent instead of the speeds of wheels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.lab.actuators.twist.actuator import TwistActuator

RADII_MM = np.array([40.0, 55.0])
speeds = st.lists(st.floats(-300, 300), min_size=4, max_size=4)


def actuator():
    made = object.__new__(TwistActuator)
    made.radii = RADII_MM
    return made


@given(speeds)
def test_a_twist_is_the_mean_of_the_wheels_and_their_difference_over_their_distance(values):
    wheels = np.array(values).reshape(2, 2)
    sent = actuator()._twists(wheels)
    assert sent[0] == pytest.approx((wheels[0] + wheels[1]) / 2, abs=0.51)
    turning = (wheels[1] - wheels[0]) / (2 * RADII_MM)
    assert sent[1] == pytest.approx(1000 * turning, abs=0.51)
    assert (sent == np.rint(sent)).all()


@given(speeds)
def test_the_wheels_of_a_twist_are_those_that_were_wished_within_its_rounding(values):
    wheels = np.array(values).reshape(2, 2)
    made = actuator()
    assert made._wheels(made._twists(wheels)) == pytest.approx(wheels, abs=0.6)
