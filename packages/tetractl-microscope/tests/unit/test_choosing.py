"""Tests of which cells of a dish become the robots of a trial."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_microscope.choice.candidate import RobotCandidate
from tetractl_microscope.choice.choosing import (
    choose_cells,
    compute_dissimilarity,
    find_most_similar,
    rate_choice,
    set_robots,
)
from tetractl_microscope.choice.scattered_cells import generate_cells
from tetractl_microscope.choice.section import Ring, require_choice

from tetractl.core.errors import AbortError
from tetractl.core.poses import Pose
from tetractl.spec.load import parse_spec

SPEC = """
name: two
units: {length: um}
arena: {left: 0, bottom: 0, width: 3000, height: 2000}
controller: {type: mpc, time_limit: 1}
robots: {choose: 2, targets: [[500, 1000], [2500, 1000], [1500, 300]], a: 4, speed: 400%s}
"""
EXPERIMENT = parse_spec(SPEC % "", "two.yaml").experiment


def cell(number, a, speed=400.0, x=1500.0, y=1000.0, heading=0.0, **more):
    return RobotCandidate(number, Pose(x, y, heading), a, 0.01 * a, speed, 0.01 * speed, **more)


@pytest.mark.parametrize(
    ("a", "a_sd", "speed", "speed_sd", "responds"),
    [
        (4.0, 1.0, 400.0, 4.0, True),
        (4.0, 1.2, 400.0, 4.0, False),  # it may turn by chance
        (4.0, 1.0, 400.0, 120.0, False),  # it may stand still
        (-4.0, 0.1, 400.0, 4.0, False),  # it turns away from the field
        (3.5, 1.0, 400.0, 4.0, False),  # exactly at the limit
        (3.51, 1.0, 3.51, 1.0, True),
        (4.0, 0.1, 3.5, 1.0, False),
    ],
)
def test_a_cell_can_be_steered_if_it_surely_swims_and_turns(a, a_sd, speed, speed_sd, responds):
    candidate = RobotCandidate(1, Pose(0.0, 0.0, 0.0), a, a_sd, speed, speed_sd)
    assert candidate.magnetised is responds


def test_the_unlikeness_is_of_the_two_most_similar_cells_less_its_error():
    a = np.array([2.0, 8.0, 3.0])
    assert compute_dissimilarity(a, np.zeros(3)) == pytest.approx(math.log(3 / 2))
    sd = np.array([0.2, 0.1, 0.3])
    assert compute_dissimilarity(a, sd) == pytest.approx(math.log(3 / 2) - math.hypot(0.1, 0.1))
    assert compute_dissimilarity(a[:1], sd[:1]) == math.inf


@given(st.lists(st.floats(0.5, 9.0), min_size=2, max_size=6), st.randoms(use_true_random=False))
def test_the_order_and_the_unit_of_turning_rates_do_not_change_the_unlikeness(rates, random):
    a = np.array(rates)
    sd = 0.1 * np.sqrt(a)
    order = list(range(len(a)))
    random.shuffle(order)
    same = compute_dissimilarity(a[order], sd[order])
    assert compute_dissimilarity(a, sd) == pytest.approx(same)
    assert compute_dissimilarity(10 * a, 10 * sd) == pytest.approx(same)


def numbers(cells):
    return [chosen.number for chosen in choose_cells(EXPERIMENT, cells)]


def test_the_cells_that_differ_are_chosen_in_the_order_of_decreasing_turning_rates():
    assert numbers([cell(1, 4.0), cell(2, 4.1), cell(3, 5.5)]) == [3, 1]


def test_cells_that_differ_enough_are_chosen_by_the_slowest_turning():
    assert numbers([cell(1, 1.0), cell(2, 4.0), cell(3, 8.0)]) == [3, 2]


def test_a_cell_without_a_magnet_is_not_chosen():
    lame = replace(cell(2, 9.0), a_sd=5.0)
    assert numbers([cell(1, 4.0), lame, cell(3, 5.5)]) == [3, 1]


def test_a_cell_that_a_wall_may_have_turned_is_chosen_last():
    cells = [cell(1, 2.0), cell(2, 2.2), cell(3, 9.0, free=False)]
    assert numbers(cells) == [2, 1]
    assert numbers([replace(c, free=True) for c in cells])[0] == 3


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [
        (210.0, 1000.0, True),  # 200 um is half a second
        (190.0, 1000.0, False),
        (2810.0, 1000.0, False),
        (2790.0, 1000.0, True),
        (1500.0, 190.0, False),
        (1500.0, 1810.0, False),
        (1500.0, 1790.0, True),
    ],
)
def test_a_cell_that_can_reach_the_edge_in_half_a_second_is_chosen_last(x, y, inside):
    pair = [cell(1, 2.0, x=x, y=y), cell(2, 8.0)]
    assert rate_choice(pair, EXPERIMENT)[0] is inside
    assert rate_choice(pair[::-1], EXPERIMENT)[0] is inside


def test_too_few_cells_that_respond_are_an_abort_with_both_counts():
    lame = replace(cell(2, 9.0), a_sd=5.0)
    with pytest.raises(AbortError, match=r"only 1 of 2 cells respond .*, but 2 are needed"):
        numbers([cell(1, 4.0), lame])
    assert len(numbers([cell(1, 4.0), cell(2, 6.0)])) == 2


WANTED = parse_spec(
    SPEC % ", wanted: [{a: 3, speed: 500}, {a: 6, speed: 300}]", "two.yaml"
).experiment


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_wanted_cells_are_found_again_in_the_order_of_the_spec(order):
    seen = [cell(1, 3.2, 480.0), cell(2, 5.6, 320.0), cell(3, 4.4, 400.0)]
    chosen = choose_cells(WANTED, [seen[k] for k in order])
    assert [c.number for c in chosen] == [1, 2]


@pytest.mark.parametrize(
    ("a", "speed", "found"),
    [
        (6 * math.exp(0.29), 300.0, True),
        (6 * math.exp(-0.29), 300.0, True),
        (6 * math.exp(0.31), 300.0, False),
        (6 * math.exp(-0.31), 300.0, False),
        (6.0, 300 * math.exp(-0.31), False),
        (6.0, 300 * math.exp(0.29), True),
    ],
)
def test_a_wanted_cell_must_be_similar_in_turning_rate_and_in_speed(a, speed, found):
    seen = [cell(1, 3.0, 500.0), cell(2, a, speed)]
    if found:
        assert len(choose_cells(WANTED, seen)) == 2
        return
    with pytest.raises(AbortError, match=r"rate 6.00 rad/s and speed 300 .* was not found again"):
        choose_cells(WANTED, seen)


def test_chosen_cells_are_robots_at_their_places_with_targets_without_crossing_ways():
    cells = [cell(4, 5.0, 380.0, 2400.0, 900.0, 1.5), cell(9, 3.0, 420.0, 600.0, 1100.0, -2.0)]
    experiment = set_robots(EXPERIMENT, cells)
    first, second = experiment.robots
    assert (first.name, first.start, first.heading) == ("cell 1", (2400.0, 900.0), 1.5)
    assert (first.a, first.speed, first.target) == (5.0, 380.0, (2500.0, 1000.0))
    assert (second.name, second.target) == ("cell 2", (500.0, 1000.0))
    assert not experiment.must_choose_robots and EXPERIMENT.must_choose_robots
    assert experiment.setup.a.tolist() == [5.0, 3.0]
    assert EXPERIMENT.setup.a.tolist() == [4.0, 4.0]


def test_a_lost_robot_is_replaced_by_the_cell_that_is_most_similar_to_it():
    setup = set_robots(EXPERIMENT, [cell(1, 5.0, 400.0), cell(2, 3.0, 500.0)]).setup
    seen = [cell(7, 5.2, 390.0), cell(8, 4.6, 420.0), cell(9, 3.1, 490.0)]
    assert find_most_similar(setup, 0, seen).number == 7
    assert find_most_similar(setup, 1, seen).number == 9
    assert find_most_similar(setup, 1, seen[:2]) is None
    assert find_most_similar(setup, 0, []) is None
    assert find_most_similar(setup, 0, [cell(1, 5.0, 400 * math.exp(0.31))]) is None
    assert find_most_similar(setup, 0, [cell(1, 5.0, 400 * math.exp(-0.29))]) is not None


def test_scattered_cells_are_away_from_the_edges_and_near_the_typical_values():
    random = np.random.default_rng(2)
    found = []
    for _ in range(60):
        found += generate_cells(require_choice(EXPERIMENT), EXPERIMENT.setup, random)
    assert [c.number for c in found[:7]] == [1, 2, 3, 4, 5, 6, 1]
    x, y, heading = np.array([(c.pose.x, c.pose.y, c.pose.heading) for c in found]).T
    for values, low, high in ((x, 375, 2625), (y, 250, 1750), (heading, -math.pi, math.pi)):
        margin = 0.03 * (high - low)
        assert low <= values.min() < low + margin and high - margin < values.max() <= high
    assert np.exp(np.mean(np.log([c.a for c in found]))) == pytest.approx(4.0, rel=0.1)
    assert np.exp(np.mean(np.log([c.speed for c in found]))) == pytest.approx(400.0, rel=0.1)
    for c in found:
        assert c.magnetised and c.free
        assert c.a_sd / c.a == pytest.approx(c.speed_sd / c.speed) == pytest.approx(0.03)


def test_there_is_a_scattered_cell_for_each_robot():
    choice = require_choice(EXPERIMENT).model_copy(update={"choose": 9})
    assert len(generate_cells(choice, EXPERIMENT.setup, np.random.default_rng(1))) == 9


def test_targets_on_a_ring_are_evenly_spaced_anticlockwise_from_its_right():
    points = np.array(Ring(center=(10.0, -5.0), radius=2.0).points(4))
    assert points == pytest.approx(np.array([(12, -5), (10, -3), (8, -5), (10, -7)]))
