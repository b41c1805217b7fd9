"""Tests of the limits of logarithmic axes, and of space for the names of categories."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from tetractl.view.figures.axes import (
    CHARACTER_IN,
    LINE_IN,
    LOG_FROM,
    name_categories,
    spans_orders,
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
        ([1.0, LOG_FROM], True),
        ([1.0, 0.99 * LOG_FROM], False),
        ([0.0, 1000.0], False),  # no logarithm
    ],
)
def test_errors_that_span_orders_need_a_logarithmic_axis(errors, spans):
    assert spans_orders(np.array(errors)) == spans
