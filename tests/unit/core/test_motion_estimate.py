"""Tests of what an estimate of the motion says: who stands, and what the model fails to explain."""

import numpy as np
import pytest

from tetractl.core.motion_estimate import POSITION_INNOVATIONS, TURNING_INNOVATIONS, Estimate

NAMES = ("one", "two", "three")
ONES = np.ones(3)


def estimate(**fields):
    return Estimate(np.arange(3.0), ONES, ONES, ONES, **fields)


def test_a_robot_stands_if_that_is_almost_certain():
    assert estimate(stands=np.array([0.95, 0.9, 0.3])).list_standing(NAMES) == ["one"]
    assert estimate(stands=np.array([0.1, 0.91, 1.0])).list_standing(NAMES) == ["two", "three"]
    assert estimate(stands=np.zeros(3)).list_standing(NAMES) == []
    assert estimate().list_standing(NAMES) == []


MISFIT = np.array([[1.5, 0.2, 0.3], [0.1, 1.2, 1.0], [0.1, 0.2, 1.1]])
"""Of each robot: along its course, across it, of its heading."""


def test_a_part_of_the_motion_is_unexplained_above_one():
    found = estimate(misfit=MISFIT)
    assert found.list_unexplained(NAMES, TURNING_INNOVATIONS) == {"heading of three"}
    assert found.list_unexplained(NAMES, POSITION_INNOVATIONS) == {
        "along-track motion of one",
        "cross-track motion of two",
    }
    assert (
        estimate(misfit=np.ones((3, 3))).list_unexplained(
            NAMES, TURNING_INNOVATIONS + POSITION_INNOVATIONS
        )
        == set()
    )
    assert estimate().list_unexplained(NAMES, TURNING_INNOVATIONS) == set()


def test_the_common_lag_is_the_mean_if_it_is_estimated():
    assert estimate(lag=np.array([0.1, 0.2, 0.6])).common_lag == pytest.approx(0.3)
    assert estimate().common_lag is None


def test_an_estimate_of_some_robots_has_the_values_of_these():
    whole = estimate(
        misfit=MISFIT, lag=np.array([0.1, 0.2, 0.3]), dead_time=0.05, own_dead_time=np.arange(3.0)
    )
    some = whole.select_robots(np.array([False, True, True]))
    assert some.a.tolist() == [1, 2]
    assert some.misfit.tolist() == MISFIT[1:].tolist()
    assert some.lag.tolist() == [0.2, 0.3]
    assert some.own_dead_time.tolist() == [1, 2]
    assert (some.dead_time, some.side) == (0.05, None)
    assert whole.select_robots(np.ones(3, dtype=bool)) is whole
