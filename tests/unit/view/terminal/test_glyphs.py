"""Tests of arrows, bars and curves that are drawn with characters."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.view.terminal.glyphs import (
    FILLED_CHARACTER,
    FUTURE_CHARACTER,
    OPEN_CHARACTER,
    SPARK_CHARACTERS,
    choose_arrow,
    draw_bar,
    draw_sparkline,
)

NAMED = {0: "→", 45: "↗", 90: "↑", 135: "↖", 180: "←", 225: "↙", 270: "↓", 315: "↘"}


@pytest.mark.parametrize(("degrees", "character"), NAMED.items())
def test_an_arrow_points_where_its_angle_does_up_to_half_an_eighth_of_a_turn(degrees, character):
    for off in (-22, 0, 22):
        for turns in (-2, 0, 1):
            assert choose_arrow(math.radians(degrees + off + 360 * turns)) == character


@given(st.sampled_from([math.nan, math.inf, -math.inf]))
def test_an_unknown_angle_points_along_x(angle):
    assert choose_arrow(angle) == "→"


@given(st.integers(0, 40), st.floats(-2, 3))
def test_a_bar_is_filled_by_its_fraction_and_always_as_wide(width, fraction):
    text = draw_bar(width, fraction, "red").plain
    filled = text.count(FILLED_CHARACTER)
    assert text == FILLED_CHARACTER * filled + OPEN_CHARACTER * (width - filled)
    assert abs(filled - width * min(max(fraction, 0), 1)) <= 0.5


def test_a_bar_of_an_unknown_fraction_is_filled():
    for unknown in (math.nan, math.inf):
        assert draw_bar(5, unknown, "red").plain == FILLED_CHARACTER * 5
    assert draw_bar(5, 0.0, "red").plain == OPEN_CHARACTER * 5


def heights(text):
    """The height of each bar of a curve, None for what is to come."""
    return [None if c == FUTURE_CHARACTER else SPARK_CHARACTERS.index(c) for c in text.plain]


def test_a_curve_begins_at_0_and_its_greatest_value_is_the_highest_bar():
    assert heights(draw_sparkline([0, 1, 2, 3, 4, 5, 6, 7], 8)) == [0, 1, 2, 3, 4, 5, 6, 7]
    assert heights(draw_sparkline([7.0, 14.0], 8)) == [4, 7]  # 3.5 is rounded to even
    assert heights(draw_sparkline([-5.0, 7.0], 8)) == [0, 7]


def test_a_curve_on_a_logarithmic_scale_begins_at_its_least_value():
    assert heights(draw_sparkline([1, 10, 100, 1e7], 8, log=True)) == [0, 1, 2, 7]
    assert heights(draw_sparkline([0.0, 1e-12, 1.0], 8, log=True)) == [0, 0, 7]


def test_a_flat_curve_is_low_and_an_unknown_value_is_high():
    assert heights(draw_sparkline([0.0, 0.0], 4)) == [0, 0]
    assert heights(draw_sparkline([5.0, 5.0], 4, log=True)) == [0, 0]
    assert heights(draw_sparkline([0.0, math.nan, 2.0, math.inf], 4)) == [0, 7, 7, 7]


@pytest.mark.parametrize(("values", "width"), [([], 5), ([math.nan], 5), ([1.0], 0), ([1.0], -2)])
def test_nothing_known_is_to_come(values, width):
    assert draw_sparkline(values, width).plain == FUTURE_CHARACTER * max(width, 0)


@given(
    st.lists(st.floats(0, 1e6), min_size=1, max_size=60),
    st.integers(1, 30),
    st.integers(0, 90),
    st.booleans(),
)
def test_a_curve_is_as_wide_as_its_values_and_those_to_come_need_and_no_wider(
    values, width, total, log
):
    shown = heights(draw_sparkline(values, width, total=total, log=log))
    assert len(shown) == min(width, max(total, len(values)))
    drawn = [height for height in shown if height is not None]
    assert shown[len(drawn) :] == [None] * (len(shown) - len(drawn))
    if total <= len(values):
        assert len(drawn) == len(shown)
    share = len(values) / max(total, len(values)) * len(shown)
    assert abs(len(drawn) - share) < 1


def test_a_cell_has_its_newest_value():
    rising = np.arange(16.0)
    assert heights(draw_sparkline(rising, 8)) == [round(value * 7 / 15) for value in rising[1::2]]
    assert heights(draw_sparkline(rising[:7], 8, total=16))[:4] == [1, 4, 6, 7]
