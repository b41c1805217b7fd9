"""Tests that the robots of the wrong shapes move as their names say."""

import numpy as np
import pytest
from testkit.plants import PAIR, sim
from testkit.trials import experiment
from worlds.disturbances import UnmodelledSection

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer, Stop

pytestmark = pytest.mark.slow

AHEAD = 0.0  # the robots start with this heading [rad]
ROBOTS = [{**robot, "a": 4} for robot in PAIR]
SPEEDS = np.array([100, 50])  # of the robots [mm/s]


def driven(kind, size, *actions, each_s=1.0):
    """Send each action for some time. Return the last pose of each robot after each action."""
    spec = experiment(robots=ROBOTS, obstacles=[], plant={"motion": "exact"})
    disturbances = (UnmodelledSection(type=kind, size=size),) if kind else ()
    plant = spec.plant.model_copy(update={"disturbances": disturbances})
    simulated = sim(spec.model_copy(update={"plant": plant}), 1)
    simulated.open()
    poses = []
    for number, action in enumerate(actions, 1):
        simulated.send(action)
        simulated.clock.sleep_until(round(number * each_s * SECOND))
        poses.append(simulated.observe().poses.array())
    return np.array(poses)


def test_slow_turning_is_behind_by_its_time_constant():
    (undisturbed,) = driven(None, 0, Steer(1.0), each_s=0.3)
    (slow,) = driven("slow-turning", 0.25, Steer(1.0), each_s=0.3)
    assert (slow[:, 2] > 0).all()
    assert (slow[:, 2] < 0.6 * undisturbed[:, 2]).all()


def test_proportional_robots_turn_faster_at_large_angles():
    (undisturbed,) = driven(None, 0, Steer(3.0), each_s=0.3)
    (proportional,) = driven("proportional", 1.0, Steer(3.0), each_s=0.3)
    assert (proportional[:, 2] > 3 * undisturbed[:, 2]).all()


def test_rolling_robots_come_to_rest_after_the_stop():
    """They roll on by speed times time constant."""
    started, stopped = driven("rolling", 0.2, Steer(AHEAD), Stop(), each_s=2.0)
    np.testing.assert_allclose((stopped - started)[:, 0], 0.2 * SPEEDS, rtol=0.02)


def test_a_filling_buffer_makes_directions_late():
    (first, *_, last) = np.diff(driven("filling-buffer", 0.3, *[Steer(AHEAD)] * 3), axis=0)
    assert np.allclose(first, last)
    turned = driven("filling-buffer", 3.0, *[Steer(u) for u in (AHEAD, 0, 0, 0, 1.0)], each_s=0.9)
    assert (turned[-1, :, 2] == 0).all()  # sent at 3.6 s, and due 0.9 s later


def test_the_measured_point_goes_round_the_pivot():
    turned = driven("pivot", 20.0, Steer(AHEAD), Steer(3.0), each_s=3.0)
    undisturbed = driven(None, 0, Steer(AHEAD), Steer(3.0), each_s=3.0)
    off = turned - undisturbed
    np.testing.assert_allclose(np.hypot(off[..., 0], off[..., 1]), 20.0, rtol=1e-6)
    assert np.abs(off[0] - off[1]).max() > 5


def test_cells_swim_at_an_angle_to_their_body():
    (swum,) = driven("askew", 0.35, Steer(AHEAD), each_s=3.0)
    (straight,) = driven(None, 0, Steer(AHEAD), each_s=3.0)
    way = swum[:, :2] - straight[:, :2] + SPEEDS[:, None] * 3.0 * [1, 0]
    angles = np.abs(np.arctan2(way[:, 1], way[:, 0]))
    assert ((angles > 0.1) & (angles < 0.6)).all()
    assert np.array_equal(swum[:, 2], straight[:, 2])
