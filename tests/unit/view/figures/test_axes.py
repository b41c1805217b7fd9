"""Tests of the limits of logarithmic axes, and of space for the names of categories."""

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tetractl.view.figures.axes import (
    CHARACTER_IN,
    LINE_IN,
    LOG_RATIO_MIN,
    name_categories,
    needs_log_axis,
    positive,
    set_log_axis,
)

pytestmark = pytest.mark.slow


@pytest.fixture
def axes():
    figure, axes = plt.subplots(figsize=(6.0, 3.0))
    yield axes
    plt.close(figure)


@pytest.mark.parametrize(
    ("names", "lines"),
    [(["a", "b"], 0), (["arm-x=1", "arm-x=2"], 1), (["arm-x=1-y=2-z=3", "base"], 3)],
)
def test_a_figure_is_taller_by_the_further_lines_of_its_names(axes, names, lines):
    name_categories(axes, names, width_in=6.0)
    assert axes.figure.get_figheight() == pytest.approx(3.0 + lines * LINE_IN)
    texts = [label.get_text() for label in axes.get_xticklabels()]
    assert [text.replace("\n", "-") for text in texts] == names
    assert {label.get_rotation() for label in axes.get_xticklabels()} == {0.0}
    assert axes.get_xlim() == (-0.5, len(names) - 0.5)


def test_names_that_are_too_long_are_upright_and_take_their_length(axes):
    names = ["a-rather-long-name-of-an-arm"] * 4 + ["short"]
    name_categories(axes, names, width_in=2.0)
    assert axes.figure.get_figheight() == pytest.approx(3.0 + CHARACTER_IN * len(names[0]))
    assert {label.get_rotation() for label in axes.get_xticklabels()} == {90.0}


@pytest.mark.parametrize(
    ("errors", "spans"),
    [
        ([1.0, 2.0], False),
        ([1.0, LOG_RATIO_MIN], True),
        ([1.0, 0.99 * LOG_RATIO_MIN], False),
        ([0.0, 1000.0], False),  # no logarithm
    ],
)
def test_errors_that_span_orders_need_a_logarithmic_axis(errors, spans):
    assert needs_log_axis(np.array(errors)) == spans


POSITIVE = st.lists(st.floats(1e-9, 1e9), min_size=1, max_size=6)


@settings(max_examples=20)
@given(POSITIVE, st.floats(0, 0.5), st.floats(0, 0.5))
def test_a_logarithmic_axis_extends_beyond_its_values_by_fractions_of_their_range(
    values, below, above
):
    drawn = Figure().add_subplot()
    set_log_axis(drawn, np.array([np.nan, *values]), below, above)
    low, high = drawn.get_ylim()
    least, greatest = min(values), max(values)
    assert low <= least and greatest <= high
    if greatest > 1.11 * least:
        span = math.log(greatest / least)
        assert math.log(least / low) == pytest.approx(below * span, abs=1e-6)
        assert math.log(high / greatest) == pytest.approx(above * span, abs=1e-6)
    if greatest <= 1.1 * least:
        assert low < least / 1.049 and high > greatest * 1.049


def test_a_logarithmic_axis_without_values_has_limits():
    drawn = Figure().add_subplot()
    set_log_axis(drawn, np.full(3, np.nan), 0.1, 0.1)
    low, high = drawn.get_ylim()
    assert 0 < low < 0.1 and high > 10


@pytest.mark.parametrize(
    ("low", "high", "shows"),
    [
        (10.0, 49.0, {10, 20, 30, 40}),  # even ticks
        (10.0, 60.0, {10, 20, 50}),
        (10.0, 9000.0, {10, 20, 50, 100, 200, 500, 1000, 2000, 5000}),
        (10.0, 11000.0, {10, 100, 1000, 10000}),
    ],
)
def test_the_ticks_of_a_logarithmic_axis_fit_the_ratio_of_its_limits(low, high, shows):
    drawn = Figure().add_subplot()
    set_log_axis(drawn, np.array([low, high]), 0.0, 0.0)
    ticks = {float(f"{tick:.6g}") for tick in drawn.get_yticks() if low <= tick <= high}
    assert ticks == shows


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (1e-3, 10.0, "0.01"),
        (0.9e-3, 10.0, "10^{-2}"),
        (1e-2, 1e5, "0.01"),
        (1e-2, 1.1e5, "10^{-2}"),
        (1e-5, 4e-5, "0.01"),  # a small ratio is always decimal
    ],
)
def test_numbers_are_decimal_in_the_usual_range_and_powers_of_ten_beyond(low, high, text):
    drawn = Figure().add_subplot()
    set_log_axis(drawn, np.array([low, high]), 0.0, 0.0)
    assert text in drawn.yaxis.get_major_formatter()(0.01, 0)


def test_only_positive_finite_values_can_be_shown():
    shown = positive(np.array([-1.0, 0.0, 2.0, np.inf, np.nan]))
    assert np.isnan(shown).tolist() == [True, True, False, True, True]
    assert shown[2] == 2.0
