"""Robots that receive nothing and keep their directions."""

from dataclasses import replace

import numpy as np
import pytest
from support.trials import experiment

from tetractl.control.silence import Silence
from tetractl.core.poses import Poses
from tetractl.model.obstacles import Obstacles


@pytest.mark.parametrize(
    ("direction", "seconds", "clear"),
    [(0.0, 1.0, True), (0.0, 3.0, False), (3.0, 2.5, True), (np.pi / 2, 1.0, True)],
)
def test_a_direction_held_for_too_long_leads_into_a_wall(direction, seconds, clear):
    """Robots at 200 mm/s, the first 400 mm from the wall that it faces."""
    setup = experiment().setup
    section = experiment(controller={"motion": "exact"}).controller
    x = setup.arena.right - 400
    poses = Poses(np.array([x, x, x]), np.array([600.0, 1200, 1800]), np.zeros(3))
    problem = replace(section.problem(setup), poses=poses, speed=np.full(3, 200.0))
    obstacles = Obstacles.of([], 20.0, setup.arena)
    path = poses.array()[None]
    signals = np.array([direction])
    assert Silence.during(seconds, problem, obstacles, 0.0).keeps_clear(path, signals) is clear


def test_robots_that_meet_under_a_direction_held_are_not_clear():
    """The first catches up by 100 of the 200 mm between it and the second."""
    setup = experiment().setup
    section = experiment(controller={"motion": "exact"}).controller
    poses = Poses(np.array([900.0, 1100, 900]), np.array([900.0, 900, 1600]), np.zeros(3))
    problem = replace(section.problem(setup), poses=poses, speed=np.array([200.0, 100, 150]))
    path = poses.array()[None]
    for apart, clear in ((50.0, True), (150.0, False)):
        silence = Silence.during(1.0, problem, Obstacles.of(), apart)
        assert silence.keeps_clear(path, np.zeros(1)) is clear
