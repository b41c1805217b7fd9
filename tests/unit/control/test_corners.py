"""The way out of a corner, from standing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control.corners import OUT, STILL, away, turn_away, way_out
from tetractl.control.cost import predict
from tetractl.control.evaluate import compiled_drive
from tetractl.control.margins import Margins
from tetractl.core.poses import Poses
from tetractl.core.setup import Bounds

SETUP = experiment().setup
CIRCLE = float((SETUP.speed / SETUP.a).max())  # the widest that a robot drives at full turn


def standing(poses):
    margins = Margins(SETUP.obstacles, SETUP.arena, SETUP.targets)
    section = experiment(controller={"type": "mpc"}).controller
    return replace(section.problem(SETUP), poses=Poses.of(np.array(poses))), margins


def facing_the_wall(gap):
    """Three robots side by side that face the upper edge of the arena."""
    y = SETUP.arena.top - gap
    return [[x, y, math.pi / 2] for x in (900.0, 1200.0, 1600.0)]


def test_robots_that_face_a_wall_turn_away_from_it_where_there_is_room():
    problem, margins = standing(facing_the_wall(1.5 * CIRCLE))
    signals = way_out(problem, margins, 95.0)
    assert signals is not None
    room = margins.room(*np.moveaxis(predict(problem, signals)[..., :2], -1, 0), 95.0)
    assert room.min() > 0
    assert room[-1] > room[0]


def test_there_is_none_where_every_arc_leads_out():
    problem, margins = standing(facing_the_wall(0.5 * CIRCLE))
    assert way_out(problem, margins, 95.0) is None


@pytest.mark.parametrize("heading", np.linspace(-0.6, 0.6, 7))
def test_a_robot_that_touches_a_wall_goes_no_deeper_within_a_signal(heading):
    """Regression: from 0.1 mm within the lower edge, 1.8 mm at 0.07 s of a signal of 0.2 s."""
    y = SETUP.arena.bottom - 0.1
    problem, margins = standing([[900.0, y, heading], [1200, 1400, 0], [1600, 1900, 0]])
    out, _ = away(problem, margins, 95.0)
    if out is not None:
        fine = replace(problem, period=problem.period / 20, first_period=problem.period / 20)
        path = predict(fine, np.repeat(out, 20))
        assert margins.room(path[..., 0], path[..., 1], 95.0).min() > -0.3


def test_where_every_arc_leads_out_turning_on_the_spot_gives_a_way_out():
    problem, margins = standing(facing_the_wall(0.1 * CIRCLE))
    facing = turn_away(problem, margins, 95.0)
    assert facing is not None
    assert facing < 0  # away from the upper edge
    still = replace(problem, speed=np.zeros(3))
    turned = Poses.of(compiled_drive(still, np.full(3, facing), np.array([OUT.turn_s]))[0])
    assert way_out(replace(problem, poses=turned), margins, 95.0) is not None


def test_robots_turn_on_the_spot_rather_than_pass_close_to_a_wall(monkeypatch):
    """Regression: a way out kept 1 mm by prediction, and led 3 mm out of the arena."""
    problem, margins = standing(facing_the_wall(1.1 * CIRCLE))
    close = way_out(problem, margins, 95.0, keep_s=0.0)
    assert close is not None
    room = margins.room(*np.moveaxis(predict(problem, close)[..., :2], -1, 0), 95.0)
    assert 0 < room.min() < 0.1 * CIRCLE
    out, facing = away(problem, margins, 95.0)
    assert out is None
    assert facing is not None
    monkeypatch.setattr("tetractl.control.corners.turn_away", lambda *_: None)
    out, facing = away(problem, margins, 95.0)
    assert facing is None
    np.testing.assert_array_equal(out, close)


@pytest.mark.parametrize("gap", [75.0, 123.7])
def test_a_way_out_keeps_bodies_clear(gap):
    """Regression: from 123.7 mm a way out led a body of 47 mm 24 mm beyond the edge."""
    problem, _ = standing(facing_the_wall(gap))
    margins = Margins(SETUP.obstacles, SETUP.arena, SETUP.targets, 47.0)
    out, facing = away(problem, margins, 95.0)
    assert (facing is None) == (gap > 100)
    if out is not None:
        edge = SETUP.arena.inside(*np.moveaxis(predict(problem, out)[..., :2], -1, 0))
        assert edge.min() > 47


def test_no_turn_helps_in_an_arena_as_narrow_as_a_corridor():
    problem, _ = standing(facing_the_wall(500.0))
    middle = SETUP.arena.top - 500.0
    corridor = Bounds(895.0, middle - 5.0, 1605.0, middle + 5.0)
    assert turn_away(problem, Margins((), corridor, SETUP.targets), 95.0) is None


def test_robots_side_by_side_that_face_a_wall_turn_away_from_it():
    """Regression: the trial ended at once, 3.9 m from its targets: ways out are narrow there."""
    top = SETUP.arena.top - 60
    problem, _ = standing([[829.0, top, 1.7], [724.0, top, -2.3], [934.0, top, 1.64]])
    margins = Margins(SETUP.obstacles, SETUP.arena, SETUP.targets, 47.0)
    out, facing = away(problem, margins, 95.0)
    assert out is None
    assert math.sin(facing) < -0.9


def test_two_robots_do_not_come_too_near_on_it():
    poses = np.array(facing_the_wall(500.0))
    poses[1] = [1000.0, poses[0, 1] - 30, -math.pi / 2]
    problem, margins = standing(poses)
    signals = way_out(problem, margins, 95.0)
    assert signals is not None
    x, y = np.moveaxis(predict(problem, signals)[..., :2], -1, 0)
    assert np.hypot(x[:, 0] - x[:, 1], y[:, 0] - y[:, 1]).min() > 95


@pytest.mark.parametrize("seed", range(20))
def test_it_never_leads_further_into_anything(seed):
    rng = np.random.default_rng(seed)
    arena = SETUP.arena
    x = rng.uniform(arena.left, arena.right, 3)
    y = rng.uniform(arena.bottom, arena.top, 3)
    problem, margins = standing(np.column_stack([x, y, rng.uniform(-4, 4, 3)]))
    signals = way_out(problem, margins, 0.0)
    if signals is not None:
        path = predict(problem, signals)
        room = margins.room(path[..., 0], path[..., 1], 0.0)
        assert room.min() >= min(0.0, room[0])
    assert signals is not None or margins.room(x, y, 0.0) < 2 * CIRCLE


def test_a_direction_to_turn_to_is_kept_until_the_turn_has_led_nowhere():
    """Regression: a robot opposite to it dithered, as each step chose another one: 1,769 turns."""
    problem, margins = standing(facing_the_wall(1.1 * CIRCLE))
    close = way_out(problem, margins, 95.0, keep_s=0.0)
    turning = STILL.then(away(problem, margins, 95.0)[1])
    for step in range(1, OUT.turns):
        assert turning.steps == step
        out, facing = away(problem, margins, 95.0, turning)
        assert (out, facing) == (None, turning.facing)
        turning = turning.then(facing)
    out, facing = away(problem, margins, 95.0, turning)
    assert facing is None
    np.testing.assert_array_equal(out, close)
    assert turning.then(None) == STILL


def test_where_nothing_is_predicted_to_help_robots_turn_to_one_direction_after_another(monkeypatch):
    """Regression: a trial ended in a corner at once, 4.3 m from its targets: two bodies touched."""
    problem, margins = standing(facing_the_wall(1.1 * CIRCLE))
    for name in ("way_out", "turn_away"):
        monkeypatch.setattr(f"tetractl.control.corners.{name}", lambda *_: None)
    turning, tried = STILL, []
    while (facing := away(problem, margins, 95.0, turning)[1]) is not None:
        turning = turning.then(facing)
        tried.append(facing)
    assert len(tried) == OUT.vain * OUT.turns
    assert tried[:: OUT.turns] == list(dict.fromkeys(tried))  # each kept, none twice
