"""The state predicted over the dead time."""

from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT

from tetractl.control.delay import Predictor, advance
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


def ahead(predictor, problem, since, until):
    """The problem's poses, seen at `since`, as predicted for `until` [ns]."""
    return advance(problem, problem.poses, predictor.held(since, until))


@pytest.mark.parametrize("dead_time", [0.0, 0.05, 0.2, 0.325])
def test_the_state_at_the_end_of_the_dead_time_is_known(dead_time):
    """What is predicted on a frame is what the cameras see one dead time later."""
    problem = reference_problem()
    predictor = Predictor(dead_time, 3)
    predicted, seen = [], []

    def after_step(k, plant, observation, direction):
        here, now = replace(problem, poses=observation.poses), observation.sampled_ns
        predicted.append((now, ahead(predictor, here, now, now + predictor.delay_ns)))
        predictor.sent(now, direction)
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
    predictor = Predictor(0.3, 3)
    assert np.array_equal(ahead(predictor, problem, 0, SECOND).x, problem.poses.x)
    predictor.sent(0, 0.0)
    assert np.array_equal(ahead(predictor, problem, 0, 3 * SECOND // 10).x, problem.poses.x)
    moved = ahead(predictor, problem, 0, 4 * SECOND // 10).x - problem.poses.x
    assert moved == pytest.approx(0.1 * problem.speed, rel=1e-3)


def test_a_robot_that_a_command_did_not_arrive_at_follows_the_one_before():
    predictor = Predictor(0.1, 3)
    for k, u in enumerate([1.0, 2.0, 3.0]):
        predictor.sent(k * SECOND, u)
    predictor.recent[1].arrived[0] = False
    predictor.recent[2].arrived[:2] = False
    (held,) = predictor.held(2 * SECOND + SECOND // 5, 3 * SECOND)
    assert held[2].tolist() == [1.0, 2.0, 3.0]
    predictor.forget(3 * SECOND)
    assert [one.u for one in predictor.recent] == [3.0]
    assert predictor.held(3 * SECOND, 4 * SECOND)[0][2].tolist() == [1.0, 2.0, 3.0]


def test_what_acted_is_forgotten_and_what_acts_is_kept():
    predictor = Predictor(0.1, 1)
    for k in range(100):
        predictor.forget(k * SECOND // 5)
        predictor.sent(k * SECOND // 5, float(k))
    now = 99 * SECOND // 5
    assert len(predictor.recent) == 2
    ((since, until, u),) = predictor.held(now, now + SECOND // 10)
    assert (since, until, u.tolist()) == (now, now + SECOND // 10, [98.0])
