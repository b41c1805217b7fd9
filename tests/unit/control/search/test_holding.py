"""Tests of the search for directions that keep robots near their targets."""

from dataclasses import replace

import numpy as np
import pytest
from testkit import problems

from tetractl.control.search import holding
from tetractl.control.search.cost import evaluate
from tetractl.control.search.holding import RELATIVE_RATES, START_DIRECTIONS, CircleSearch
from tetractl.core.plan import Limits, StopReason
from tetractl.core.poses import wrap

pytestmark = pytest.mark.slow

LENGTH = 20
FIRST = len(START_DIRECTIONS) * len(RELATIVE_RATES)  # rotations
ROUND = CircleSearch.samples


def problem_of(robots=1):
    """Robots at their targets, which circle in 40 um."""
    problem = problems.problem(problems.world(3, robots, 0, "exact"))
    poses = replace(problem.poses, heading=np.zeros(robots))
    return replace(
        problem,
        poses=poses,
        targets=poses.xy.copy(),
        a=np.linspace(4.0, 5.0, robots),
        speed=np.full(robots, 100.0),
        within=40.0,
    )


@pytest.fixture
def tried(monkeypatch):
    """The sequences of each iteration."""
    rounds = []

    def watched(problem, sequences):
        rounds.append(sequences.copy())
        return evaluate(problem, sequences)

    monkeypatch.setattr(holding, "evaluate", watched)
    return rounds


def turning(sequences):
    """How fast each sequence turns [rad a signal], shape (P, L - 1)."""
    return wrap(np.diff(sequences, axis=1))


@pytest.mark.parametrize("robots", [1, 3])
def test_first_all_rotations_are_tried_at_rates_of_the_slowest_robot(tried, robots):
    problem = problem_of(robots)
    CircleSearch().search(problem, LENGTH, None, 1, Limits())
    first = tried[0]
    assert first.shape == (FIRST, LENGTH)
    assert np.unique(np.round(first[:, 0], 9)).size == len(START_DIRECTIONS)
    steps = turning(first)
    assert np.ptp(steps, axis=1).max() < 1e-9
    found = np.unique(np.round(steps[:, 0] / problem.period / 4.0, 9))
    assert found.tolist() == sorted(RELATIVE_RATES.tolist())
    assert np.abs(first).max() <= np.pi


@pytest.mark.parametrize(
    ("warm", "expected"),
    [
        ([0.1, 0.3, 0.6], 0.6 + 0.3 * np.arange(LENGTH - 2)),  # goes on turning by 0.3
        ([0.4], np.full(LENGTH, 0.4)),
        (0.05 * np.arange(LENGTH + 7), 0.05 * np.arange(LENGTH)),
    ],
)
def test_a_plan_is_continued_and_tried_too(tried, warm, expected):
    CircleSearch().search(problem_of(), LENGTH, np.array(warm), 1, Limits())
    assert len(tried[0]) == FIRST + 1
    plan = tried[0][0]
    assert plan[-len(expected) :] == pytest.approx(wrap(np.array(expected)))
    assert plan[0] == pytest.approx(warm[0])


def test_an_empty_plan_is_none(tried):
    CircleSearch().search(problem_of(), LENGTH, np.empty(0), 1, Limits())
    assert len(tried[0]) == FIRST


def test_each_round_tries_smaller_changes_of_the_best_so_far(tried):
    problem = problem_of()
    search = CircleSearch().search(problem, LENGTH, None, 1, Limits())
    assert len(tried) == 1 + CircleSearch.rounds
    best = None
    cost = np.inf
    for z, sequences in enumerate(tried):
        if z > 0:
            spread = CircleSearch.first_std * CircleSearch.std_factor ** (z - 1)
            change = wrap(sequences - best)
            accumulating, single = change[::2], change[1::2]
            assert single.std() == pytest.approx(spread, rel=0.1)
            # a sum of j changes, each smaller by the factor
            steps = CircleSearch.accumulation * spread
            if z >= 3:  # of which none exceeds a half turn
                grown = np.sqrt(np.mean(accumulating**2, axis=0))
                assert grown == pytest.approx(steps * np.sqrt(np.arange(1, LENGTH + 1)), rel=0.35)
        total = evaluate(problem, sequences).total
        if total.min() < cost:
            cost = total.min()
            best = sequences[total.argmin()]
    assert search.cost == cost
    assert search.signals.tolist() == best.tolist()
    assert search.stopped is StopReason.ITERATIONS
    assert search.evaluations == FIRST + CircleSearch.rounds * ROUND
    assert search.cost < search.history[0]


def test_changes_differ_from_round_to_round_and_by_the_key(tried):
    for key in (1, 1, 2):
        CircleSearch().search(problem_of(), LENGTH, None, key, Limits())
    rounds = 1 + CircleSearch.rounds
    once, again, other = (tried[k : k + rounds] for k in (0, rounds, 2 * rounds))
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))
    assert not np.array_equal(once[1], other[1])
    change = once[1][1::2] - once[2][1::2]
    assert change.std() > 0.1


def test_a_search_ends_where_its_limits_say():
    search = CircleSearch()
    assert search.evaluations_min == FIRST + 1 + ROUND
    assert search.iterations_max == search.rounds
    budget = FIRST + 2 * ROUND + 5
    found = search.search(problem_of(), LENGTH, None, 1, Limits(evaluations=budget))
    assert found.evaluations == FIRST + 2 * ROUND
    assert found.stopped is StopReason.EVALUATIONS
    late = Limits(expired=lambda spent: spent > FIRST)
    found = search.search(problem_of(), LENGTH, None, 1, late)
    assert (found.evaluations, found.stopped) == (FIRST + ROUND, StopReason.DEADLINE)
