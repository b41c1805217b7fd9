"""Robots that receive nothing and keep their directions."""

from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control.silence import Silence
from tetractl.core.poses import Poses
from tetractl.model.obstacles import Obstacles

SETUP = experiment().setup
PROBLEM = experiment(controller={"motion": "exact"}).controller.problem(SETUP)


def robots_at(places, speed_mm_s):
    """The problem of three robots that head to the right at these places (3, 2) [mm]."""
    poses = Poses.of(np.column_stack([places, np.zeros(3)]))
    return replace(PROBLEM, poses=poses, speed=np.array(speed_mm_s))


def keeps_clear(silence, problem, direction):
    """Whether robots that receive nothing keep clear from their places in one direction."""
    only_step = problem.poses.array()[None]
    return silence.keeps_clear(only_step, np.array([direction]))


@pytest.mark.parametrize(
    ("direction", "seconds", "clear"),
    [(0.0, 1.0, True), (0.0, 3.0, False), (3.0, 2.5, True), (np.pi / 2, 1.0, True)],
)
def test_a_direction_held_for_too_long_leads_into_a_wall(direction, seconds, clear):
    """Robots at 200 mm/s, 400 mm from the wall that they face and 380 from where they may not go:
    straight on they reach it after 1.9 s."""
    x = SETUP.arena.right - 400
    problem = robots_at([(x, 600), (x, 1200), (x, 1800)], speed_mm_s=[200.0, 200, 200])
    walls = Obstacles.of([], 20.0, SETUP.arena)
    silence = Silence.during(seconds, problem, walls, 0.0)
    assert keeps_clear(silence, problem, direction) is clear


@pytest.mark.parametrize(("separation", "clear"), [(50.0, True), (150.0, False)])
def test_robots_that_meet_under_a_direction_held_are_not_clear(separation, clear):
    """In the second of silence the first catches up by 100 of the 200 mm to the second."""
    problem = robots_at([(900, 900), (1100, 900), (900, 1600)], speed_mm_s=[200.0, 100, 150])
    silence = Silence.during(1.0, problem, Obstacles.of(), separation)
    assert keeps_clear(silence, problem, direction=0.0) is clear
