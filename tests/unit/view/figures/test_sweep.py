"""Tests of the figure of a study: where its marks are, and when a line connects them."""

import numpy as np
import pytest
from testkit.drawn import lines

from tetractl.statistics.estimate import ArmErrors
from tetractl.view.figures.sweep import study_errors_figure

pytestmark = pytest.mark.slow

ERRORS = np.array([10.0, 12.0, 15.0, 30.0])


def arm(value, scale=1.0, arms=1, errors=ERRORS):
    return ArmErrors.from_errors(value, str(value), arms, scale * errors)


def figure_of(curves, field="x", only=True):
    (axes,) = study_errors_figure(curves, field, "mm", only).axes
    return axes


def curve(axes, name):
    (line,) = lines(axes, label=name)
    return line


def test_a_curve_has_the_mean_of_each_value_at_its_value_with_its_trials_and_interval():
    arms = [arm(1, 1.0), arm(2, 2.0), arm(4, 0.5)]
    axes = figure_of({"ours": arms})
    line = curve(axes, "ours")
    assert list(line.get_xdata()) == [1.0, 2.0, 4.0]
    assert list(line.get_ydata()) == [one.error.mean for one in arms]
    (dots,) = lines(axes, gid="trials")
    assert list(dots.get_xdata()) == [1.0] * 4 + [2.0] * 4 + [4.0] * 4
    assert list(dots.get_ydata()) == [e for one in arms for e in one.errors]
    (intervals,) = axes.collections
    ends = [segment[:, 1].tolist() for segment in intervals.get_segments()]
    assert ends == [[one.error.ci95.low, one.error.ci95.high] for one in arms]
    assert axes.get_ylim()[0] == 0
    assert axes.get_ylabel() == "total error [mm]"


def test_a_value_without_an_interval_has_none():
    arms = [arm(1), arm(2, errors=np.array([10.0, 20.0]))]
    (intervals,) = figure_of({"ours": arms}).collections
    assert [segment[0, 0] for segment in intervals.get_segments()] == [1.0]


@pytest.mark.parametrize(
    ("values", "counts", "only", "connected"),
    [
        ((1, 2), (1, 1), True, True),
        ((1, 2), (1, 1), False, False),  # arms differ in more than the field
        ((1, 2), (3, 3), False, True),
        ((1, 2), (3, 2), False, False),
        ((1, 2), (3, 2), True, False),
        (("a", "b"), (1, 1), True, False),
    ],
)
def test_a_line_connects_numbers_whose_arms_differ_in_nothing_else(values, counts, only, connected):
    arms = [arm(value, arms=count) for value, count in zip(values, counts, strict=True)]
    line = curve(figure_of({"ours": arms}, only=only), "ours")
    assert line.get_linestyle() == ("-" if connected else "None")


@pytest.mark.parametrize(
    ("values", "scale"),
    [((1, 32), "log"), ((1, 31), "linear"), ((0, 100), "linear"), ((-1, 100), "linear")],
)
def test_values_over_more_than_one_and_a_half_decades_have_a_logarithmic_axis(values, scale):
    assert figure_of({"ours": [arm(value) for value in values]}).get_xscale() == scale


@pytest.mark.parametrize(("count", "labelled"), [(8, True), (9, False)])
def test_each_of_few_values_has_a_tick_with_its_text(count, labelled):
    axes = figure_of({"ours": [arm(1 + value / 10) for value in range(count)]})
    texts = [label.get_text() for label in axes.get_xticklabels()]
    assert (texts == [str(1 + value / 10) for value in range(count)]) == labelled


def test_words_stand_in_their_order_side_by_side():
    axes = figure_of({"ours": [arm("euler"), arm("exact"), arm("x" * 40)]})
    texts = [label.get_text() for label in axes.get_xticklabels()]
    assert texts == ["euler", "exact", "x" * 24]
    assert list(curve(axes, "ours").get_xdata()) == [0.0, 1.0, 2.0]
    assert axes.get_xlim() == (-0.5, 2.5)


@pytest.mark.parametrize(("scale", "axis"), [(1.0, "linear"), (100.0, "log")])
def test_errors_that_span_orders_have_a_logarithmic_axis_that_shows_all_of_them(scale, axis):
    axes = figure_of({"ours": [arm(1), arm(2, scale)]})
    assert axes.get_yscale() == axis
    low, high = axes.get_ylim()
    assert low < 10.0 and high > 30 * scale


def shifts_in(axes, name):
    """How far a curve is drawn beside its values [in]."""
    line = curve(axes, name)
    x, _ = line.get_transform().transform((1.0, 10.0)) - axes.transData.transform((1.0, 10.0))
    return x / axes.figure.dpi


def test_curves_are_beside_each_other_around_their_values_and_arms_are_not_shifted():
    curves = {name: [arm(1), arm(2)] for name in ("a", "b", "c")}
    axes = figure_of(curves)
    left, middle, right = (shifts_in(axes, name) for name in curves)
    assert middle == pytest.approx(0)
    assert left == pytest.approx(-right)
    assert right > 0
    alone = figure_of({"a": [arm("x=1"), arm("x=2")]}, field="")
    assert shifts_in(alone, "a") == pytest.approx(0)
