"""Tests of the plan lengths that the controller tries, with a made-up optimiser."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import problems

from tetractl.control.methods.lengths import (
    REST_GROWTH,
    REST_PLANS,
    SIGNALS_PER_ROBOT,
    Searcher,
    longer_lengths,
    min_length,
    resample,
)
from tetractl.core.plan import Limits, Search, StopReason


class Optimizer:
    """Finds what a test says for each length, and notes what it was asked."""

    def __init__(self, cost=lambda length: 1.0):
        self.cost = cost
        self.asked = []

    def search(self, problem, length, start, key, limits):
        self.asked.append((length, None if start is None else start.tolist(), key))
        signals = np.full(length, 0.1)
        cost = self.cost(length)
        return Search(length, signals, cost, np.array([cost]), 1, StopReason.ITERATIONS)


def problem(gaps, speed=100.0, period=0.5, first_period=0.25):
    """Robots that are so far from their targets [mm], at 100 mm/s."""
    count = len(gaps)
    made = problems.problem(problems.world(1, robots=count, obstacles=0))
    targets = made.poses.xy + np.column_stack([gaps, np.zeros(count)])
    times = {"period": period, "first_period": first_period}
    return replace(made, targets=targets, speed=np.full(count, speed), **times)


@given(st.floats(0, 2000), st.sampled_from([0.1, 0.5]), st.sampled_from([0.05, 0.5]))
def test_the_least_length_is_the_first_that_lasts_for_the_straight_way(gap, period, first_period):
    length = min_length(problem([gap], period=period, first_period=first_period))
    needed_s = gap / 100.0

    def lasts_s(signals):
        return first_period + (signals - 1) * period

    assert length >= 1
    assert lasts_s(length) >= needed_s - 1e-6
    assert length == 1 or lasts_s(length - 1) < needed_s + 1e-6


def test_several_robots_need_signals_for_each_and_the_farthest_counts():
    assert min_length(problem([10.0, 10.0])) == 2 * SIGNALS_PER_ROBOT
    assert min_length(problem([10.0, 5000.0])) == min_length(problem([5000.0]))
    assert min_length(problem([0.0])) == 1
    assert min_length(problem([300.0], speed=0.0)) == 1  # it never arrives
    assert min_length(problem([0.0], speed=0.0)) == 1


@given(st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=12))
def test_signals_of_the_same_length_stay_as_they_are(signals):
    assert resample(np.array(signals), len(signals)) == pytest.approx(np.array(signals))


def test_signals_are_resampled_at_the_middles_of_their_times():
    assert resample(np.array([0.0, 1.0]), 4) == pytest.approx([0.0, 0.25, 0.75, 1.0])
    assert resample(np.array([0.0, 1.0, 2.0, 3.0]), 2) == pytest.approx([0.5, 2.5])
    across = resample(np.array([math.pi - 0.1, 0.1 - math.pi]), 4)  # by way of a half turn
    assert np.cos(across - math.pi) == pytest.approx(np.cos([0.1, 0.05, 0.05, 0.1]))


@given(st.integers(1, 30), st.integers(0, 60))
def test_longer_plans_grow_and_end_at_the_longest(count, more):
    lengths = list(longer_lengths(count, count + more))
    assert lengths == sorted(set(lengths))
    assert all(count < length <= count + more for length in lengths)
    assert (lengths[:1] == [count + 1]) == (more > 0)


def searcher(cost, expired=lambda _: False):
    optimizer = Optimizer(cost)
    three_robots = problems.problem(problems.world(1))
    return Searcher(optimizer, three_robots, 7, Limits(expired=expired)), optimizer


def good(search):
    return search.cost < 1


@pytest.mark.parametrize("shortest", [4, 9, 16, 20])
def test_the_shortest_good_plan_is_found(shortest):
    found, optimizer = searcher(lambda length: 0.0 if length >= shortest else 2.0)
    assert found.search_lengths(4, 20, good)
    assert min(search.length for search in found.searches if good(search)) == shortest
    assert all(4 <= length <= 20 for length, _, _ in optimizer.asked)
    keys = [key for _, _, key in optimizer.asked]
    assert len(set(keys)) == len(keys)  # each search has random numbers of its own


def test_without_a_good_plan_the_longest_is_tried_and_nothing_is_shortened():
    found, optimizer = searcher(lambda _: 2.0)
    assert not found.search_lengths(5, 20, good)
    lengths = [length for length, _, _ in optimizer.asked]
    assert lengths.count(20) == REST_PLANS
    assert lengths[0] == round(REST_GROWTH * 5)  # there are several robots
    assert all(start is None for _, start, _ in optimizer.asked)


def test_lengths_grow_by_their_ratio_and_a_good_plan_is_cut_by_an_eighth_first():
    found, optimizer = searcher(lambda length: 0.0 if length >= 40 else 2.0)
    found.search_lengths(10, 64, good)
    lengths = [length for length, _, _ in optimizer.asked]
    grown = [13, 17, 22, 29, 38, 49]  # each 1.3 times the one before, rounded
    assert lengths[:6] == grown
    assert lengths[6:9] == [43, 37, 40]  # an eighth of 49 less, then again, then half as much
    assert optimizer.asked[6][1] is not None  # from the good plan, drawn together


def test_once_the_time_is_over_only_the_first_search_is_done():
    found, optimizer = searcher(lambda _: 2.0, expired=lambda _: True)
    assert found.search(5) is not None
    assert found.search(6) is None
    assert not found.search_lengths(5, 20, good)
    assert not found.search_from_starts(found.problem, [np.zeros(3)], good)
    assert [length for length, _, _ in optimizer.asked] == [5]


def test_plans_under_way_are_searched_until_one_is_good():
    costs = {3: 2.0, 4: 0.5, 5: 0.1}
    found, optimizer = searcher(lambda length: costs.get(length, 9.0))
    found.search(8)
    starts = [np.zeros(length) for length in (3, 4, 5)]
    assert found.search_from_starts(found.problem, starts, good)
    assert [length for length, _, _ in optimizer.asked] == [8, 3, 4]
    worse, _ = searcher(lambda length: 0.2 if length == 8 else 0.3)
    worse.search(8)
    assert not worse.search_from_starts(worse.problem, starts, good)  # the first one stays the best
