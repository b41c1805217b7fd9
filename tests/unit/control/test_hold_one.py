"""The hold of one robot that cannot stand still, on the exact motion (1)-(3)."""

import numpy as np
import pytest

from tetractl.control.hold_one import TIGHT, hold_signals
from tetractl.core.plan import Problem
from tetractl.core.poses import Poses
from tetractl.model.motion import exact
from tetractl.model.obstacles import Obstacles

PERIOD, PARTS = 0.1, 4


def distances(a, speed, radius, steps=250, settled=100):
    """Distances from the target, PARTS a period, once it has settled, from a start 2 v / a off."""
    x, y, heading = -2 * speed / a, 0.0, 2.0
    found = []
    for k in range(steps):
        poses = Poses.of(np.array([[x, y, heading]]))
        problem = Problem(
            poses=poses,
            targets=np.zeros((1, 2)),
            a=np.array([a]),
            speed=np.array([speed]),
            motion="exact",
            period=PERIOD,
            first_period=PERIOD,
            obstacles=Obstacles.of(),
            obstacle_weight=0.0,
            swept=False,
        )
        u = hold_signals(problem, a, speed, radius)[0]
        for _ in range(PARTS):
            x, y, heading = exact.step(x, y, heading, u, a, speed, PERIOD / PARTS)
            if k >= settled:
                found.append(float(np.hypot(x, y)))
    return np.array(found)


def test_a_robot_asked_for_less_than_it_can_circles_as_tightly_as_it_can():
    """No signal keeps the mean distance below v / a; here the 95 % disc is hardly wider."""
    floor = 32 / 2.2
    found = distances(2.2, 32.0, 1.0)
    assert found.mean() > 0.99 * floor
    assert np.quantile(found, 0.95) < (TIGHT + 0.03) * floor


@pytest.mark.parametrize("radius", [12.0, 30.0])
def test_a_robot_stays_within_a_radius_that_it_can_keep(radius):
    """Of a radius of 4.7 um or more, as the signals are held for 2.5 / a."""
    assert distances(25.1, 119.0, radius).max() < 1.02 * radius
