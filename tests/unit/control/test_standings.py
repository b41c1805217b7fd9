"""How often robots are found to stand in a trial."""

import numpy as np
import pytest

from tetractl.control.standings import HALF_KNOWN_S, Standings
from tetractl.core.plan import Estimate

RATES = np.ones(2)


def stands(*probability):
    return Estimate(RATES, RATES, RATES, RATES, stands=np.array(probability))


def rate_after(steps, period_s, passed_s=20.0):
    """The rate after steps in which red and blue stand with some probabilities."""
    standings = Standings(["red", "blue"], period_s)
    for k, probability in enumerate(steps):
        standings.see(stands(*probability), period_s * k)
    return standings.rate_hz(passed_s)


def test_each_time_that_a_robot_begins_to_stand_counts_once():
    steps = (0.1, 0.1), (0.95, 0.1), (0.95, 0.1), (0.95, 0.93), (0.0, 0.93), (0.92, 0.93)
    # red in the second step, blue in the fourth, and red again in the last
    assert rate_after(steps, period_s=0.2) == pytest.approx(3 / (20.0 + HALF_KNOWN_S))


def test_a_robot_that_stands_by_four_chances_in_five_does_not_count():
    """Regression: where pictures came late, robots that drove were found to stand with up to 0.8,
    and trials ended up to 51 mm off for shorter plans."""
    assert rate_after([(0.8, 0.1), (0.1, 0.8), (0.8, 0.8)], period_s=0.2) == 0.0


def test_robots_that_their_watchdog_stopped_for_a_moment_do_not_count():
    """Regression: where robots missed many commands their watchdogs stopped them, and trials ended
    early as if they stuck in every plan."""
    steps = [(0.0, 0.0), *[(0.95, 0.95)] * 3] * 4  # three control periods of 50 ms each
    assert rate_after(steps, period_s=0.05) == 0.0


def test_robots_that_stand_for_a_quarter_of_a_second_count():
    steps = [(0.0, 0.0), *[(0.95, 0.1)] * 5]
    assert rate_after(steps, period_s=0.05) == pytest.approx(1 / (20.0 + HALF_KNOWN_S))


def test_robots_that_never_stand_or_of_which_nothing_is_estimated_have_no_rate():
    standings = Standings(["red", "blue"], 0.2)
    standings.see(stands(0.4, 0.5), 0.0)
    standings.see(None, 1.0)
    assert standings.rate_hz(0.0) == 0.0
