"""Tests of turning on the spot out of a corner: three robots in a row near one or two walls."""

import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.control.methods.turns import (
    FACINGS,
    FAILED_TURNS_MAX,
    NOT_TURNING,
    STEPS_PER_TURN,
    choose_facing,
    find_freest_direction,
)
from tetractl.control.search.discs import Discs
from tetractl.core.poses import Poses, wrap

SETUP = experiment().setup
PROBLEM = experiment(controller={"type": "mpc"}).controller.problem(SETUP)
BODY = 47.0  # radius [mm]
APART = 2 * BODY  # bodies that touch [mm]
BODIES = Discs(BODY, SETUP.obstacles, SETUP.arena)
IN_A_ROW = 105.0  # distance of neighbours [mm]: 11 mm of room between their bodies
FAR = 700.0  # distance of a wall beyond the longest drive straight ahead, of 320 mm [mm]
NEAR = 60.0  # distance of a wall that each robot would reach [mm]: 13 mm of room
UPWARDS = math.pi / 2
BETWEEN_FACINGS = 2 * math.pi / FACINGS


def row_of_robots(from_left_wall, from_bottom_wall):
    """The problem of three robots that stand side by side and head to the right, the first of them
    at these distances [mm] from two walls."""
    x = SETUP.arena.left + from_left_wall + IN_A_ROW * np.arange(3)
    y = np.full(3, SETUP.arena.bottom + from_bottom_wall)
    return replace(PROBLEM, poses=Poses(x, y, np.zeros(3)))


def facing_after(problem, turning):
    """The direction of the next step of robots that have turned so far as `turning` says."""
    return choose_facing(problem, BODIES, APART, turning)


def facings(problem):
    """The directions of one step after another until there is none."""
    turning = NOT_TURNING
    facing = facing_after(problem, turning)
    while facing is not None:
        yield facing
        turning = turning.after_step(facing)
        facing = facing_after(problem, turning)


def test_robots_beside_a_wall_turn_away_from_it():
    """To the left and right there is room."""
    above_the_lower_wall = row_of_robots(FAR, NEAR)
    facing = find_freest_direction(above_the_lower_wall, BODIES, APART)
    assert facing == pytest.approx(UPWARDS, abs=BETWEEN_FACINGS)


def test_robots_in_a_corner_turn_to_where_they_come_nearer_to_neither_wall():
    in_the_lower_left_corner = row_of_robots(NEAR, NEAR)
    facing = find_freest_direction(in_the_lower_left_corner, BODIES, APART)
    assert -1e-9 < facing < UPWARDS + 1e-9


def test_a_direction_is_kept_for_some_steps_also_if_poses_are_measured_anew():
    """Regression: a robot opposite to it dithered, as each step chose another one: 1,769 turns."""
    first_facing = facing_after(row_of_robots(FAR, NEAR), NOT_TURNING)
    turning = NOT_TURNING.after_step(first_facing)
    measured_elsewhere = row_of_robots(NEAR, FAR)
    for _ in range(1, STEPS_PER_TURN):
        assert facing_after(measured_elsewhere, turning) == first_facing
        turning = turning.after_step(first_facing)
    assert facing_after(measured_elsewhere, turning) != first_facing


def test_turns_in_vain_are_followed_by_turns_to_other_directions_and_end():
    """Regression: a trial ended in a corner at once, 4.3 m from its targets: two bodies touched."""
    facing_of_steps = list(facings(row_of_robots(FAR, NEAR)))
    assert len(facing_of_steps) == STEPS_PER_TURN * FAILED_TURNS_MAX
    facing_of_turns = facing_of_steps[::STEPS_PER_TURN]
    assert len(set(facing_of_turns)) == FAILED_TURNS_MAX  # none twice
    assert facing_of_steps == list(np.repeat(facing_of_turns, STEPS_PER_TURN))
    changes = np.abs(wrap(np.diff(facing_of_turns)))
    assert changes.min() > math.pi / 2  # to other sides, not to neighbours
