"""Tests of the linearised closed loop of a plan against simulations with the same noise."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from testkit.plants import sim
from testkit.problems import problem, world
from testkit.trials import experiment
from tetractl_microscope.choice.closed_loop import (
    Linear,
    Noise,
    end_covariance,
    linearise,
    mean_errors,
)

from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.model.motion.exact import step

ROBOTS = 3
FINE = 10  # steps of the simulation in a control period
QUIET = Noise()


@dataclass(frozen=True)
class Plan:
    """Random signals [rad] for robots at random poses, and the plan linearised."""

    problem: Problem
    signals: Floats
    linear: Linear


@pytest.fixture
def plan():
    random_problem = problem(world(4, ROBOTS, model="exact"))
    changes = np.random.default_rng(4).uniform(-0.4, 0.4, 30)
    signals = np.cumsum(changes)
    return Plan(random_problem, signals, linearise(random_problem, signals))


def test_without_noise_the_ends_are_the_planned_ones(plan):
    assert not end_covariance(plan.linear, QUIET).any()
    no_covariance = np.zeros((2 * ROBOTS, 2 * ROBOTS))
    assert mean_errors(no_covariance, plan.linear.miss) == pytest.approx(plan.linear.miss)


def simulated_ends(plan, rng, a_factor=1.0, speed_factor=1.0, walk=0.0):
    """Ends (M, 2N) of M drives of robots whose a and speed are off by factors (M, N), and whose
    headings walk finely."""
    drives = (4000, ROBOTS)
    a = plan.problem.a * np.broadcast_to(a_factor, drives)
    speed = plan.problem.speed * np.broadcast_to(speed_factor, drives)
    step_s = plan.problem.period / FINE
    x, y, heading = (np.broadcast_to(start, drives) for start in plan.problem.poses.array().T)
    for direction in np.repeat(plan.signals, FINE):
        x, y, heading = step(x, y, heading, np.array(direction), a, speed, step_s)
        heading = heading + walk * np.sqrt(step_s) * rng.standard_normal(drives)
    return np.stack([x, y], axis=-1).reshape(len(a), -1)


@pytest.mark.parametrize("noisy", ["a_std", "speed_std", "heading_walk"])
def test_errors_without_feedback_are_those_of_simulated_robots(plan, noisy):
    rng = np.random.default_rng(1)
    factor = 1 + 0.01 * rng.standard_normal((4000, ROBOTS))
    changes = {
        "a_std": {"a_factor": factor},
        "speed_std": {"speed_factor": factor},
        "heading_walk": {"walk": 0.01},
    }[noisy]
    ends = simulated_ends(plan, rng, **changes)
    covariance = end_covariance(plan.linear, replace(QUIET, **{noisy: 0.01}), corrects=False)
    deviations = np.sqrt(np.diag(covariance))
    assert deviations == pytest.approx(np.std(ends, axis=0), rel=0.1, abs=0.01)


def test_feedback_and_identification_lower_the_error(plan):
    noise = Noise(
        a_std=0.05, speed_std=0.05, heading_walk=0.05, position_std=0.5, heading_std=0.005
    )

    def error(corrects, identifies):
        covariance = end_covariance(plan.linear, noise, corrects, identifies)
        return mean_errors(covariance, np.zeros(ROBOTS)).sum()

    open_loop = error(corrects=False, identifies=False)
    feedback = error(corrects=True, identifies=False)
    identification = error(corrects=True, identifies=True)
    assert open_loop > feedback > identification > 0


def test_the_mean_length_of_a_normal_vector_is_that_of_many_drawn():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 2))
    drawn = root @ rng.standard_normal((2, 200_000))
    (mean_length,) = mean_errors(root @ root.T, np.zeros(1))
    assert mean_length == pytest.approx(np.hypot(*drawn).mean(), rel=0.01)


@pytest.mark.long
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
    noise = Noise.from_plant(spec.plant)
    relative_errors = [sim(spec, seed).a / spec.setup.a - 1 for seed in range(400)]
    assert noise.a_std == pytest.approx(np.std(relative_errors), rel=0.1)
    assert noise.speed_std == 0
    assert noise.heading_walk == 0.1
    assert noise.position_std == 2
    assert noise.heading_std == 0.02


def test_the_mean_length_of_a_normal_vector_along_one_axis_is_that_of_a_half_normal():
    """sqrt(2/pi) times its standard deviation."""
    deviation = 2.0
    (mean_length,) = mean_errors(np.diag([deviation**2, 0.0]), np.zeros(1))
    assert mean_length == pytest.approx(deviation * np.sqrt(2 / np.pi))
