"""Tests of the slope of turning rates against field strength, from simulated tracks."""

import numpy as np
import pytest
from tetractl_microscope import pichel_2018
from tetractl_microscope.pichel_2018 import fitted

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
        middle, low, high = fitted(*measured_slopes(rng, slope))
        assert low < middle < high
        holds.append(low <= mean_slope <= high)
        widths.append(high - low)
    assert np.mean(holds) >= 0.9
    assert np.mean(widths) < 0.06


@pytest.mark.slow
def test_simulated_tracks_give_the_slope_put_in(monkeypatch):
    monkeypatch.setattr(pichel_2018, "STRENGTHS_MT", (6.0,))
    monkeypatch.setattr(pichel_2018, "CELLS", 6)
    monkeypatch.setattr(pichel_2018, "REVERSALS", 2)
    tables = pichel_2018.tables(1, 0)
    assert len(tables["slopes"]) == 6
    assert np.median(tables["slopes"]) == pytest.approx(tables["put in"], rel=0.3)
