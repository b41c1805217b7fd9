"""Identification while driving: dead time, a, speed and heading bias of robots that are driven."""

from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.control.identify import FACTOR_MAX, Directions, Intervals, Prior, fit
from tetractl.control.knowledge import Knowledge
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.experiment.load import load_spec
from tetractl.model.motion.exact import step, turn
from tetractl.plant.simulation import SimPlant

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"
A, SPEED = np.array([6.0, 4.0, 3.0]), np.array([180.0, 200.0, 150.0])
PRIOR = Prior(A, SPEED, 0.0, 0.2, 0.15, 0.1, 0.05)


def know(settings, steps, rate=5):
    """Drive simulated robots in varying directions; return what is known of them, and the plant."""
    experiment = load_spec(EXPERIMENT, settings).experiment
    clock = VirtualClock()
    plant = SimPlant(experiment.plant, experiment.setup, clock, np.random.SeedSequence(3))
    plant.open()
    problem = experiment.controller.problem(experiment.setup)
    knowledge = Knowledge(problem, 1 / rate, 0.0, PRIOR, losses=False)
    knots = np.random.default_rng(1).uniform(-2, 2, steps * 5 // rate + 2)
    for k in range(steps):
        clock.sleep_until(k * SECOND // rate)
        knowledge.seen(plant.observe())
        u = float(np.interp(k * 5 / rate, np.arange(len(knots)), knots))
        knowledge.sent(plant.steer(u).sent_ns, u)
    assert knowledge.estimate is not None
    return knowledge.estimate, plant


@pytest.mark.parametrize("dead_time", [0.0, 0.05, 0.14, 0.26])
@pytest.mark.parametrize("rate", [5, 20])
def test_the_dead_time_is_found_from_nothing(dead_time, rate):
    found, _ = know([f"plant.dead_time={dead_time}", "plant.a_error=0.2"], 6 * rate, rate)
    assert found.dead_time == pytest.approx(dead_time, abs=0.005)


@pytest.mark.parametrize("error", [0.0, 0.1, 0.25])
def test_a_and_speed_are_found_while_the_robots_move(error):
    settings = [f"plant.a_error={error}", f"plant.speed_error={error}", "plant.dead_time=0.1"]
    found, plant = know(settings, 40)
    assert found.a == pytest.approx(plant.a, rel=0.01)
    assert found.speed == pytest.approx(plant.speed, rel=0.01)


def test_lost_commands_do_not_lead_the_estimate_astray():
    found, plant = know(["plant.lost_commands=0.1", "plant.dead_time=0.14"], 60)
    assert found.dead_time == pytest.approx(0.14, abs=0.015)
    assert found.a == pytest.approx(plant.a, rel=0.1)
    assert found.speed == pytest.approx(plant.speed, rel=0.02)


def record(a, tau, bias, count, seed, noise=0.0):
    """Intervals of robots driven in random directions, and these."""
    rng = np.random.default_rng(seed)
    period = 0.2
    when = period * np.arange(count + 1)
    u = rng.uniform(-2, 2, count + 1)
    heading, rows = np.zeros(3), []
    for k in range(2, count):
        before = heading
        for direction, seconds in ((u[k - 1], tau), (u[k], period - tau)):
            heading = step(0.0, 0.0, heading, direction + bias, a, 1.0, seconds)[2]
        rows.append((before, heading - before + noise * rng.standard_normal(3)))
    headings, turned = (np.array(column) for column in zip(*rows, strict=True))
    since = when[2:count]
    travelled = SPEED * period * np.sinc(turned / (2 * np.pi))
    usable = np.ones(turned.shape, dtype=np.bool_)
    intervals = Intervals(since, since + period, headings, turned, travelled, usable)
    return intervals, Directions(when, u)


def test_the_heading_bias_of_each_robot_is_found():
    bias = np.array([0.05, -0.03, 0.0])
    intervals, directions = record(A, 0.07, bias, 60, 4)
    guess = PRIOR.estimate()
    for _ in range(4):
        guess = fit(intervals, directions, PRIOR, guess, turn)
    assert guess.heading_bias == pytest.approx(bias, abs=0.002)
    assert guess.dead_time == pytest.approx(0.07, abs=0.001)


def test_the_deviations_are_of_the_size_of_the_errors():
    noise = np.sqrt(2 * 0.01**2 + 0.1**2 * 0.2)
    scores = []
    for seed in range(40):
        intervals, directions = record(A, 0.1, 0.0, 60, seed, noise)
        guess = PRIOR.estimate()
        for _ in range(4):
            guess = fit(intervals, directions, PRIOR, guess, turn)
        assert guess.dead_time is not None and guess.dead_time_std is not None
        late = (guess.dead_time - 0.1) / guess.dead_time_std
        scores.append([late, *((guess.a - A) / guess.a_std)])
    assert np.std(scores, axis=0) == pytest.approx(1.0, abs=0.35)


def test_a_stays_within_a_factor_of_the_prior_however_long_it_is_fitted():
    """A bound relative to the value before, step by step, would be none."""
    intervals, directions = record(20 * A, 0.0, 0.0, 40, 5)
    guess = PRIOR.estimate()
    for _ in range(60):
        guess = fit(intervals, directions, PRIOR, guess, turn)
    assert (guess.a <= FACTOR_MAX * A * (1 + 1e-9)).all()


def test_no_interval_is_no_news():
    nothing = Intervals(np.zeros(0), np.zeros(0), *np.zeros((3, 0, 3)), np.zeros((0, 3), np.bool_))
    guess = PRIOR.estimate()
    assert fit(nothing, Directions(np.zeros(1), np.zeros(1)), PRIOR, guess, turn) is guess


def test_a_wrong_dead_time_believed_to_be_sure_is_looked_for_again():
    """With as many intervals as make a doubling; with one more the wrong minimum is kept."""
    wrong = replace(PRIOR.estimate(), dead_time=0.27, dead_time_std=0.001)
    for count, found in ((64, 0.07), (65, 0.27)):
        intervals, directions = record(A, 0.07, 0.0, count + 2, 4)
        assert len(intervals.since) == count
        fitted = fit(intervals, directions, PRIOR, wrong, turn)
        assert fitted.dead_time == pytest.approx(found, abs=0.05)
