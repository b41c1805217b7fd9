"""Tests of the measures of one trial, on trials whose numbers are known by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_papers import ou_measures as measures

from tetractl.core.poses import Poses
from tetractl.core.trial import Result

NAMES = ("one", "two")
STARTS = Poses(np.array([0.0, 100.0]), np.array([0.0, 50.0]), np.zeros(2))
TARGETS = np.array([[200.0, 10.0], [50.0, 40.0]])
SETUP = SimpleNamespace(names=NAMES, starts=STARTS, targets=TARGETS)


def trial(**parts):
    """A logged trial of two robots that has these parts only."""
    return SimpleNamespace(start=SimpleNamespace(setup=SETUP), **parts)


def ended(**fields):
    """A trial that ended with these fields of its result."""
    return trial(result=SimpleNamespace(**fields))


def searched(*histories, chosen=0, cost=math.nan):
    """A control step whose searches had these lowest costs, iteration by iteration."""
    searches = [SimpleNamespace(history=np.array(history, float)) for history in histories]
    return SimpleNamespace(plan=SimpleNamespace(searches=searches, chosen=chosen, cost=cost))


def test_the_error_of_a_robot_is_the_mean_of_the_robots():
    log = ended(total_error=30.0)
    assert measures.get_total_error(log) == 30
    assert measures.mean_robot_error(log) == 15


@pytest.mark.parametrize(
    ("measure", "field"),
    [(measures.entered_obstacle, "entered_obstacle"), (measures.left_arena, "left_arena")],
)
def test_a_fact_of_the_result_holds_only_if_there_is_a_result(measure, field):
    assert hasattr(Result, field)
    assert measure(ended(**{field: True}))
    assert not measure(ended(**{field: False}))
    assert not measure(trial(result=None))


def test_the_start_of_a_search_is_no_iteration():
    log = trial(steps=[searched([9, 8, 7], [5]), searched([4, 3])])
    assert measures.mean_iterations(log) == pytest.approx((2 + 0 + 1) / 3)


def test_the_first_cost_and_history_are_those_of_the_chosen_search_of_step_0():
    first = searched([9, 8], [7, 6, 5], chosen=1, cost=5.5)
    log = trial(steps=[first, searched([4, 3], cost=3.0)])
    assert measures.first_cost(log) == 5.5
    assert measures.chosen_cost_history(log).tolist() == [7, 6, 5]


def test_a_warm_gain_compares_the_middle_plan_with_a_new_controller_of_the_same_key():
    asked = []

    class Controller:
        def __init__(self, setup, key):
            asked.append((setup, key))

        def plan(self, observation, command):
            asked.append((observation, command))
            return PLAN

    controller = SimpleNamespace(build=lambda setup, key: Controller(setup, key))
    steps = [
        SimpleNamespace(plan=SimpleNamespace(cost=10.0 * k), observation=f"o{k}", command=f"c{k}")
        for k in range(5)
    ]
    log = trial(steps=steps, experiment=SimpleNamespace(controller=controller))
    assert measures.warm_start_cost_change(log) == 20 - PLAN.cost
    assert asked == [(SETUP, 2), ("o2", "c1")]


PLAN = measures.Plan(np.zeros(1), np.zeros((2, 2, 3)), 3.0, 3.0, 0.0, (), 0, 0)


def test_robots_are_off_their_start_by_the_straight_way_in_the_plane():
    there_and_back = np.full((3, 2, 3), 7.0)
    there_and_back[1, :, 0] = 1000
    there_and_back[2, 0] = 10, 11, 2.0  # the heading is no way
    assert measures.mean_displacement(trial(truth=there_and_back)) == pytest.approx((5 + 0) / 2)


def test_early_is_the_part_of_the_fall_in_ten_iterations():
    history = [110.0 - k for k in range(10)] + [100.0] + [60.0] * 5
    log = trial(steps=[searched(history)])
    assert measures.early_decrease_fraction(log) == pytest.approx(10 / 50)


def test_a_cost_that_halves_is_exponential_and_one_that_falls_evenly_is_not():
    halving = trial(steps=[searched(2.0 ** -np.arange(30))])
    falling = trial(steps=[searched(100 - np.arange(90.0))])
    assert measures.exponential_fit_advantage(halving) > 0.3
    assert measures.exponential_fit_advantage(falling) < -0.05
    steps = np.arange(30.0)
    r_squared = np.corrcoef(steps, 2.0**-steps)[0, 1] ** 2
    assert measures.exponential_fit_advantage(halving) == pytest.approx(1 - r_squared)


def test_space_is_the_box_of_the_paths_over_that_of_starts_and_targets():
    truth = np.zeros((2, 2, 3))
    truth[0, 0, :2] = -10, 20
    truth[0, 1, :2] = 90, 30
    truth[1, 0, :2] = 30, 60
    truth[1, 1] = math.nan, 1e9, 0.0  # is not known, and takes no space
    assert measures.relative_space(trial(truth=truth)) == pytest.approx(100 * 40 / (200 * 50))


# ---- fields that rotate ----

TIMES_S = 0.5 * np.arange(200)
TURN = 2 * math.pi


def turned(*pieces, per_step=0.1):
    """The angle of a field that turns by these pieces after each other, about per_step at once."""
    angle = [0.0]
    for piece in pieces:
        steps = math.ceil(abs(piece) / per_step)
        angle += (angle[-1] + piece * np.arange(1, steps + 1) / steps).tolist()
    return np.array(angle)


def time_of(*pieces):
    angle = turned(*pieces)
    return measures.sum_rotation_time_s(angle, TIMES_S[: len(angle)])


def duration_of(piece):
    return 0.5 * math.ceil(abs(piece) / 0.1)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_field_spins_from_a_whole_turn_on_in_either_sense(sense):
    assert time_of(sense * (TURN - 0.01)) == 0
    assert time_of(sense * (TURN + 0.01)) == duration_of(TURN + 0.01)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_small_reversal_does_not_end_a_turn_and_a_greater_one_does(sense):
    half = TURN / 2 + 0.2
    small = time_of(sense * half, -sense * 0.29, sense * half)
    assert small == pytest.approx(2 * duration_of(half) + duration_of(0.29))
    assert time_of(sense * half, -sense * 0.31, sense * half) == 0


@pytest.mark.parametrize("sense", [1, -1])
def test_turns_to_both_sides_add_up_and_less_than_a_turn_between_does_not(sense):
    whole = TURN + 0.2
    assert time_of(sense * whole, -sense * whole) == 2 * duration_of(whole)
    both = time_of(sense * whole, -sense * 3.0, sense * whole)
    assert both == 2 * duration_of(whole)


def test_a_field_that_never_turns_does_not_spin():
    assert measures.sum_rotation_time_s(np.zeros(50), TIMES_S[:50]) == 0


def spinning_of(directions):
    steps = [SimpleNamespace(plan=SimpleNamespace(direction=u)) for u in directions]
    return measures.rotation_duration_s(trial(steps=steps, steps_s=TIMES_S[: len(steps)]))


def wrapped(angle):
    return (np.remainder(angle + math.pi, TURN) - math.pi).tolist()


def test_the_directions_of_a_trial_are_unwrapped_and_a_stop_interrupts_them():
    directions = wrapped(turned(TURN + 0.1))
    spun_s = duration_of(TURN + 0.1)
    assert spinning_of(directions) == spun_s
    assert spinning_of([*directions, None, *directions]) == 2 * spun_s
    middle = len(directions) // 2
    assert spinning_of([*directions[:middle], None, *directions[middle:]]) == 0
    assert spinning_of([None, None, 0.3]) == 0


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=60), st.floats(-3, 3))
def test_where_a_field_begins_and_its_sense_change_nothing(changes, begin):
    angle = np.cumsum([0.0, *changes])
    time_s = TIMES_S[: len(angle)]
    spun_s = measures.sum_rotation_time_s(angle, time_s)
    assert 0 <= spun_s <= time_s[-1]
    assert measures.sum_rotation_time_s(-angle, time_s) == spun_s
    moved_s = measures.sum_rotation_time_s(angle + TURN * round(begin), time_s)
    assert moved_s == pytest.approx(spun_s)
