"""Tests of functions that give the same bits on every computer: accuracy, and equal variants."""

import hashlib
import math
import random

import numpy as np
import pytest

from tetractl.core import elementary, elementwise

UNITS = 8  # in the last place

RANGES = {
    "sin": [(-8, 8), (-1e5, 1e5), (-1e-3, 1e-3)],
    "cos": [(-8, 8), (-1e5, 1e5), (-1e-3, 1e-3)],
    "exp": [(-700, 700), (-1, 1)],
    "expm1": [(-40, 700), (-1, 1), (-1e-5, 1e-5)],
    "log": [(0, 10), (0.9, 1.1), (0, 1e300), (0, 1e-300)],
    "log1p": [(-0.99, 10), (-0.4, 0.4), (-1e-5, 1e-5)],
    "tanh": [(-20, 20), (-1, 1), (-1e-5, 1e-5)],
    "atan": [(-5, 5), (-1e3, 1e3), (-1e-5, 1e-5)],
}


def numbers(name):
    draw = random.Random(name)
    return [draw.uniform(*limits) for limits in RANGES[name] for _ in range(2000)]


@pytest.mark.parametrize("name", RANGES)
def test_a_function_is_right_to_the_last_digits(name):
    function = getattr(elementary, name)
    exact = getattr(math, name)
    for x in numbers(name):
        assert abs(function(x) - exact(x)) <= UNITS * math.ulp(exact(x)), x


def test_the_angle_of_a_point_is_right_in_all_quadrants():
    draw = random.Random(1)
    for _ in range(5000):
        x = draw.uniform(-5, 5)
        y = draw.uniform(-5, 5)
        exact = math.atan2(y, x)
        assert abs(elementary.atan2(y, x) - exact) <= UNITS * math.ulp(exact), (x, y)
    for y, x in ((0, 1), (0, -1), (1, 0), (-1, 0), (0, 0)):
        assert elementary.atan2(y, x) == math.atan2(y, x)


def test_limits_and_what_is_no_number():
    assert elementary.exp(-math.inf) == elementary.exp(-1000) == 0
    assert elementary.exp(math.inf) == elementary.exp(1000) == math.inf
    assert elementary.expm1(-math.inf) == elementary.expm1(-100) == -1
    assert elementary.log(0) == -math.inf
    assert elementary.log(math.inf) == math.inf
    assert elementary.tanh(math.inf) == elementary.tanh(1000) == 1
    assert elementary.tanh(-math.inf) == -1
    for name in RANGES:
        assert math.isnan(getattr(elementary, name)(math.nan)), name
    for name in ("sin", "cos"):
        assert math.isnan(getattr(elementary, name)(math.inf))
    assert math.isnan(elementary.log(-1))
    assert elementary.log_of_sum(-math.inf, -math.inf) == -math.inf
    assert elementary.log_of_sum(0, -math.inf) == 0
    assert elementary.log_of_sum(1000, 1000) == 1000 + math.log(2)


SPECIAL = [0.0, -0.0, 1.0, -1.0, 5e-324, -1e-300, 1e300, -1e308, 1e6, -1e7, 299.0, 301.0, 710.0]
SPECIAL += [-745.0, -0.9999999, 801.0, -801.0, math.inf, -math.inf, math.nan]
"""Numbers at the ends of ranges, and beyond."""
SIZES = [elementwise.ARRAY_SIZE_MIN - 1, elementwise.ARRAY_SIZE_MIN, 2000]
"""Small arrays are computed one by one, large ones by operations of arrays."""


def same_bits(values, expected):
    """Whether two sequences hold the same floats: 0 and -0 differ, any NaN equals any other."""
    values, expected = np.asarray(values), np.asarray(expected)
    both_nan = np.isnan(values) & np.isnan(expected)
    return ((values.view(np.int64) == expected.view(np.int64)) | both_nan).all()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["sin", "cos", "exp", "expm1", "log", "log1p", "tanh"])
def test_arrays_have_the_bits_of_numbers(name, size):
    function = getattr(elementary, name)
    x = np.array([*SPECIAL, *numbers(name)[:: 6000 // size]])[:size]
    assert same_bits(getattr(elementwise, name)(x), [function(number) for number in x.tolist()])
    rows = np.reshape(numbers(name)[:600], (3, -1))
    expected = [[function(number) for number in row] for row in rows.tolist()]
    np.testing.assert_array_equal(getattr(elementwise, name)(rows), expected)
    assert isinstance(getattr(elementwise, name)(0.5), float)


@pytest.mark.parametrize("size", SIZES)
def test_angles_of_arrays_have_the_bits_of_numbers(size):
    draw = random.Random(3)
    points = [(y, x) for y in SPECIAL for x in SPECIAL]
    points += [(draw.gauss(0, 1), draw.gauss(0, 1)) for _ in range(2000)]
    y, x = np.array(points)[:size].T.copy()
    expected = [elementary.atan2(*point) for point in points[:size]]
    assert same_bits(elementwise.atan2(y, x), expected)


def test_shapes_broadcast():
    angles = elementwise.atan2(np.ones((3, 1)), np.ones(2))
    np.testing.assert_array_equal(angles, np.full((3, 2), math.pi / 4))


def test_lengths_of_any_size():
    x = [3.0, 0.0, 0.0, 3e200, -3e-200, math.inf, math.nan]
    y = [4.0, 4.0, 0.0, -4e200, 4e-200, 1.0, 1.0]
    expected = [5.0, 4.0, 0.0, 5e200, 5e-200, math.inf, math.nan]
    np.testing.assert_allclose(elementwise.hypot(x, y), expected, rtol=1e-15)
    np.testing.assert_array_equal(elementwise.hypot(x, y), list(map(elementary.hypot, x, y)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "atan"])
def test_kernels_have_the_bits_of_plain_python(name):
    from numba import njit

    from tetractl.control.search.kernels import elementary as compiled
    from tetractl.tools.kernels.kernel_options import ENTRY_FAST

    function = getattr(compiled, name)

    @njit(**ENTRY_FAST)
    def fill(x, values):
        for i in range(x.size):
            values[i] = function(x[i])

    x = np.array(numbers(name))
    values = np.empty_like(x)
    fill(x, values)
    plain = getattr(elementary, name)
    np.testing.assert_array_equal(values, [plain(number) for number in x.tolist()])


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "expm1", "log1p", "tanh"])
def test_nan_stays_nan_without_a_warning(name):
    """Regression: the pose of an unseen cell ended a trial by a RuntimeWarning of NumPy."""
    values = getattr(elementwise, name)(np.array([np.nan, 0.5]))
    assert np.isnan(values[0])
    assert np.isfinite(values[1])


BITS = {
    "sin": "9c43f09c902c2d66",
    "cos": "8a5d98141b7e32e5",
    "exp": "9c8c291d896deeaf",
    "expm1": "eadec23d388846f3",
    "log": "64578fcb21eef452",
    "log1p": "98a12d2e57214507",
    "tanh": "9371c82afe0f3da1",
    "atan": "3cc6dc9b97d68206",
    "atan2": "254e2023626dd2f1",
    "hypot": "4aac897bb4d144ba",
}
"""The beginning of the SHA-256 of a function's values: trials in logs were computed with them."""


def digest(values):
    return hashlib.sha256(np.array(values, dtype="<f8").tobytes()).hexdigest()[:16]


@pytest.mark.parametrize("name", RANGES)
def test_a_function_has_the_bits_of_earlier_versions(name):
    """With other bits, even right ones, no trial in a log could be verified."""
    function = getattr(elementary, name)
    assert digest([function(x) for x in numbers(name)]) == BITS[name]


@pytest.mark.parametrize("name", ["atan2", "hypot"])
def test_a_function_of_two_numbers_has_the_bits_of_earlier_versions(name):
    draw = random.Random(11)
    points = [(draw.uniform(-5, 5), draw.uniform(-5, 5)) for _ in range(3000)]
    assert digest([getattr(elementary, name)(*point) for point in points]) == BITS[name]


def test_the_sum_of_likelihoods_of_any_size_is_that_of_their_logarithms():
    draw = random.Random(12)
    for _ in range(500):
        x, y = draw.uniform(0, 5), draw.uniform(0, 5)
        shift = draw.uniform(-900, 900)
        ours = elementary.log_of_sum(math.log(x) + shift, math.log(y) + shift)
        assert ours == pytest.approx(math.log(x + y) + shift, abs=1e-9)


@pytest.mark.parametrize("size", SIZES)
def test_lengths_of_arrays_have_the_bits_of_numbers(size):
    draw = random.Random(13)
    finite = [number for number in SPECIAL if math.isfinite(number)]
    points = [(y, x) for y in finite for x in finite]
    points += [(draw.gauss(0, 1), draw.gauss(0, 1)) for _ in range(2000)]
    y, x = np.array(points)[:size].T.copy()
    assert same_bits(elementwise.hypot(y, x), [elementary.hypot(*p) for p in points[:size]])
