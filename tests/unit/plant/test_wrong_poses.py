"""Tests that a disturbance whose poses cannot be logged ends the trial before logging."""

import numpy as np
import pytest
from testkit.built_disturbance import BuiltSection
from testkit.plants import sim
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import Poses
from tetractl.spec.disturbance import Disturbance

pytestmark = pytest.mark.slow


class Moves(Disturbance):
    """Stands for a disturbance of another package that moves robots to `poses`."""

    def __init__(self, poses):
        self.poses = poses

    def moved(self, poses, moving, seconds, time_s):
        return self.poses


class Measures(Disturbance):
    """Stands for a disturbance of another package that shows robots at `poses`."""

    def __init__(self, poses):
        self.poses = poses

    def measured(self, poses, valid, time_s):
        return self.poses, valid


class Arrives(Disturbance):
    """Stands for a disturbance of another package by which every frame arrives at `arrival_ns`."""

    def __init__(self, arrival_ns):
        self.arrival_ns = arrival_ns

    def received(self, exposed_ns, arrival_ns):
        return self.arrival_ns


class Plans(Disturbance):
    """Stands for a disturbance of another package by which planning takes `seconds`."""

    def __init__(self, seconds):
        self.seconds = seconds

    def planning_s(self, time_s):
        return self.seconds


def disturbed(disturbance):
    """A simulation of the experiment with this disturbance alone."""
    section = BuiltSection.holding(disturbance)
    spec = experiment()
    plant = spec.plant.model_copy(update={"disturbances": (section,)})
    return sim(spec.model_copy(update={"plant": plant}))


def drive_for_a_second(plant):
    plant.send(Steer(0.0))
    plant.clock.sleep_until(SECOND)
    plant.samples()


def starts_at(x):
    """The starts of the experiment's robots, with another x."""
    rows = experiment().setup.starts.array()
    rows[:, 0] = x
    return Poses.from_array(rows)


@pytest.mark.parametrize("x", [np.nan, np.inf, 1e300])
@pytest.mark.parametrize("disturbance", [Moves, Measures])
def test_poses_that_no_log_can_hold_end_the_trial(disturbance, x):
    plant = disturbed(disturbance(starts_at(x)))
    with pytest.raises(WrongValueError, match="pose that cannot be logged"):
        plant.open()
        drive_for_a_second(plant)


@pytest.mark.parametrize("arrival_ns", [np.nan, -1])
def test_a_frame_that_arrives_before_it_was_exposed_ends_the_trial(arrival_ns):
    plant = disturbed(Arrives(arrival_ns))
    plant.open()
    with pytest.raises(WrongValueError, match="arrival of a frame before"):
        drive_for_a_second(plant)


@pytest.mark.parametrize("seconds", [np.nan, -1.0, 10**30])
def test_a_planning_time_that_no_log_can_hold_ends_the_trial(seconds):
    plant = disturbed(Plans(seconds))
    plant.open()
    with pytest.raises(WrongValueError, match="a planning time of"):
        drive_for_a_second(plant)
