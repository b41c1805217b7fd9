"""Tests of the regression of steps on commands, against full matrices and by its symmetries."""

import math
from dataclasses import astuple, dataclass, replace

import numpy as np
import pytest
from tetractl_identify.driven_steps import DEAD_TIME_UNIT_S
from tetractl_identify.robot_response import LAG_MAX_S, LAG_MIN_S
from tetractl_identify.step_regression import (
    DISTANCE_ERROR_RATIO,
    TURN_ERROR_RAD,
    ResponseParameters,
    whiten_distances,
    whiten_turns,
)

PARAMETERS = ResponseParameters(
    dead_time=0.12,
    turning_lag=0.1,
    speed_lag=0.05,
    heading_walk=0.02,
    way_walk=3.0,
    heading_noise=0.01,
    position_noise=0.8,
    clock_drift=1e-4,
)
STEPS = 40


@dataclass
class Steps:
    """Steps of a robot, with the integrals of what was sent in them; gaps part some of them."""

    distance_along: np.ndarray
    turned: np.ndarray
    sent: np.ndarray
    duration_s: np.ndarray
    neighbours: np.ndarray
    in_one_ratio: bool = False

    def integrals(self, *_):
        return self.sent


def steps(way_gain=1.1, turn_gain=0.9, in_one_ratio=False):
    rng = np.random.default_rng(5)
    duration_s = rng.uniform(0.1, 0.3, STEPS)
    sent = np.column_stack([200 * duration_s, rng.normal(0, 0.4, STEPS)])
    way = way_gain * sent[:, 0] + rng.normal(0, 0.5, STEPS)
    turned = turn_gain * sent[:, 1] + rng.normal(0, 0.005, STEPS)
    neighbours = np.arange(STEPS - 1) % 7 != 3
    return Steps(way, turned, sent, duration_s, neighbours, in_one_ratio)


def covariance(of, walk, noise, error):
    """The whole covariance: a walk, an error of each step, and poses shared by neighbours."""
    whole = np.diag(walk**2 * of.duration_s + error**2 + 2 * noise**2)
    for i, shares in enumerate(of.neighbours):
        whole[i, i + 1] = whole[i + 1, i] = -(noise**2) if shares else 0.0
    return whole


CASES = {"turns": (whiten_turns, "turned", 1), "ways": (whiten_distances, "distance_along", 0)}


@pytest.mark.parametrize("case", CASES)
def test_whitening_gives_the_quadratic_forms_of_the_whole_covariance(case):
    whiten, name, own = CASES[case]
    of = steps()
    p = PARAMETERS
    measured = getattr(of, name)
    whole = (
        covariance(of, p.heading_walk, p.heading_noise, TURN_ERROR_RAD)
        if own
        else covariance(
            of, p.way_walk, p.position_noise, DISTANCE_ERROR_RATIO * float(np.median(abs(measured)))
        )
    )
    whitened = whiten(of, p)
    both = np.column_stack([measured, of.sent])
    expected = both.T @ np.linalg.solve(whole, both)
    ours = np.column_stack([whitened.y, whitened.x])
    assert ours.T @ ours == pytest.approx(expected, rel=1e-9)
    assert whitened.ln_root_diagonal.sum() == pytest.approx(np.linalg.slogdet(whole)[1] / 2)
    assert whitened.own_column == own


@pytest.mark.parametrize(("way_gain", "turn_gain"), [(1.1, 0.9), (0.4, 2.5), (-0.8, -1.2)])
def test_the_gains_are_those_by_which_the_robot_follows(way_gain, turn_gain):
    of = steps(way_gain, turn_gain)
    of_speed = whiten_distances(of, PARAMETERS).fit_gains()
    of_turning = whiten_turns(of, PARAMETERS).fit_gains()
    assert of_speed[0] == pytest.approx(way_gain, abs=0.05)
    assert of_turning[1] == pytest.approx(turn_gain, abs=0.05)
    assert abs(of_speed[1]) < 5  # what turning adds to a distance [mm/rad]
    assert abs(of_turning[0]) < 1e-3  # what driving adds to a turn [rad/mm]


def test_a_length_unit_scales_out():
    of = steps()
    p = PARAMETERS
    metres = replace(p, way_walk=p.way_walk / 1000, position_noise=p.position_noise / 1000)
    in_metres = replace(of, distance_along=of.distance_along / 1000, sent=of.sent / [1000, 1])
    ours, theirs = whiten_distances(of, p), whiten_distances(in_metres, metres)
    assert ours.fit_gains()[0] == pytest.approx(theirs.fit_gains()[0])
    assert ours.fit_gains()[1] == pytest.approx(1000 * theirs.fit_gains()[1])
    same = whiten_turns(of, p).fit_gains()
    assert same[1] == pytest.approx(whiten_turns(in_metres, metres).fit_gains()[1])


def test_of_two_integrals_in_one_ratio_only_the_robots_own_counts():
    of = steps(in_one_ratio=True)
    of = replace(of, sent=np.column_stack([of.sent[:, 0], of.sent[:, 0] / 100]))
    gains = whiten_distances(of, PARAMETERS).fit_gains()
    assert gains[0] == pytest.approx(1.1, abs=0.05)
    assert gains[1] == pytest.approx(0.0, abs=1e-3)


def test_the_true_noise_is_likelier_than_others():
    of = steps()
    likelihoods = {
        noise: whiten_distances(of, replace(PARAMETERS, way_walk=0.01, position_noise=noise))
        for noise in (0.05, 0.4, 5.0)
    }
    values = {noise: w.compute_restricted_ln_likelihood() for noise, w in likelihoods.items()}
    assert max(values, key=values.get) == 0.4
    best = likelihoods[0.4]
    by_step = best.compute_ln_likelihoods(best.fit_gains())
    off = best.compute_ln_likelihoods(best.fit_gains() + np.array([0.05, 0.0]))
    assert by_step.shape == (STEPS,)
    assert by_step.sum() > off.sum()


def test_a_vector_of_zeros_means_the_units_and_no_drift():
    assert PARAMETERS.scaled_by(np.zeros(8)) == replace(PARAMETERS, clock_drift=0.0)
    away = PARAMETERS.scaled_by(np.array([2.0, 0.5, -0.5, 1.0, -1.0, 1.0, -1.0, 3.0]))
    factors = [math.exp(value) for value in (0.5, -0.5, 1.0, -1.0, 1.0, -1.0)]
    assert away.dead_time == pytest.approx(0.12 + 2 * DEAD_TIME_UNIT_S)
    expected = [
        unit * factor for unit, factor in zip(astuple(PARAMETERS)[1:7], factors, strict=True)
    ]
    assert astuple(away)[1:7] == pytest.approx(expected)
    assert away.clock_drift == pytest.approx(3e-4)


def test_lags_stay_within_those_that_are_tried():
    vector = np.zeros(8)
    vector[1:3] = 99.0
    slow = PARAMETERS.scaled_by(vector)
    quick = PARAMETERS.scaled_by(-vector)
    assert (slow.turning_lag, slow.speed_lag) == (LAG_MAX_S, LAG_MAX_S)
    assert (quick.turning_lag, quick.speed_lag) == (LAG_MIN_S, LAG_MIN_S)
