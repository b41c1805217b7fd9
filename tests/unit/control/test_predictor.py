from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.control.delay import Predictor
from tetractl.control.estimator import Estimator
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.experiment.load import load_spec
from tetractl.plant.simulation import SimPlant

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"


def drive(settings, steps, after_step):
    """Drive the simulated robots in varying directions; after_step(k, plant, observation, u)."""
    experiment = load_spec(EXPERIMENT, settings).experiment
    clock = VirtualClock()
    plant = SimPlant(experiment.plant, experiment.setup, clock, np.random.SeedSequence(3))
    plant.open()
    directions = np.random.default_rng(1).uniform(-2, 2, steps)
    for k, direction in enumerate(directions):
        clock.sleep_until(k * SECOND // 5)
        observation = plant.observe()
        plant.steer(float(direction))
        after_step(k, plant, observation, float(direction))
    return experiment


def reference_problem():
    experiment = load_spec(EXPERIMENT).experiment
    return experiment.controller.problem(experiment.setup)


@pytest.mark.parametrize("dead_time", [0.0, 0.05, 0.2, 0.325])
def test_the_state_at_the_end_of_the_dead_time_is_known(dead_time):
    """What is predicted on a frame is what the cameras see one dead time later."""
    problem = reference_problem()
    predictor = Predictor(dead_time)
    predicted, seen = [], []

    def after_step(k, plant, observation, direction):
        here = replace(problem, poses=observation.poses)
        predicted.append((observation.sampled_ns, predictor.ahead(here, observation.sampled_ns)))
        predictor.sent(observation.sampled_ns, direction)
        seen.extend(plant.samples())

    drive([f"plant.dead_time={dead_time}"], 20, after_step)
    frames = {round(s.observation.sampled_ns / SECOND * 120): s.truth for s in seen}
    checked = 0
    for sampled_ns, poses in predicted:
        frame = (sampled_ns / SECOND + dead_time) * 120
        if round(frame) in frames and abs(frame - round(frame)) < 1e-6:
            truth = frames[round(frame)]
            assert poses.x == pytest.approx(truth.x, abs=1e-3)
            assert poses.heading == pytest.approx(truth.heading, abs=1e-5)
            checked += 1
    assert checked > 15


def test_robots_stand_before_the_first_command_acts():
    problem = reference_problem()
    predictor = Predictor(0.3)
    assert np.array_equal(predictor.ahead(problem, 0).x, problem.poses.x)
    predictor.sent(0, 0.0)
    assert np.array_equal(predictor.ahead(problem, 0).x, problem.poses.x)
    moved = predictor.ahead(problem, SECOND // 10).x - problem.poses.x
    assert moved == pytest.approx(0.1 * problem.speed, rel=1e-3)


def test_what_acted_is_forgotten_and_what_acts_is_kept():
    predictor = Predictor(0.1)
    for k in range(100):
        predictor.forget(k * SECOND // 5)
        predictor.sent(k * SECOND // 5, float(k))
    now = 99 * SECOND // 5
    assert predictor.held(now, now + SECOND // 10) == [(now, now + SECOND // 10, 98.0)]


def estimate(settings, steps):
    """Drive with an estimator watching; return what it found and the plant."""
    estimator, predictor = Estimator(reference_problem()), Predictor(0.0)
    last, seen = 0, {}

    def after_step(k, plant, observation, direction):
        nonlocal last
        held = predictor.held(last, observation.sampled_ns)
        seen["found"], seen["plant"] = estimator.update(observation, held), plant
        predictor.sent(observation.sampled_ns, direction)
        last = observation.sampled_ns

    drive(settings, steps, after_step)
    return seen["found"], seen["plant"]


@pytest.mark.parametrize("error", [0.0, 0.1, 0.25])
def test_a_and_speed_are_found_while_the_robots_move(error):
    found, plant = estimate([f"plant.a_error={error}", f"plant.speed_error={error}"], 30)
    assert found.a == pytest.approx(plant.a, rel=0.01)
    assert found.speed == pytest.approx(plant.speed, rel=0.01)


def test_lost_commands_do_not_lead_the_estimate_astray():
    found, plant = estimate(["plant.lost_commands=0.1"], 60)
    assert found.a == pytest.approx(plant.a, rel=0.1)
    assert found.speed == pytest.approx(plant.speed, rel=0.02)
