"""The closed loop of a plan, linearised: against simulations of the same noise."""

from dataclasses import replace

import numpy as np
import pytest
from support.plants import sim
from support.problems import problem, world
from support.trials import experiment

from tetractl.analysis.closed_loop import (
    Noise,
    end_covariance,
    information,
    left_out,
    linearise,
    mean_errors,
)
from tetractl.model.motion.exact import step

FINE = 10  # steps of the simulation in a control period
QUIET = Noise(0.0, 0.0, 0.0, 0.0, 0.0)


def plan(seed=4, length=30):
    posed = problem(world(seed, model="exact"))
    rng = np.random.default_rng(seed)
    signals = np.cumsum(rng.uniform(-0.4, 0.4, length))
    return posed, signals, linearise(posed, signals)


def test_without_noise_the_ends_are_the_planned_ones():
    _, _, linear = plan()
    assert not end_covariance(linear, QUIET).any()
    assert mean_errors(np.zeros((6, 6)), linear.miss) == pytest.approx(linear.miss)


def drive(posed, signals, a, speed, walk, rng):
    """Ends (M, 2N) of robots with a and speed (M, N), whose headings walk finely."""
    x, y, heading = (np.broadcast_to(p, a.shape) for p in posed.poses.array().T)
    for u in np.repeat(signals, FINE):
        t = posed.period / FINE
        x, y, heading = step(x, y, heading, np.array(u), a, speed, t)
        heading = heading + walk * np.sqrt(t) * rng.standard_normal(a.shape)
    return np.stack([x, y], axis=-1).reshape(len(a), -1)


@pytest.mark.parametrize(("which", "size"), [("a", 0.01), ("speed", 0.01), ("walk", 0.01)])
def test_errors_without_feedback_are_those_of_simulated_robots(which, size):
    posed, signals, linear = plan()
    rng = np.random.default_rng(1)
    factor = 1 + size * rng.standard_normal((4000, 3))
    a = posed.a * (factor if which == "a" else np.ones_like(factor))
    speed = posed.speed * (factor if which == "speed" else np.ones_like(factor))
    ends = drive(posed, signals, a, speed, size if which == "walk" else 0.0, rng)
    found = end_covariance(linear, replace(QUIET, **{which: size}), corrects=False)
    assert np.sqrt(np.diag(found)) == pytest.approx(np.std(ends, axis=0), rel=0.1, abs=0.01)


def test_feedback_and_identification_lower_the_error():
    _, _, linear = plan()
    noise = Noise(0.05, 0.05, 0.05, 0.5, 0.005)
    sums = [
        mean_errors(end_covariance(linear, noise, *how), linear.miss * 0).sum()
        for how in ((False, False), (True, False), (True, True))
    ]
    assert sums[0] > sums[1] > sums[2] > 0


def test_a_turn_is_known_as_well_as_the_two_headings_measured_about_it():
    _, _, linear = plan()
    errors = np.diff(np.random.default_rng(2).normal(0, 0.1, (2, 100_000)), axis=0)
    of_a = information(linear, replace(QUIET, heading=0.1), 5)[:3]
    assert of_a == pytest.approx(linear.turn_by_a[5] ** 2 / errors.var(), rel=0.02)


def test_the_mean_length_of_a_normal_vector():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 2))
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = root @ root.T
    covariance[2:, 2:] = np.diag([4.0, 0.0])
    drawn = (root @ rng.standard_normal((2, 200_000))).T
    ours = mean_errors(covariance, np.zeros(2))
    assert ours[0] == pytest.approx(np.hypot(*drawn.T).mean(), rel=0.01)
    assert ours[1] == pytest.approx(2 * np.sqrt(2 / np.pi))


def test_the_noise_is_the_plants():
    plant = {
        "type": "sim",
        "a_error": 0.3,
        "heading_noise": 0.1,
        "dead_time": 0.1,
        "measurement_noise": {"position": 2.0, "heading": 0.02},
        "disturbances": [{"type": "wobble", "radius": 8, "frequency": 1.5}],
    }
    spec = experiment(plant=plant)
    found = Noise.of(spec.plant)
    drawn = [np.log(sim(spec, seed).a / spec.setup.a) for seed in range(400)]
    assert found.a == pytest.approx(np.std(np.expm1(drawn)), rel=0.1)
    assert (found.speed, found.walk, found.position, found.heading) == (0, 0.1, 2, 0.02)
    assert left_out(spec.plant) == ("dead_time", "disturbances")


def test_robots_that_stand_have_no_error():
    posed, signals, _ = plan()
    still = linearise(replace(posed, speed=np.zeros(3)), signals)
    assert not mean_errors(end_covariance(still, Noise(0.1, 0.1, 0.1, 0.0, 0.0)), np.zeros(3)).any()
