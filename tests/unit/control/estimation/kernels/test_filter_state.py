"""Tests of banks of filters as arrays: starts, parts, shared dead times, and limits of chance."""

import math

import numpy as np
import pytest
from scipy.stats import chi2
from testkit import problems

from tetractl.control.estimation.kernels.filter_state import (
    FINEST_STEP_S,
    FOLLOWS,
    GRID_STEP_S,
    HEADING,
    OWN_PROBABILITY,
    OWN_STD_S,
    STATES,
    Bank,
    CommonTimes,
    Forecast,
    NextFilters,
    PoseFrames,
    X,
    Y,
    largest_square_sum,
)
from tetractl.control.estimation.prior import certain_prior

TIMES_S = np.array([0.0, 0.02, 0.04])
STD = np.array([[1.0, 2.0, 0.1, 0.2], [3.0, 4.0, 0.3, 0.4]])


def bank_of():
    """Three filters of two robots, whose states tell which is which."""
    mean = np.zeros((3, 2, STATES))
    mean[..., X] = 10 * np.arange(3)[:, None] + np.arange(2)
    bank = Bank.start(TIMES_S, mean, STD, np.array([4, 5, 6]))
    bank.score[:] = -np.arange(6).reshape(3, 2)
    return bank


def places(bank):
    return bank.state[:, :, 0, X].tolist()


def test_robots_begin_at_rest_in_one_hypothesis():
    bank = bank_of()
    assert bank.ln_weight.shape == (3, 2, FOLLOWS + 1)
    assert (bank.ln_weight[..., 0] == 0).all()
    assert (bank.ln_weight[..., 1:] == -np.inf).all()
    assert np.isnan(bank.direction).all()
    assert (bank.until_s == np.inf).all()
    assert bank.state.shape == (3, 2, FOLLOWS + 1, STATES)
    assert (bank.state[..., X] == bank.state[..., :1, X]).all()
    for robot in range(2):
        expected = np.diag(STD[robot] ** 2)
        assert bank.cov[2, robot, FOLLOWS] == pytest.approx(expected)
    assert bank.dead_time_s.T.tolist() == [TIMES_S.tolist()] * 2
    assert (bank.step_s == GRID_STEP_S).all()
    assert bank.group.T.tolist() == [[4, 5, 6]] * 2
    assert (bank.noise_scale == 1).all()


def test_parts_are_chosen_for_each_robot_by_itself():
    part = bank_of().part(np.array([[2, 0], [1, 1]]))
    assert places(part) == [[20, 1], [10, 11]]
    assert part.dead_time_s.tolist() == [[0.04, 0.0], [0.02, 0.02]]


def test_joined_banks_follow_each_other_and_copies_are_apart():
    bank = bank_of()
    joined = Bank.joined([bank, bank.part(np.array([[1, 2]]))])
    assert places(joined) == [*places(bank), [10, 21]]
    copied = bank.copied()
    copied.state[:] = 9.0
    assert places(bank)[0] == [0, 1]


@pytest.mark.parametrize("count", [3, 5])
def test_rows_that_fill_a_bank_are_no_filters(count):
    padded = bank_of().padded(count)
    assert len(padded.score) == count
    assert padded.score[:3].tolist() == bank_of().score.tolist()
    assert (padded.score[3:] == -np.inf).all()
    assert places(padded)[:3] == places(bank_of())


def test_filters_that_go_on_take_their_new_dead_times_and_scores():
    """The first robot keeps one filter, the second two."""
    bank = bank_of()
    going_on = NextFilters.room_for(4, bank)
    going_on.rows[:] = [[2, 1], [-1, 0], [-1, -1], [-1, -1]]
    going_on.dead_time_s[:2] = [[0.5, 0.6], [9.0, 0.7]]
    going_on.score[:2] = [[-3.0, -4.0], [9.0, -5.0]]
    going_on.step_s[:] = 0.01, 0.02
    taken = going_on.taken_from(bank)
    assert places(taken) == [[20, 11], [20, 1]]
    assert taken.dead_time_s.tolist() == [[0.5, 0.6], [0.5, 0.7]]
    assert taken.score.tolist() == [[-3, -4], [-np.inf, -5]]
    assert taken.step_s.tolist() == [[0.01, 0.02]] * 2
    assert bank.dead_time_s[2, 0] == 0.04
    assert (bank.step_s == GRID_STEP_S).all()


def test_frames_are_parted_like_lists():
    times_s = np.arange(5.0)[:, None]
    frames = PoseFrames(times_s, np.zeros((5, 1, 3)), np.ones((5, 1), np.bool_))
    assert frames.part(1, 3).time_s[:, 0].tolist() == [1, 2]
    assert frames.part(1, 3).poses.shape == (2, 1, 3)


# ---- dead times that robots share ----


def normal_density(gap, width):
    return math.exp(-((gap / width) ** 2) / 2) / width


def common_times(bank, dead_time_s=0.03, std_s=0.01):
    prior = certain_prior(problems.problem(problems.world(1)), dead_time_s)
    return CommonTimes.of(bank, prior._replace(dead_time_std=std_s))


def test_another_robot_has_nearly_the_same_dead_time_or_seldom_one_of_its_own():
    bank = bank_of()
    bank.step_s[:] = 0.02, FINEST_STEP_S / 3
    common = common_times(bank)
    step_s = FINEST_STEP_S / 2
    count = len(common.ln_prior)
    assert step_s * (count - 1) == pytest.approx(0.04 + FINEST_STEP_S / 2)
    for t in (0, 5, count - 1):
        for robot, width in ((0, 0.01), (1, FINEST_STEP_S / 2)):
            for b in range(3):
                gap = t * step_s - TIMES_S[b]
                expected = (1 - OWN_PROBABILITY) * normal_density(gap, width)
                expected += OWN_PROBABILITY * normal_density(gap, OWN_STD_S)
                assert common.near[t, b, robot] == pytest.approx(expected)
        deviation = (t * step_s - 0.03) / 0.01
        assert common.ln_prior[t] == pytest.approx(-(deviation**2) / 2)


def test_a_dead_time_that_is_certain_makes_no_division_by_zero():
    assert np.isfinite(common_times(bank_of(), std_s=0.0).ln_prior).all()


# ---- limits and forecasts ----


@pytest.mark.parametrize("blocks", [10, 20, 100, 2000])
def test_the_limit_of_a_sum_of_squares_is_that_of_chi_square(blocks):
    assert largest_square_sum(blocks) == pytest.approx(chi2(blocks).ppf(0.999), rel=0.01)


def test_an_empty_forecast_says_nothing():
    room = Forecast.room_for(2)
    assert np.isnan(room.x).all()
    assert room.flow.shape == (2, 2)
    assert room.misfit.shape == (2, 3)
    assert room.lag is None
    assert room.dead_time_s == 0


def test_a_forecast_gives_each_number_under_its_name():
    room = Forecast.room_for(2)
    numbers = {}
    for k, name in enumerate(("a", "a_std", "speed", "speed_std", "side", "side_std", "stands")):
        getattr(room, name)[:] = numbers[name] = k + 0.5
    room.x[:], room.y[:], room.heading[:] = 1.0, 2.0, 3.0
    room = room._replace(dead_time_s=0.1, dead_time_std_s=0.02, lag=np.array([0.3, 0.4]))
    estimate = room.estimate
    for name, value in numbers.items():
        assert getattr(estimate, name).tolist() == [value] * 2
    assert (estimate.dead_time, estimate.dead_time_std) == (0.1, 0.02)
    assert estimate.lag.tolist() == [0.3, 0.4]
    assert room.poses.array()[0, [X, Y, HEADING]].tolist() == [1, 2, 3]
