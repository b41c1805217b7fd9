"""Tests of the linearised closed loop of a plan against simulations with the same noise."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from testkit.plants import sim
from testkit.problems import problem, world
from testkit.trials import experiment
from tetractl_microscope.choice.closed_loop import (
    SIGNAL_STD_RAD,
    LinearisedPlan,
    Noise,
    compute_information,
    compute_mean_errors,
    linearise_plan,
    predict_end_covariance,
)

from tetractl.control.search.cost import predict
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
    linear: LinearisedPlan


@pytest.fixture
def plan():
    random_problem = problem(world(4, ROBOTS, model="exact"))
    changes = np.random.default_rng(4).uniform(-0.4, 0.4, 30)
    signals = np.cumsum(changes)
    return Plan(random_problem, signals, linearise_plan(random_problem, signals))


def test_without_noise_the_ends_are_the_planned_ones(plan):
    assert not predict_end_covariance(plan.linear, QUIET).any()
    no_covariance = np.zeros((2 * ROBOTS, 2 * ROBOTS))
    assert compute_mean_errors(no_covariance, plan.linear.target_distances) == pytest.approx(
        plan.linear.target_distances
    )


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
    covariance = predict_end_covariance(
        plan.linear, replace(QUIET, **{noisy: 0.01}), corrects=False
    )
    deviations = np.sqrt(np.diag(covariance))
    assert deviations == pytest.approx(np.std(ends, axis=0), rel=0.1, abs=0.01)


def test_feedback_and_identification_lower_the_error(plan):
    noise = Noise(
        a_std=0.05, speed_std=0.05, heading_walk=0.05, position_std=0.5, heading_std=0.005
    )

    def error(corrects, identifies):
        covariance = predict_end_covariance(plan.linear, noise, corrects, identifies)
        return compute_mean_errors(covariance, np.zeros(ROBOTS)).sum()

    open_loop = error(corrects=False, identifies=False)
    feedback = error(corrects=True, identifies=False)
    identification = error(corrects=True, identifies=True)
    assert open_loop > feedback > identification > 0


def test_the_mean_length_of_a_normal_vector_is_that_of_many_drawn():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 2))
    drawn = root @ rng.standard_normal((2, 200_000))
    (mean_length,) = compute_mean_errors(root @ root.T, np.zeros(1))
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
    (mean_length,) = compute_mean_errors(np.diag([deviation**2, 0.0]), np.zeros(1))
    assert mean_length == pytest.approx(deviation * np.sqrt(2 / np.pi))


def test_the_miss_is_the_distance_of_the_planned_end_from_the_target(plan):
    x, y, _ = predict(plan.problem, plan.signals)[-1].T
    to_x, to_y = np.asarray(plan.problem.targets).T
    assert plan.linear.target_distances == pytest.approx(np.hypot(x - to_x, y - to_y))


def test_derivatives_of_the_ends_are_their_differences(plan):
    def ends(**changes):
        signals = changes.pop("signals", plan.signals)
        path = predict(replace(plan.problem, **changes), signals)
        return path[-1, :, :2]

    small = 1e-5
    for k in (0, 7, 29):
        aside = np.zeros(30)
        aside[k] = small
        change = ends(signals=plan.signals + aside) - ends(signals=plan.signals - aside)
        assert plan.linear.by_signal[:, k] == pytest.approx(change.ravel() / (2 * small), rel=1e-4)
    for name, table in (("a", plan.linear.by_a), ("speed", plan.linear.by_speed)):
        value = getattr(plan.problem, name)
        up, down = value * np.exp(small), value * np.exp(-small)
        change = ends(**{name: up}) - ends(**{name: down})
        assert table.sum(axis=0) == pytest.approx(change / (2 * small), rel=1e-3, abs=1e-3)


def loop(by_signal, length):
    """A plan of one robot whose ends follow the signals, and nothing else moves it."""
    zero = np.zeros((length, 1, 2))
    return LinearisedPlan(
        target_distances=np.zeros(1),
        by_signal=np.array(by_signal) / SIGNAL_STD_RAD,
        by_heading=np.zeros((length + 1, 1, 2)),
        by_a=zero,
        by_speed=zero,
        turn_by_a=np.zeros((length, 1)),
        extra_step=np.zeros((2, 1)),
        durations_s=np.ones(length),
    )


def test_a_correction_follows_measurements_as_far_as_they_are_believed():
    """Along y, both signals correct by r, along x only the first. Places are measured with m."""
    r, m = 3.0, 2.0
    covariance = predict_end_covariance(
        loop([[r, 0.0], [0.0, r]], 2), replace(QUIET, position_std=m), corrects=True
    )
    believed = r**2 / (r**2 + m**2)
    after_first = (believed * m) ** 2
    believed_then = r**2 / (r**2 + after_first + m**2)
    after_second = (1 - believed_then) ** 2 * after_first + (believed_then * m) ** 2
    assert covariance == pytest.approx(np.diag([after_first, after_second]), rel=1e-6)


def test_exact_measurements_and_full_reach_leave_no_error():
    moving = loop([[5.0, 0.0], [0.0, 5.0]], 2)
    moving = replace(moving, by_a=np.array([[[1.0, 1.0]], [[0.0, 0.0]]]))
    wide = np.array([[0.0, 50.0], [0.0, 50.0]]) / SIGNAL_STD_RAD
    noise = replace(QUIET, a_std=0.1)
    open_loop = predict_end_covariance(moving, noise, corrects=False)
    assert open_loop == pytest.approx(np.full((2, 2), 0.01))
    corrected = predict_end_covariance(replace(moving, by_signal=wide), noise, corrects=True)
    assert np.abs(corrected).max() < 1e-4 * open_loop.max()


def test_errors_of_parameters_act_in_all_steps_and_add_up():
    """The same error of a moves the end by 1 in each of two steps: twice, not sqrt(2) times."""
    same = np.array([[[1.0, 0.0]], [[1.0, 0.0]]])
    moving = replace(loop(np.zeros((2, 2)), 2), by_a=same, by_speed=2 * same[..., ::-1])
    noise = replace(QUIET, a_std=0.1, speed_std=0.2)
    covariance = predict_end_covariance(moving, noise, corrects=False)
    assert covariance == pytest.approx(np.diag([0.2**2, 0.8**2]))


def test_a_turn_tells_a_and_a_way_the_speed():
    moving = replace(
        loop(np.zeros((2, 1)), 1), turn_by_a=np.array([[0.5]]), by_speed=np.array([[[3.0, 4.0]]])
    )
    noise = Noise(heading_std=0.1, heading_walk=0.2, position_std=0.5)
    of_a, of_speed = compute_information(moving, noise, 0)
    assert of_a == pytest.approx(0.25 / (2 * 0.01 + 0.04), rel=1e-4)
    assert of_speed == pytest.approx(25.0 / (2 * 0.25))
    slow = compute_information(replace(moving, by_speed=np.zeros((1, 1, 2))), QUIET, 0)
    assert slow[1] == 0.0


def test_the_noise_is_read_from_the_plant_and_a_lab_has_none():
    section = {
        "type": "sim",
        "a_error": 0.3,
        "speed_error": 0.06,
        "heading_noise": 0.1,
        "measurement_noise": {"position": 2.0, "heading": 0.02},
    }
    noise = Noise.from_plant(experiment(plant=section).plant)
    assert noise.a_std == pytest.approx(0.3 / np.sqrt(3))
    assert noise.speed_std == pytest.approx(0.06 / np.sqrt(3))
    assert (noise.heading_walk, noise.position_std, noise.heading_std) == (0.1, 2.0, 0.02)
    assert Noise.from_plant(None) == QUIET


def test_the_mean_error_is_between_miss_and_their_sum_and_of_each_robot():
    covariance = np.zeros((4, 4))
    covariance[2:, 2:] = 9.0 * np.eye(2)
    first, second = compute_mean_errors(covariance, np.array([4.0, 4.0]))
    assert first == pytest.approx(4.0)
    assert second == pytest.approx(np.hypot(4.0, 3.0 * np.sqrt(np.pi / 2)))
