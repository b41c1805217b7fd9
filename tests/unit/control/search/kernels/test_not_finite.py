"""Tests that compiled loops end for all numbers, and create no number that is not finite."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from testkit import problems
from testkit.running import PATIENCE_S

from tetractl.control.estimation.kernels.filter import follow
from tetractl.control.estimation.kernels.filter_state import (
    HEADING,
    LN_A,
    LOG_FOLLOWS,
    STATES,
    STATES_OF_WHEELS,
    Bank,
    FilterModel,
    PoseFrames,
    SentCommands,
)
from tetractl.control.search.kernels import multistart
from tetractl.control.search.kernels.levenberg import PolishSettings, workspace_for
from tetractl.control.search.kernels.motion import flatten
from tetractl.control.search.kernels.rollout import rollouts_of
from tetractl.model.motion.motion import PARAMETERS

pytestmark = pytest.mark.slow

ODD = [math.nan, math.inf, -math.inf, 1e18]
PLACES = ("tau", "when", "time", "pose", "direction", "state", "until", "parameters")


def ends(work):
    """Return whether a function ends; kernels leave other threads of Python alone."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    return not thread.is_alive()


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("place", PLACES)
def test_the_filter_ends(odd, place):
    noise = np.ones((3, 1))
    walk = np.ones((STATES_OF_WHEELS, 1))
    model = FilterModel(np.ones((1, len(PARAMETERS))), noise, walk, 0.0, 0.0, math.inf)
    start = np.zeros((1, 1, STATES)), np.ones((1, STATES_OF_WHEELS)), np.zeros(1, dtype=np.int64)
    bank = Bank.start(np.array([0.1]), *start)
    bank.direction[...] = 0.0
    time = np.array([[0.0], [0.1], [0.2]])
    poses = np.zeros((3, 1, 3))
    when = np.array([0.0, 0.05])
    u = np.array([0.0, 1.0])
    numbers = {"tau": bank.dead_time_s, "when": when, "time": time, "pose": poses, "direction": u}
    numbers |= {"state": bank.state, "until": bank.until_s, "parameters": model.parameters}
    numbers[place][-1:] = odd
    is_seen = np.ones((3, 1), dtype=np.bool_)
    commands = SentCommands(when, u)
    frames = PoseFrames(time, poses, is_seen)
    assert ends(lambda: follow(bank, model, commands, frames, False, 0.0))


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("place", ["targets", "a", "signals"])
def test_the_polish_ends(odd, place):
    problem = problems.problem(problems.world(2))
    start = np.zeros(20)
    if place == "signals":
        start[3] = odd
    else:
        numbers = getattr(problem, place).copy()
        numbers[0] = odd
        problem = replace(problem, **{place: numbers})
    rounds = multistart.rounds_for.__wrapped__(0, 1, 1, 1, len(start), 50, 0)
    rounds.begin(multistart.POLISH, start[None])
    task = multistart.SearchTask(
        problem=flatten(problem),
        rollouts=rollouts_of(0, len(problem.a), 1),
        workspace=workspace_for(problem, len(start)),
        settings=PolishSettings(1e-3, 0.5, 6, 50),
        key=np.uint64(0),
        warm=np.empty(0),
        rounds=0,
        budget=10_000,
    )
    assert ends(lambda: multistart.search(task, rounds, multistart.UNLIMITED))


def test_a_robot_that_may_head_anywhere_is_no_more_uncertain_than_that():
    """Regression: a hypothesis of a quick robot that drove against its direction had a covariance
    of 1e19, which the next pose made none: then every likelihood of `identify` was NaN."""
    model = FilterModel(
        parameters=np.ones((1, len(PARAMETERS))),
        noise=np.full((3, 1), 0.2),
        walk=np.zeros((STATES_OF_WHEELS, 1)),
        helix_rad_s=0.0,
        host_lag_s=0.0,
        watchdog_s=math.inf,
        branch_all=True,
    )
    model.walk[HEADING] = 0.06
    mean = np.zeros((1, 1, STATES))
    std = np.zeros((1, STATES_OF_WHEELS))
    mean[..., LN_A] = math.log(330.0)
    std[:, [HEADING, LN_A]] = 0.8, 0.6
    bank = Bank.start(np.zeros(1), mean, std, np.zeros(1, dtype=np.int64), LOG_FOLLOWS)
    bank.direction[...] = math.pi
    bank.next_command[...] = 1
    times = 0.04 * np.arange(6.0)[:, None]
    poses = np.zeros((6, 1, 3))
    poses[:, 0, 0] = times[:, 0]
    is_seen = np.arange(6)[:, None] > 3
    commands = SentCommands(np.array([0.0]), np.array([math.pi]))
    ln_likelihoods = follow(bank, model, commands, PoseFrames(times, poses, is_seen), False, 0.0)
    assert np.isfinite(ln_likelihoods).all()
    cov = bank.cov[0, 0, int(bank.ln_weight[0, 0].argmax())]
    assert np.linalg.eigvalsh(cov).min() > -1e-9 * np.trace(cov)
