"""Tests of disturbances: what each method changes, what it leaves, and what logs say."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.built_disturbance import BuiltSection
from testkit.plants import PAIR, PERIOD, driven, sim
from testkit.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Poses
from tetractl.spec.disturbance import Disturbance

pytestmark = pytest.mark.slow

STRAIGHT = [0.0] * 5  # directions of five periods: a second
START_X = 900  # of both robots of PAIR [mm]
SPEEDS = np.array([100, 50])  # of PAIR, which head to the right [mm/s]
PERIOD_S = PERIOD / SECOND


def way(simulated):
    """How far each robot is seen to have come [mm]."""
    return simulated.observe().poses.x - START_X


def plant(*disturbances, seed=1, **fields):
    """A simulation of PAIR with these disturbances."""
    sections = [BuiltSection.holding(disturbance) for disturbance in disturbances]
    section = {"disturbances": sections, **fields}
    return sim(experiment(robots=PAIR, obstacles=[], plant=section), seed)


def test_a_command_that_is_lost_is_so_in_the_motion_and_in_the_record():
    class OneLosesAll(Disturbance):
        def sent(self, command):
            return replace(command, reached=command.reached & [False, True])

    simulated = plant(OneLosesAll())
    sent, _ = driven(simulated, STRAIGHT)
    assert way(simulated) == pytest.approx([0, 50])
    assert all(command.delivered == (False, True) for command in sent)


def test_a_stop_waits_for_a_late_command_and_settle_for_the_stop():
    class Late(Disturbance):
        def sent(self, command):
            return replace(command, due_ns=command.due_ns + SECOND)

    simulated = plant(Late())
    simulated.open()
    simulated.send(Steer(0.0))
    simulated.stop()
    assert simulated.settle().final.x == pytest.approx([START_X, START_X])
    assert simulated.clock.now() > SECOND


def test_one_robot_alone_may_hear_later():
    class SecondIsLate(Disturbance):
        def sent(self, order):
            return replace(order, late_ns=np.array([0, PERIOD]))

    simulated = plant(SecondIsLate())
    driven(simulated, STRAIGHT)
    assert way(simulated) == pytest.approx(SPEEDS * [1.0, 1.0 - PERIOD_S])
    simulated.stop()  # which it hears later, too
    assert simulated.settle().final.x - START_X == pytest.approx(SPEEDS)


@pytest.mark.parametrize("drive", [None, {}])
@pytest.mark.parametrize("motion", ["exact", "euler"])
def test_a_robot_whose_a_and_speed_vanish_stands_and_goes_on_as_before(motion, drive):
    class Held(Disturbance):
        """Stands for something that holds the second robot from 0.2 to 0.6 s."""

        def varied(self, a, speed, time_s):
            is_held = 0.2 <= time_s < 0.6
            free = np.array([1.0, 0.0 if is_held else 1.0])
            return a * free, speed * free

    robots = [robot | {"a": 2.0, "heading": 1.0} for robot in PAIR]
    spec = {"motion": motion, "disturbances": [BuiltSection.holding(Held())]}
    if drive is not None:
        spec["drive"] = drive
    wheels = {"wheels": {"radius": 40}}
    held = sim(experiment(robots=robots, obstacles=[], plant=spec, **wheels))
    free = sim(experiment(robots=robots, obstacles=[], plant=spec | {"disturbances": []}, **wheels))

    def end_of_second_robot(simulated, seconds):
        """Where it is after so long under one direction."""
        simulated.open()
        simulated.send(Steer(0.0))
        simulated.clock.sleep_until(round(seconds * SECOND))
        simulated.observe()
        return simulated.poses.array()[1]

    stood_s = 0.4
    end = end_of_second_robot(held, 0.6 + stood_s)
    assert end == pytest.approx(end_of_second_robot(free, 0.6), abs=0.01)


def test_moved_acts_on_the_true_poses_before_a_frame_is_exposed():
    class Drift(Disturbance):
        """Stands for something that carries who moves upwards at 10 mm/s; it adds up how long."""

        seconds = 0.0

        def moved(self, poses, moving, seconds, time_s):
            self.seconds += seconds
            assert time_s == pytest.approx(self.seconds)
            return Poses(poses.x, poses.y + 10 * seconds * moving, poses.heading)

    drift = Drift()
    simulated = plant(drift)
    _, samples = driven(simulated, STRAIGHT)
    truth = samples[-1].truth
    assert truth.y - [800, 900] == pytest.approx([10, 10], abs=1e-9)
    assert simulated.poses.y == pytest.approx(truth.y, abs=1e-9)
    assert samples[-1].observation.poses.y == pytest.approx(truth.y)
    assert drift.seconds == pytest.approx(1.0)


def test_measured_acts_on_the_frame_alone_and_who_is_lost_keeps_the_last_pose():
    class Blind(Disturbance):
        """Stands for a camera that is 1 mm off, and loses the second robot after half a second."""

        def measured(self, poses, valid, time_s):
            shifted = Poses(poses.x + 1, poses.y, poses.heading)
            return shifted, valid & [True, time_s < 0.5]

    simulated = plant(Blind())
    _, samples = driven(simulated, STRAIGHT)
    for sample in samples:
        observation = sample.observation
        truth = sample.truth
        assert observation.poses.x[0] == pytest.approx(truth.x[0] + 1)
        assert observation.valid.tolist() == [True, observation.sampled_ns < SECOND // 2]
    last_seen = max(s.truth.x[1] for s in samples if s.observation.valid[1])
    assert samples[-1].observation.poses.x[1] == pytest.approx(last_seen + 1)


def test_disturbances_act_in_order_each_with_draws_of_its_own():
    class Draws(Disturbance):
        def __init__(self, factor):
            self.factor = factor

        def parameters(self, a, speed):
            self.drawn = self.rng.uniform()
            return a, (speed + self.factor) * 2

    first = Draws(1.0)
    two = Draws(10.0)
    simulated = plant(first, two)
    assert simulated.speed.tolist() == [((100 + 1) * 2 + 10) * 2, ((50 + 1) * 2 + 10) * 2]
    assert first.drawn != two.drawn
    again = Draws(1.0)
    second = Draws(1.0)
    plant(again)
    plant(second, seed=2)
    assert again.drawn == first.drawn != second.drawn


PLANTS = {
    "direct": {},
    "wheels": {"drive": {"rate": 40}},
    "cells": {"cells": {"walls": False}},
}


class Holds(Disturbance):
    """Stands for something that holds the first robot from 1 s of its own moving on, for `time`."""

    def __init__(self, time):
        self.time = time
        self.driven = np.zeros(3)

    def moved(self, poses, moving, seconds, time_s):
        self.driven = self.driven + moving * seconds
        return poses

    def varied(self, a, speed, time_s):
        held = (self.driven >= 1) & (self.driven < 1 + self.time)
        held[1:] = False
        return np.where(held, 0.0, a), np.where(held, 0.0, speed)


def held_for(seconds, plant):
    spec = experiment(wheels={"radius": 40}, obstacles=[], plant=plant)
    held = [BuiltSection.holding(Holds(seconds))]
    section = spec.plant.model_copy(update={"disturbances": held})
    simulated = sim(spec.model_copy(update={"plant": section}))
    simulated.open()
    gone = []
    for k in range(40):
        if k < 35:
            simulated.send(Steer(0.5 * (k % 3)))
        elif k == 35:
            simulated.stop()
        simulated.clock.sleep_until((k + 1) * SECOND // 5)
        gone += [sample.truth.x[0] for sample in simulated.samples()]
    return np.array(gone)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=list(PLANTS))
def test_a_robot_that_is_held_for_a_time_of_driving_goes_on(plant):
    """It was given moving = 0 for that robot, so that the time of driving stood still too."""
    x = held_for(2.0, plant)
    still = np.abs(np.diff(x)) < (1e-9 if not plant.get("cells") else 0.5)
    assert still[150:350].all()
    assert not still[370:].all()


def test_a_planning_time_is_asked_for_with_the_time_of_the_step_in_seconds():
    class Plans(Disturbance):
        def __init__(self):
            self.asked_s = []

        def planning_s(self, time_s):
            self.asked_s.append(time_s)
            return 0.05

    plans = Plans()
    driven(plant(plans), STRAIGHT[:3])
    assert plans.asked_s == pytest.approx([0.0, PERIOD_S, 2 * PERIOD_S])
