"""Steps of robots that turn faster to one side, and of motors that saturate."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tetractl.model.motion.exact import differentiate
from tetractl.model.motion.turn_rate import by_turning, turning

ANGLES, SIDES = st.floats(-3.1, 3.1), st.floats(-0.4, 0.4)
V, T = 200.0, 0.2


def step(heading, u, a, side, saturation, t=T):
    at = math.cos(heading), math.sin(heading), math.cos(u), math.sin(u)
    rate, slopes = turning(*at, (a, V, side, saturation), t)
    return by_turning(differentiate(*at, (rate, V), t), slopes)


def integrated(heading, u, a, side, saturation, t=T):
    most = a * math.exp(abs(side)) * saturation

    def change(_, state):
        sine = math.sin(u - state[2])
        rate = a * math.exp(math.copysign(side, side * sine)) * sine
        return [V * math.cos(state[2]), V * math.sin(state[2]), max(min(rate, most), -most)]

    found = solve_ivp(change, (0, t), [0, 0, heading], rtol=1e-9, atol=1e-9, max_step=1e-2)
    return found.y[:, -1] - [0, 0, heading]


@given(heading=ANGLES, u=ANGLES, a=st.floats(1, 7), side=SIDES)
def test_a_robot_turns_faster_to_one_side(heading, u, a, side):
    found, *_ = step(heading, u, a, side, 1.0)
    assert found == pytest.approx(integrated(heading, u, a, side, 1.0), abs=1e-4)


@given(heading=ANGLES, u=ANGLES, a=st.floats(1, 7), side=SIDES, saturation=st.floats(0.2, 1))
def test_motors_saturate(heading, u, a, side, saturation):
    """By the turn in the middle of a step: to 5 % of what a robot turns at most, and to 20 % where
    it faces nearly away from the direction; its way to 12 %."""
    (dx, dy, turn), *_ = step(heading, u, a, side, saturation)
    x, y, turned = integrated(heading, u, a, side, saturation)
    away = abs(math.remainder(u - heading, math.tau)) > 2.0
    most = (0.2 if away else 0.05) * a * math.exp(abs(side)) * T
    assert turn == pytest.approx(turned, abs=most)
    assert (dx, dy) == pytest.approx((x, y), abs=0.12 * V * T)


@given(
    heading=ANGLES,
    phi=st.floats(0.2, 2.9) | st.floats(-2.9, -0.2),
    side=SIDES.filter(lambda k: abs(k) > 0.01),
    saturation=st.sampled_from([1.0, 0.2, 0.1]),
)
def test_derivatives_are_those_of_the_step(heading, phi, side, saturation):
    """Where the robot saturates in the middle, or not, in both of the steps compared."""
    a, t, by = 4.0, 0.02, 1e-6
    given_, u = np.array([0.0, 0.0, side, math.log(saturation)]), heading + phi

    def moved(change_heading=0.0, change_u=0.0, p=None):
        own = given_ + by * (np.arange(4) == p)
        rate = a * math.exp(own[0])
        found = step(heading + change_heading, u + change_u, rate, own[2], math.exp(own[3]), t)[0]
        return np.array(found) * [math.exp(own[1]), math.exp(own[1]), 1]

    if saturation < 1 and abs(math.sin(phi)) < 1.5 * saturation * math.exp(abs(side)):
        return  # may saturate in one step, and not in the other
    there = moved()
    _, by_heading, by_u, by_parameters = step(heading, u, a, side, saturation, t)
    scale = np.array([V * t, V * t, 1.0])
    assert by_heading / scale == pytest.approx(
        ((moved(by) - there) / by + [0, 0, 1]) / scale, abs=2e-3
    )
    assert by_u / scale == pytest.approx((moved(0, by) - there) / by / scale, abs=2e-3)
    for p in (0, 2) if saturation == 1 else (0, 2, 3):
        slope = (moved(p=p) - there) / by
        assert by_parameters[p] / scale == pytest.approx(slope / scale, abs=2e-3), p
