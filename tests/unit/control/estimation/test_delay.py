"""Tests of predicting the state over the dead time without identification."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from testkit.paths import ROOT

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.estimation.prior import certain_prior
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Command, Steer
from tetractl.core.poses import Observation
from tetractl.plant.simulation import SimPlant
from tetractl.spec.load import load_spec

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"


def drive(settings, steps, after_step):
    """Drive the simulated robots in varying directions, 5 a second; `after_step(plant, observation,
    send)` is called at each step, and `send()` sends its direction and returns the command."""
    experiment = load_spec(EXPERIMENT, settings).experiment
    clock = VirtualClock()
    plant = SimPlant(experiment.plant, experiment.setup, clock, np.random.SeedSequence(3))
    plant.open()
    directions = np.random.default_rng(1).uniform(-2, 2, steps)
    for k, direction in enumerate(directions):
        clock.sleep_until(k * SECOND // 5)
        observation = plant.observe()
        send = partial(plant.send, Steer(float(direction)))
        after_step(plant, observation, send)


def estimator(dead_time, **prior):
    experiment = load_spec(EXPERIMENT).experiment
    problem = experiment.controller.problem(experiment.setup)
    only_dead_time = certain_prior(problem, dead_time)._replace(**prior)
    return problem, StateEstimator(problem, 0.2, only_dead_time)


def seen(problem, at_s, **poses):
    when = round(at_s * SECOND)
    valid = np.ones(len(problem.a), dtype=np.bool_)
    return Observation(0, when, when, replace(problem.poses, **poses), valid)


def command(u, at_s):
    return Command(Steer(u), round(at_s * SECOND), (True,) * 3)


@pytest.mark.parametrize("dead_time", [0.0, 0.05, 0.2, 0.325])
def test_the_state_at_the_end_of_the_dead_time_is_known(dead_time):
    """What is predicted on a frame is what the cameras see one dead time later."""
    _, estimates = estimator(dead_time)
    predicted = []
    truths = {}  # true poses by the number of their frame, 120 a second
    last = None

    def after_step(plant, observation, send):
        nonlocal last
        motion = estimates.add_step(observation, last)
        predicted.append((observation.sampled_ns, motion.poses))
        last = send()
        for sample in plant.samples():
            number = round(sample.observation.sampled_ns / SECOND * 120)
            truths[number] = sample.truth

    drive([f"plant.dead_time={dead_time}"], 20, after_step)
    checked = 0
    for sampled_ns, poses in predicted:
        frame = (sampled_ns / SECOND + dead_time) * 120
        if round(frame) in truths and abs(frame - round(frame)) < 1e-6:
            truth = truths[round(frame)]
            assert poses.x == pytest.approx(truth.x, abs=0.1)
            assert poses.heading == pytest.approx(truth.heading, abs=1e-3)
            checked += 1
    assert checked > 15


@pytest.mark.parametrize(("last_s", "next_s"), [(0.9, 1.1), (0.7, 1.0), (1.2, 1.0)])
def test_the_next_direction_comes_a_period_after_the_last_if_that_is_near(last_s, next_s):
    problem, estimates = estimator(0.1, dead_time_std=0.02)
    estimates.add_command(command(0.0, last_s))
    assert estimates.sending_ns(seen(problem, 1.0)) == round(next_s * SECOND)
