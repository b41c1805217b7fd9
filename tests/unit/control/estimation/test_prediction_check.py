"""Tests of the size and the direction of deviations from predictions."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.control.estimation.prediction_check import AHEAD_S, PredictionCheck, SentStep
from tetractl.control.search.evaluate import compiled_prediction
from tetractl.core.clock import SECOND
from tetractl.core.poses import Observation, Poses

pytestmark = pytest.mark.slow  # compiles

PERIOD_S = 0.05
FINE = 10  # steps of the true motion in a control period
STEPS = 160
SPEC = experiment()
PROBLEM = replace(SPEC.controller.problem(SPEC.setup), motion="exact")
ROBOTS = len(PROBLEM.a)


def errors(late_s=0.0, a_factor=1.0, speed_factor=1.0, aside_s=0.0, seen=True):
    """Let robots drive with another motion than the model's, and return the prediction errors.

    Args:
        late_s: How much later than the model assumes directions act on them [s].
        a_factor: Their turning rates, as multiples of the model's.
        speed_factor: Their speeds, likewise.
        aside_s: How fast they slide to the left, as a multiple of their speed.
        seen: Whether the camera sees all of them.
    """
    fine_s = PERIOD_S / FINE
    random = np.random.default_rng(1)
    directions = np.repeat(random.uniform(-3, 3, STEPS // 4), 4)
    late = round(late_s / fine_s)
    acting = np.repeat(directions, FINE)
    acting = np.concatenate([np.full(late, directions[0]), acting])[: STEPS * FINE]
    truth = replace(
        PROBLEM,
        a=a_factor * PROBLEM.a,
        speed=speed_factor * PROBLEM.speed,
        period=fine_s,
        first_period=fine_s,
    )
    path = compiled_prediction(truth, acting).path
    heading = path[:-1, :, 2]
    slide = aside_s * fine_s * PROBLEM.speed * np.array([-np.sin(heading), np.cos(heading)])
    path[1:, :, :2] += np.cumsum(slide, axis=1).transpose(1, 2, 0)
    test = PredictionCheck(PERIOD_S)
    for k, direction in enumerate(directions):
        acts_ns = round(k * PERIOD_S * SECOND)
        poses = Poses.from_array(path[k * FINE])
        valid = np.full(ROBOTS, seen)
        frame = Observation(k, acts_ns, acts_ns, poses, valid)
        step = SentStep(replace(PROBLEM, poses=poses), float(direction), acts_ns)
        test.add_step(step, frame)
    return test.errors()


def test_robots_that_move_as_predicted_do_not_deviate():
    found = errors()
    assert found is not None
    assert found.ahead_s == AHEAD_S
    np.testing.assert_allclose(found.rms, 0, atol=1e-6)


@pytest.mark.parametrize("late_s", [0.05, 0.1])
def test_late_turns_are_found_with_about_their_lateness(late_s):
    found = errors(late_s=late_s)
    assert found is not None
    assert np.isnan(found.extra_turn).all()
    np.testing.assert_allclose(found.late_s, late_s, rtol=0.5)


@pytest.mark.parametrize("a_factor", [0.8, 1.2])
def test_another_turning_rate_is_found_with_its_direction(a_factor):
    found = errors(a_factor=a_factor)
    assert found is not None
    assert np.isnan(found.late_s).all()
    assert (np.sign(found.extra_turn) == np.sign(a_factor - 1)).all()
    assert (np.abs(found.extra_turn) < 1.5 * abs(a_factor - 1)).all()


def test_slow_robots_are_behind_and_sliding_ones_to_the_left():
    slow = errors(speed_factor=0.9)
    aside = errors(aside_s=0.1)
    assert slow is not None
    assert aside is not None
    way = PROBLEM.speed * AHEAD_S
    np.testing.assert_allclose(slow.mean[:, 0], -0.1 * way, rtol=0.3)
    np.testing.assert_allclose(aside.mean[:, 1], 0.1 * way, rtol=0.3)
    assert (np.abs(slow.mean[:, 1]) < 0.02 * way).all()


def test_nothing_is_concluded_from_robots_that_are_not_seen():
    assert errors(seen=False) is None
