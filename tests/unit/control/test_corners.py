"""Turns on the spot out of a corner."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control.corners import (
    FACINGS,
    NOT_TURNING,
    STEPS,
    TURNS_IN_VAIN,
    next_facing,
    roomiest,
)
from tetractl.control.discs import Discs
from tetractl.core.poses import Poses, wrap

SETUP = experiment().setup
BODY = 47.0  # mm
APART = 2 * BODY
STEP = 2 * math.pi / FACINGS


def standing(xy):
    """Three robots that stand at xy (3, 2) with headings of 0, and their bodies."""
    discs = Discs(BODY, SETUP.obstacles, SETUP.arena)
    section = experiment(controller={"type": "mpc"}).controller
    poses = Poses.of(np.column_stack([xy, np.zeros(3)]))
    return replace(section.problem(SETUP), poses=poses), discs


def in_a_row(left, bottom):
    """Places 105 mm apart, beginning at a distance from the left and from the bottom wall."""
    x = SETUP.arena.left + left + 105.0 * np.arange(3)
    return np.column_stack([x, np.full(3, SETUP.arena.bottom + bottom)])


def turns(problem, discs):
    """The directions of one step after another until there is none."""
    turning = NOT_TURNING
    while (facing := next_facing(problem, discs, APART, turning)) is not None:
        turning = turning.then(facing)
        yield facing


def test_robots_beside_a_wall_turn_away_from_it():
    """The lower wall is 60 mm off; to the left and right there is room."""
    assert roomiest(*standing(in_a_row(700.0, 60.0)), APART) == pytest.approx(math.pi / 2, abs=STEP)


def test_robots_in_a_corner_turn_to_where_they_come_nearer_to_neither_wall():
    facing = roomiest(*standing(in_a_row(60.0, 60.0)), APART)
    assert -1e-9 < facing < math.pi / 2 + 1e-9


def test_robots_whose_bodies_touch_a_wall_turn_away_from_it():
    assert roomiest(*standing(in_a_row(700.0, BODY - 5.0)), APART) == pytest.approx(
        math.pi / 2, abs=STEP
    )


def test_a_direction_is_kept_for_some_steps_also_if_poses_are_measured_anew():
    """Regression: a robot opposite to it dithered, as each step chose another one: 1,769 turns."""
    problem, discs = standing(in_a_row(700.0, 60.0))
    turning = NOT_TURNING.then(next_facing(problem, discs, APART, NOT_TURNING))
    moved, discs = standing(in_a_row(60.0, 700.0))
    for _ in range(1, STEPS):
        assert next_facing(moved, discs, APART, turning) == turning.facing
        turning = turning.then(turning.facing)
    assert next_facing(moved, discs, APART, turning) != turning.facing


def test_turns_in_vain_are_followed_by_turns_to_other_directions_and_end():
    """Regression: a trial ended in a corner at once, 4.3 m from its targets: two bodies touched."""
    tried = list(turns(*standing(in_a_row(700.0, 60.0))))
    assert len(tried) == STEPS * TURNS_IN_VAIN
    assert tried[::STEPS] == list(dict.fromkeys(tried))  # each kept, none twice
    steps = np.abs(wrap(np.diff(tried[::STEPS])))
    assert steps.min() > math.pi / 2  # to other sides, not to neighbours


def test_robots_that_do_anything_else_begin_to_turn_anew():
    assert NOT_TURNING.then(1.0).then(None) == NOT_TURNING
