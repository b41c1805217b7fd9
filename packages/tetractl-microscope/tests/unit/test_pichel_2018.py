"""Tests of the slope of turning rates against field strength, from simulated tracks."""

import numpy as np
import pytest
from tetractl_microscope import pichel_2018
from tetractl_microscope.pichel_2018 import fit_slope, interval_width, misses_slope

SPREAD = 0.15  # of the slopes of cells: the standard deviation of their logarithm


def measured_slopes(rng, slope):
    """Slopes of cells measured with errors, and the errors' deviations; one in twenty is wrong."""
    count = 204
    lowest, highest = np.log([0.02, 0.3])
    deviations = np.exp(rng.uniform(lowest, highest, count))
    of_cells = slope * np.exp(rng.normal(0, SPREAD, count))
    slopes = of_cells + deviations * rng.standard_normal(count)
    wrong = rng.random(count) < 0.05
    return np.where(wrong, rng.uniform(-2, 4, count), slopes), deviations


def test_the_interval_holds_the_slope_put_in():
    rng = np.random.default_rng(1)
    holds = []
    widths = []
    for _ in range(200):
        slope = rng.uniform(0.5, 1.0)
        mean_slope = slope * np.exp(SPREAD**2 / 2)
        middle, low, high = fit_slope(*measured_slopes(rng, slope))
        assert low < middle < high
        holds.append(low <= mean_slope <= high)
        widths.append(high - low)
    assert np.mean(holds) >= 0.9
    assert np.mean(widths) < 0.06


@pytest.mark.slow
def test_simulated_tracks_give_the_slope_put_in(monkeypatch):
    monkeypatch.setattr(pichel_2018, "STRENGTHS_MT", (6.0,))
    monkeypatch.setattr(pichel_2018, "N_CELLS", 6)
    monkeypatch.setattr(pichel_2018, "N_REVERSALS", 2)
    tables = pichel_2018.simulate_tables(1, 0)
    assert len(tables["slopes"]) == 6
    assert np.median(tables["slopes"]) == pytest.approx(tables["put in"], rel=0.3)


def test_a_mean_of_equally_exact_slopes_has_the_usual_error():
    slopes = 0.7 + 0.1 * np.random.default_rng(5).standard_normal(400)
    middle, low, high = fit_slope(slopes, np.full(400, 0.05))
    assert middle == pytest.approx(slopes.mean(), abs=0.003)
    half = 1.96 * slopes.std() / np.sqrt(400)
    assert (high - low) / 2 == pytest.approx(half, rel=0.1)
    assert high - middle == pytest.approx(middle - low)


def test_exact_slopes_count_more_and_outliers_do_not_count():
    slopes = np.array([0.7, 0.71, 0.69, 0.7, 0.7, 1.5, 5.0])
    middle, _, _ = fit_slope(slopes, np.array([0.01, 0.01, 0.01, 0.01, 0.01, 2.0, 0.01]))
    assert middle == pytest.approx(0.7, abs=0.01)


def test_the_slope_that_was_put_in_is_missed_beyond_either_end_of_the_interval():
    rng = np.random.default_rng(8)
    slopes = 0.7 + 0.05 * rng.standard_normal(50)
    table = {"slopes": slopes.tolist(), "deviations": [0.02] * 50}
    _, low, high = fit_slope(slopes, np.full(50, 0.02))
    assert interval_width(table | {"put in": 0.7}) == pytest.approx(high - low)
    for put_in, missed in (
        (low - 1e-6, True),
        (low + 1e-6, False),
        (high - 1e-6, False),
        (high + 1e-6, True),
    ):
        assert misses_slope(table | {"put in": put_in}) is missed
