"""Tests of what is assumed before robots move, as an estimate."""

import math

import numpy as np
import pytest
from testkit import problems

from tetractl.control.estimation.prior import Prior, certain_prior

PRIOR = Prior(
    a=np.array([4.0, 5.0]),
    speed=np.array([100.0, 200.0]),
    dead_time=0.1,
    a_std=0.2,
    speed_std=0.05,
    dead_time_std=0.03,
    heading_bias_std=0.3,
    marker_bias_std=0.4,
    lag=0.05,
)


def test_the_estimate_has_the_means_and_absolute_deviations():
    estimate = PRIOR.estimate()
    assert estimate.a.tolist() == [4, 5]
    assert estimate.a_std == pytest.approx([0.8, 1.0])
    assert estimate.speed.tolist() == [100, 200]
    assert estimate.speed_std == pytest.approx([5, 10])
    assert estimate.heading_bias.tolist() == [0, 0]
    assert estimate.heading_bias_std == pytest.approx([0.5, 0.5])  # of both, at right angles
    assert (estimate.dead_time, estimate.dead_time_std) == (0.1, 0.03)


def test_a_lag_is_said_only_if_it_is_learnt():
    assert PRIOR.estimate().lag is None
    assert PRIOR._replace(lag_is_learnt=True).estimate().lag.tolist() == [0.05, 0.05]


@pytest.mark.parametrize(
    ("radius", "frequency", "swims"),
    [(8.0, 2.5, True), (0.0, 2.5, False), (8.0, 0.0, False), (0.0, 0.0, False)],
)
def test_cells_are_robots_whose_helix_is_known_in_both_numbers(radius, frequency, swims):
    assert PRIOR._replace(helix_radius=radius, helix_frequency=frequency).swims == swims


def test_a_motion_is_certain_if_its_dead_time_is():
    assert not PRIOR.certain
    problem = problems.problem(problems.world(1))
    prior = certain_prior(problem, 0.2)
    assert prior.certain
    assert prior.watchdog == math.inf
    estimate = prior.estimate()
    assert estimate.a.tolist() == problem.a.tolist()
    assert estimate.speed.tolist() == problem.speed.tolist()
    for std in (estimate.a_std, estimate.speed_std, estimate.heading_bias_std):
        assert not std.any()
    assert (estimate.dead_time, estimate.dead_time_std) == (0.2, 0)
