"""Tests of elementary functions as polynomials, against the standard library."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.model.motion import polynomials

ERROR = 1e-12  # paths agree with the readable model to 1e-9, and errors of many steps add up
half_turns = st.floats(-math.pi, math.pi)
numbers = st.floats(-1e6, 1e6)
positive = st.floats(1e-300, 1e300)


@given(half_turns)
def test_sine_and_cosine_of_a_half_turn(x):
    sine, cosine = polynomials.sincos(x)
    assert sine == pytest.approx(math.sin(x), abs=ERROR)
    assert cosine == pytest.approx(math.cos(x), abs=ERROR)


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_is_the_same_angle_within_half_a_turn(x):
    wrapped = polynomials.wrap(x)
    assert abs(wrapped) <= math.pi + 1e-9
    assert math.cos(wrapped - x) == pytest.approx(1.0, abs=1e-9)


@given(numbers)
def test_the_arctangent(z):
    assert polynomials.arctan(z) == pytest.approx(math.atan(z), abs=ERROR)


@given(st.floats(0, 1000))
def test_a_decay_is_an_exponential_that_ends_at_a_floor(x):
    expected = math.exp(-min(x, polynomials.DECAY_MAX))
    assert polynomials.decay(x) == pytest.approx(expected, rel=1e-11)


@given(positive)
def test_a_number_is_its_mantissa_times_a_power_of_two(y):
    m, k = polynomials.mantissa(y)
    assert math.sqrt(0.5) <= m < math.sqrt(2)
    assert math.ldexp(float(m), int(k)) == y
    logarithm = polynomials.log_from_ratio((m - 1) / (m + 1), k)
    assert logarithm == pytest.approx(math.log(y), rel=1e-12, abs=ERROR)


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=9), st.floats(-1, 1))
def test_both_ways_to_evaluate_a_polynomial_agree_with_numpy(coefficients, q):
    expected = np.polynomial.polynomial.polyval(q, coefficients)
    assert polynomials.horner(coefficients, q) == pytest.approx(expected, abs=1e-9)
    inside = [99.0, *coefficients, -99.0]  # only the coefficients between the two indices count
    value = polynomials.alternating(inside, 1, len(coefficients) + 1, q)
    assert value == pytest.approx(expected, abs=1e-9)


@given(numbers, numbers, half_turns, st.floats(-20, 20))
def test_a_step_moves_and_turns_a_pose(x, y, heading, turn):
    cosine, sine = math.cos(heading), math.sin(heading)
    x_after, y_after, c, s = polynomials.onwards(x, y, cosine, sine, (3.0, -4.0, turn))
    assert (x_after, y_after) == (x + 3.0, y - 4.0)
    assert (c, s) == pytest.approx((math.cos(heading + turn), math.sin(heading + turn)), abs=1e-9)
