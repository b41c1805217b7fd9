"""The slope of turning rates against the field's strength, from emulated films."""

from dataclasses import replace

import numpy as np
import pytest
from tetractl_emulator.pictures import pichel_2018
from tetractl_emulator.pictures.pichel_2018 import PAPER, fitted

from tetractl.reproduce.claim import Fate, assess


def made(rng, slope, count=204):
    """Slopes of cells that differ by 15 %, seen with errors; one in twenty is wrong."""
    deviations = np.exp(rng.uniform(np.log(0.02), np.log(0.3), count))
    slopes = slope * np.exp(rng.normal(0, 0.15, count)) + deviations * rng.standard_normal(count)
    wrong = rng.random(count) < 0.05
    return np.where(wrong, rng.uniform(-2, 4, count), slopes), deviations


def test_the_interval_holds_the_slope_put_in():
    rng = np.random.default_rng(1)
    held = 0
    widths = []
    for _ in range(200):
        slope = rng.uniform(0.5, 1.0)
        middle, low, high = fitted(*made(rng, slope))
        held += low <= slope * np.exp(0.15**2 / 2) <= high
        widths.append(high - low)
        assert low < middle < high
    assert held >= 180
    assert np.mean(widths) < 0.06


def test_a_set_that_misses_the_slope_is_told():
    one = {"put in": 0.5, "slopes": [0.7, 0.71, 0.72] * 9, "deviations": [0.1] * 27}
    width, missed = (assess(claim, {"films": [one] * 20}) for claim in PAPER.claims)
    assert width.verdict is Fate.REACHED
    assert missed.found.value == 1
    assert missed.verdict is Fate.MISSED


@pytest.mark.slow
def test_a_film_gives_the_slope_put_in(monkeypatch):
    monkeypatch.setattr(pichel_2018, "STRENGTHS_MT", (6.0,))
    monkeypatch.setattr(pichel_2018, "REVERSALS", 2)
    monkeypatch.setattr(pichel_2018, "CELLS", 6)
    monkeypatch.setattr(pichel_2018, "LOOK", replace(pichel_2018.LOOK, width=512, height=512))
    film_set = pichel_2018.films(1, 0)
    assert len(film_set["slopes"]) >= 3
    assert np.median(film_set["slopes"]) == pytest.approx(film_set["put in"], rel=0.3)
