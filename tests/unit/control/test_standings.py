"""How often robots are found to stand in a trial."""

import numpy as np
import pytest

from tetractl.control.standings import HALF_KNOWN_S, Standings
from tetractl.core.plan import Estimate

RATES = np.ones(2)


def stands(*probability):
    return Estimate(RATES, RATES, RATES, RATES, stands=np.array(probability))


def test_each_time_that_a_robot_begins_to_stand_counts_once():
    standings = Standings(["red", "blue"])
    for probability in ((0.95, 0.1), (0.95, 0.1), (0.95, 0.93), (0.0, 0.93), (0.92, 0.93)):
        standings.see(stands(*probability))
    # red at first, blue in the third step, and red again in the fifth
    assert standings.rate_hz(20.0) == pytest.approx(3 / (20.0 + HALF_KNOWN_S))


def test_a_robot_that_stands_by_four_chances_in_five_does_not_count():
    """Regression: where pictures came late, robots that drove were found to stand with up to 0.8,
    and trials ended up to 51 mm off for shorter plans."""
    standings = Standings(["red", "blue"])
    for probability in ((0.8, 0.1), (0.1, 0.8), (0.8, 0.8)):
        standings.see(stands(*probability))
    assert standings.rate_hz(20.0) == 0.0


def test_robots_that_never_stand_or_of_which_nothing_is_estimated_have_no_rate():
    standings = Standings(["red", "blue"])
    standings.see(stands(0.4, 0.5))
    standings.see(None)
    assert standings.rate_hz(0.0) == 0.0
