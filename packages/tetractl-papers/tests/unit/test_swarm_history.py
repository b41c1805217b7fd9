"""Tests of repeating a logged search: its frames, one particle's path, and the landscape of J."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import three_robots
from tetractl_papers import swarm_history
from tetractl_papers.swarm_history import GRID_SIZE, repeat_first_search

from tetractl.control.search.cost import evaluate
from tetractl.core.errors import LogError
from tetractl.verification.recompute import StepSearches

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log():
    return three_robots()


@pytest.fixture(scope="module")
def history(log):
    return repeat_first_search(log, (0.0, 0.5, 1.0))


def test_the_frames_are_those_of_the_iterations_asked_for(log, history):
    logged = log.steps[0].plan.search.history
    last = len(logged) - 1
    assert [frame.z for frame in history.frames] == [0, round(0.5 * last), last]
    for frame in history.frames:
        assert frame.cost == logged[frame.z]
        assert frame.particles.shape == (log.experiment.controller.optimizer.particles, 2)
        assert np.abs(frame.particles).max() <= np.pi
    assert history.repeated
    assert repeat_first_search(log, (1.0,)).frames[0].z == last


def test_the_path_is_that_of_the_first_particle_from_the_start_on(log, history):
    assert history.path.shape == (len(log.steps[0].plan.search.history), 2)
    for frame in history.frames:
        assert frame.particles[0].tolist() == history.path[frame.z].tolist()
    assert history.path_best.shape == (2,)


def test_the_best_of_the_last_frame_is_the_plan(log, history):
    plan = log.steps[0].plan
    assert history.frames[-1].best.tolist() == plan.signals[:2].tolist()
    assert history.frames[-1].cost == plan.search.cost


def test_the_landscape_is_j_over_the_first_two_signals(log, history):
    """Rows are the second signal, from -pi on; the other signals are those of the plan."""
    axis = np.linspace(-np.pi, np.pi, GRID_SIZE)
    plan = log.steps[0].plan
    start = log.start.setup
    problem = log.experiment.controller.problem(start, log.steps[0].observation.poses)
    for row, column in ((0, 0), (3, 40), (GRID_SIZE - 1, 7), (30, GRID_SIZE - 1)):
        signals = plan.signals.copy()
        signals[:2] = axis[column], axis[row]
        expected = evaluate(problem, signals[None]).total[0]
        assert history.costs[row, column] == pytest.approx(expected, rel=1e-9)


def test_costs_that_differ_from_the_logged_ones_are_noticed(log):
    plan = log.steps[0].plan
    search = replace(plan.search, history=plan.search.history + 1e-9)
    searches = tuple(search if k == plan.chosen else other for k, other in enumerate(plan.searches))
    altered = replace(log.steps[0], plan=replace(plan, searches=searches))
    changed = replace(log, steps=(altered, *log.steps[1:]))
    assert not repeat_first_search(changed, (0.0,)).repeated


def test_a_search_that_takes_too_long_is_given_up(log, monkeypatch):
    monkeypatch.setattr(StepSearches, "is_expired", lambda self: True)
    with pytest.raises(LogError, match="takes too long"):
        repeat_first_search(log, (0.0,))


def test_a_plan_of_one_signal_has_no_second_axis(log, monkeypatch):
    first_request = swarm_history._first_request

    def short_request(log, searches):
        return replace(first_request(log, searches), length=1)

    monkeypatch.setattr(swarm_history, "_first_request", short_request)
    with pytest.raises(LogError, match="only one signal"):
        repeat_first_search(log, (0.0,))
