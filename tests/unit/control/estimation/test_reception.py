"""Tests of recognising a radio that delivers only few of the directions."""

import math

import numpy as np
import pytest

from tetractl.control.estimation.kernels.filter_state import (
    LOSS_PROBABILITY,
    STATES,
    STATES_OF_WHEELS,
    Bank,
    SentCommands,
)
from tetractl.control.estimation.reception import Reception, is_testable, ln_robot_ratio

LN_CLEAR = 8.0
"""ln of how much likelier a robot's frames are if what they show is true."""
ROBOTS = 3
DIRECTIONS = np.array([0.0, 0.5, 1.0, 1.5])
"""Four directions [rad] that have been sent."""
TESTED = 2
"""Index of the one that is tested, the last one to act."""


def ln_product(heard):
    """ln P if frames show clearly which of the robots heard a direction, `heard` (N,)."""
    likelihood_ratio = np.exp(np.where(heard, LN_CLEAR, -LN_CLEAR))
    return float(np.log((1 - LOSS_PROBABILITY) * likelihood_ratio + LOSS_PROBABILITY).sum())


def after(heard):
    """The test after some directions, `heard` (directions, robots)."""
    reception = Reception()
    for heard_by_robots in heard:
        reception.add_direction(ln_product(heard_by_robots))
    return reception


def by_all(heard):
    """The same for all robots: (directions, robots) of (directions,)."""
    return np.repeat(np.array(heard)[:, None], ROBOTS, axis=1)


ONE_OF_FOUR = [True, False, False, False]


@pytest.mark.parametrize(("directions", "times_detected"), [(8, 0), (12, 1), (16, 1), (24, 2)])
def test_a_radio_is_sparse_that_twice_lets_one_direction_of_four_through(
    directions, times_detected
):
    reception = after(by_all(ONE_OF_FOUR * (directions // 4)))
    assert reception.times_detected == times_detected
    assert reception.is_sparse == (times_detected == 2)


@pytest.mark.parametrize(
    "lost",
    [
        by_all(np.random.default_rng(5).random(5000) < 0.1),
        np.random.default_rng(5).random((5000, ROBOTS)) < 0.3,
    ],
    ids=["one direction in ten", "three in ten by each robot itself"],
)
def test_a_radio_that_loses_some_directions_works(lost):
    assert after(~lost).times_detected == 0


def test_a_silence_is_no_radio_that_lets_few_through():
    one_second = 20 * [False]
    until_the_next = 20 * [True]
    assert after(by_all(5 * (one_second + until_the_next))).times_detected == 0


@pytest.mark.parametrize(
    ("directions", "news"),
    [
        ([0.0, 0.5], True),
        ([0.5, 0.5], False),
        ([math.nan, 0.5], False),
        ([0.0, math.nan], False),
        ([0.1, 0.5, 0.1], False),
        ([0.2, 0.5, 0.1], True),
    ],
)
def test_a_direction_is_tested_if_robots_drive_otherwise_and_follow_it_no_more(directions, news):
    """Regression: the hypothesis that follows the first of A, B, A takes up the third, and those
    that miss it keep their odds, so that frames which say nothing counted as missed."""
    assert is_testable(np.array(directions), len(directions) - 1) == news


def bank_that_follows(directions, weights, acted=TESTED):
    """One filter of one robot, on which the commands up to `acted` have acted, with hypotheses of
    given directions and probabilities; the last hypothesis is that the robot is stuck."""
    std = np.ones((1, STATES_OF_WHEELS))
    bank = Bank.start(np.zeros(1), np.zeros((1, 1, STATES)), std, np.zeros(1, np.int64))
    bank.direction[0, 0] = directions
    bank.ln_weight[0, 0] = np.log(weights)
    bank.next_command[:] = acted + 1
    return bank


def robot_ratio(directions, weights):
    """Its ratio for the direction that is tested."""
    bank = bank_that_follows(directions, weights)
    return math.exp(ln_robot_ratio(bank, 0, 0, DIRECTIONS[TESTED]))


@pytest.mark.parametrize("likelihood_ratio", [1e-3, 1.0, 1e3])
def test_the_ratio_of_a_robot_is_that_of_its_frames(likelihood_ratio):
    """Of hypotheses that missed it, the likelier counts."""
    lost = LOSS_PROBABILITY
    weights = [1e-6, (1 - lost) * likelihood_ratio, lost, 1e-9]
    follows = [DIRECTIONS[0], DIRECTIONS[2], DIRECTIONS[1], DIRECTIONS[0]]
    assert robot_ratio(follows, weights) == pytest.approx((1 - lost) * likelihood_ratio + lost)


def bank_after(command, is_heard, directions):
    """The filter by the last frame before the next command acts: the robot follows the direction,
    or the one before."""
    chance = 1 - 1e-6 if is_heard else 1e-6
    other = (1 - chance) / 2
    follows = [*directions[[command, command - 1, command - 2]], math.nan]
    return bank_that_follows(follows, [chance, other, other, 1e-12], acted=command)


def test_frames_after_the_next_direction_acts_say_nothing():
    """A direction that was missed, by the frames before the next one acts, stays so when later
    ones say that it was heard."""
    reception = Reception()
    commands = SentCommands(0.05 * np.arange(len(DIRECTIONS)), DIRECTIONS)
    filters = np.zeros(1, np.int64)
    reception.add_frame(bank_after(TESTED, False, DIRECTIONS), filters, commands)
    heard_later = [DIRECTIONS[3], DIRECTIONS[2], DIRECTIONS[1], math.nan]
    for heard_weight in (0.5, 0.99):
        weights = [0.001, heard_weight, 0.999 - heard_weight, 1e-12]
        bank = bank_that_follows(heard_later, weights, acted=TESTED + 1)
        reception.add_frame(bank, filters, commands)
    assert reception.ln_ratio > 1


def test_directions_that_the_next_one_turns_back_from_are_tested():
    """Regression: they said nothing, as each was tested after the next one had acted. Of these 80
    directions, each turns back from the one before, and one in four is heard."""
    directions = np.tile([0.0, 1.0, 0.1, 0.9], 20)
    commands = SentCommands(0.05 * np.arange(80), directions)
    reception = Reception()
    for command in range(1, 80):
        bank = bank_after(command, command % 4 == 0, directions)
        reception.add_frame(bank, np.zeros(1, np.int64), commands)
    assert reception.is_sparse
