"""Tests of a trial as a Gymnasium environment."""

import math
import warnings

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from tetractl_learn.gym import TrialEnv  # noqa: E402

import tetractl  # noqa: E402
from tetractl.core.errors import UsageError  # noqa: E402

SPEC = {
    "name": "learning",
    "units": {"length": "um"},
    "arena": {"left": 0, "bottom": 0, "width": 2000, "height": 1000},
    "robots": [{"name": "a", "start": [500, 500], "target": [1100, 500], "a": 4, "speed": 300}],
    "controller": {
        "type": "pso-mpc",
        "horizon_max": 20,
        "period": 0.2,
        "time_limit": 4,
        "arrival_tolerance": 50,
    },
    "trials": {"count": 1, "seed": 5},
}
START_ERROR_UM = 600.0
"""From the start to the target."""
EAST = np.array([1.0, 0.0])
WEST = np.array([-1.0, 0.1])
"""Not exactly west: by (3), that does not turn a robot that faces east."""


@pytest.fixture
def env():
    """An environment at the beginning of an episode."""
    new_env = TrialEnv(SPEC)
    new_env.reset(seed=1)
    return new_env


def episode(env, action):
    """Send one action until the episode ends; return rewards, the last flags and info."""
    rewards = []
    terminated = truncated = False
    info = {}
    while not (terminated or truncated):
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
    return rewards, terminated, truncated, info


@pytest.mark.parametrize("name", ["one-cell", "paper"])
def test_the_checker_of_gymnasium_has_nothing_to_say(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"tetractl/{name}-v0").unwrapped)


def test_an_action_out_of_its_range_is_clipped_as_a_policy_clips_it():
    headings = []
    for action in ([1.0, 0.5], [5.0, 0.5]):
        env = TrialEnv(SPEC)
        env.reset(options={"trial": 0})
        env.step(np.array(action))
        headings.append(env.trial.last_direction)
    assert headings[0] == headings[1] == np.arctan2(0.5, 1.0)


def test_a_picture_shows_the_arena_and_where_the_robots_have_been():
    env = TrialEnv(SPEC, render_mode="rgb_array")
    env.reset(seed=1)
    before = env.render()
    env.step(EAST)
    after = env.render()
    assert before.shape == (250, 500, 3)  # the arena is twice as wide as high
    assert (before != after).any()
    assert TrialEnv(SPEC).render() is None
    with pytest.raises(UsageError, match="render_mode 'human' is unknown"):
        TrialEnv(SPEC, render_mode="human")


@pytest.mark.system
def test_the_checks_of_stable_baselines3_have_nothing_to_say():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    builder = pytest.importorskip("stable_baselines3.common.env_util")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(TrialEnv(SPEC))
        environments = builder.make_vec_env("tetractl/one-cell-v0", n_envs=2, seed=1)
        environments.reset()
        environments.step(np.array([EAST, WEST]))


def test_rewards_add_up_to_what_tables_print(env):
    """1 - e/d, with e the true error and d the distance at the start."""
    rewards, terminated, truncated, info = episode(env, EAST)
    assert (terminated, truncated) == (True, False)
    assert info["outcome"] == "arrived"
    assert info["total_error"] == env.trial.result.total_error <= 50
    assert sum(rewards) == pytest.approx(1 - info["total_error"] / START_ERROR_UM)


def test_failing_counts_as_the_greatest_error_whatever_was_collected(env):
    _, collected, *_ = env.step(EAST)
    rewards, terminated, truncated, info = episode(env, WEST)
    assert collected > 0
    assert (terminated, truncated) == (True, False)
    assert info["outcome"] == "failed"
    corner = np.hypot(1100, 500)  # the corners on the left are farthest from the target
    assert info["total_error"] == pytest.approx(corner)
    assert collected + sum(rewards) == pytest.approx(1 - corner / START_ERROR_UM)


def test_an_observation_is_what_the_camera_measured():
    env = TrialEnv(SPEC)
    observation, _ = env.reset(seed=1)
    gap = 600 / 2000  # of the arena's longer side
    np.testing.assert_allclose(observation, [gap, 0, 1, 0, 0, 0], atol=1e-6)
    observation, *_ = env.step(np.array([0.0, 0.5]))
    np.testing.assert_allclose(observation[4:], [0, 1], atol=1e-6)  # the last direction, up


def test_a_seed_and_a_number_open_the_trial_of_the_benchmark():
    env = TrialEnv(SPEC | {"plant": {"type": "sim", "a_error": 0.3, "speed_error": 0.3}})
    env.reset(seed=5, options={"trial": 3})
    episode(env, EAST)
    trial = tetractl.open_trial(env.trial.spec, trial=3)
    while trial.result is None:
        trial.step(0.0)
    assert env.trial.result.robot_errors == trial.result.robot_errors
    assert env.trial.spec.experiment.trials.seed == 5


@pytest.mark.parametrize("option", ["trail", "seed"])
def test_an_option_that_a_reset_does_not_have_is_refused(option):
    with pytest.raises(UsageError, match=f"no option '{option}'"):
        TrialEnv(SPEC).reset(seed=1, options={option: 3})


def test_an_episode_is_saved_as_a_log_that_is_verified(env, tmp_path):
    episode(env, EAST)
    log = env.trial.save(tmp_path)
    assert not tetractl.verify(log).problems


def test_a_step_before_the_first_reset_is_refused():
    with pytest.raises(UsageError, match="call reset first"):
        TrialEnv(SPEC).step(EAST)


def test_the_limit_of_time_truncates():
    env = TrialEnv(SPEC | {"robots": [SPEC["robots"][0] | {"speed": 10}]})
    env.reset(seed=1)
    rewards, terminated, truncated, info = episode(env, EAST)
    assert (terminated, truncated) == (False, True)
    assert info["outcome"] == "time limit"
    assert sum(rewards) == pytest.approx(1 - info["total_error"] / START_ERROR_UM)


def test_a_trial_that_is_no_number_is_refused():
    with pytest.raises(
        UsageError, match="a trial must be a whole number of at least 0, but it is first"
    ):
        TrialEnv(SPEC).reset(seed=1, options={"trial": "first"})


@pytest.mark.parametrize("action", [0.5, [1.0], [1, 0, 0], [[1, 0]], "east", [math.nan, 0]])
def test_an_action_of_another_shape_is_refused_in_one_line(env, action):
    with pytest.raises(UsageError, match="an action must be a vector of 2 finite numbers, not"):
        env.step(action)


def test_an_obstacle_counts_as_the_greatest_error():
    wall = {"type": "circle", "center": [800, 500], "radius": 100}
    env = TrialEnv(SPEC | {"obstacles": [wall]})
    env.reset(seed=1)
    rewards, terminated, truncated, info = episode(env, EAST)
    assert (terminated, truncated, info["outcome"]) == (True, False, "failed")
    assert sum(rewards) == pytest.approx(1 - np.hypot(1100, 500) / START_ERROR_UM)


def test_without_a_seed_each_reset_draws_one(env):
    seeds = []
    for _ in range(3):
        env.reset()
        env.step(EAST)
        env.trial.stop()
        seeds.append(env.trial.spec.experiment.trials.seed)
    assert len(set(seeds)) == 3


def test_robots_that_start_on_their_targets_are_refused():
    on_target = {**SPEC["robots"][0], "start": SPEC["robots"][0]["target"]}
    with pytest.raises(UsageError, match="start on their targets"):
        TrialEnv({**SPEC, "robots": [on_target]})
