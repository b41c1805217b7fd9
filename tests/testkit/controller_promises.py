"""Tests of what every controller must do. A test file of controllers derives a class from it."""

import math

import numpy as np
import pytest

from testkit.controllers import FOR_ONE_ROBOT, FOR_THREE_ROBOTS
from testkit.plants import sim
from testkit.scripted import observation_of
from testkit.trials import THREE_M3PI, experiment
from tetractl.core.clock import SECOND
from tetractl.core.errors import ControlError
from tetractl.core.plan import Outcome, Plan
from tetractl.log.read.reader import read_trial
from tetractl.run.checked_controller import build_controller
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.verification.recompute import recompute
from tetractl.verification.verify import verify

TARGETS = np.array([[1700.0, 500, 0], [1700, 1500, 0], [1700, 2000, 0]])


def alone(fields):
    """Whether a controller steers one robot only."""
    return fields["type"] in FOR_ONE_ROBOT


def experiment_of(fields, **changes):
    """The reference experiment with a controller, and as many robots as that steers."""
    robots = THREE_M3PI["robots"][: 1 if alone(fields) else None]
    return experiment(**{"robots": robots, "controller": fields} | changes)


def make(fields, key=7):
    return build_controller(experiment_of(fields), key)


def targets_of(fields):
    return TARGETS[: 1 if alone(fields) else None]


def drive(fields, steps, key=7):
    """Let the controller drive a simulation; what it saw and what it decided."""
    spec = experiment_of(fields)
    plant = sim(spec)
    controller = make(fields, key)
    plant.open()
    decisions = []
    for k in range(steps):
        observation = plant.observe()
        decision = controller.plan(observation)
        decisions.append((observation, decision))
        if isinstance(decision, Outcome):
            break
        plant.send(decision.action)
        plant.clock.sleep_until((k + 1) * SECOND // 5)
    return decisions


def short(experiment):
    """The experiment with a limit of four control steps."""
    control = experiment.controller
    short = control.model_copy(update={"time_limit": 4 * control.period})
    return experiment.model_copy(update={"controller": short})


class ControllerPromises:
    """Derive a class of tests from this one; the fixture `fields` of its file gives a controller's
    part of a spec."""

    def test_what_is_logged_is_verified_without_knowing_the_controller(self, fields, tmp_path):
        spec = LoadedSpec(short(experiment_of(fields)), "", "s.yaml")
        run_logged(spec, tmp_path, 0, (), Interrupt())
        path = log_path(tmp_path, 0)
        verification = verify(path)
        assert (verification.problems, verification.checked) == ((), 4)
        assert recompute(read_trial(path), search_again=False).difference is None

    def test_poses_that_are_no_numbers_are_refused(self, fields):
        poses = np.array([[math.nan, 800, 0.3], [900, 1200, 0.1], [900, 1600, -0.2]])
        poses = poses[: len(targets_of(fields))]
        with pytest.raises(ControlError):
            make(fields).plan(observation_of(poses))

    def test_one_robot_or_five_are_steered_too(self, fields):
        if fields["type"] in FOR_THREE_ROBOTS:
            pytest.skip("its network has inputs for three robots")
        for count in (1,) if alone(fields) else (1, 5):
            robots = [
                {"name": f"r{i}", "start": [700, 500 + 300 * i], "target": [1000, 600 + 280 * i]}
                | {"a": 2 + i, "speed": 150}
                for i in range(count)
            ]
            spec = experiment_of(fields, robots=robots, obstacles=[])
            starts = np.array([[*robot.start, robot.heading] for robot in spec.robots])
            plan = build_controller(spec, 1).plan(observation_of(starts))
            assert isinstance(plan, Plan)
            assert plan.path.shape[1] == count

    def test_steps_bring_the_robots_nearer(self, fields):
        targets = targets_of(fields)[:, :2]
        observations = [observation for observation, _ in drive(fields, 12)]
        gaps = [np.hypot(*(o.poses.xy - targets).T).sum() for o in observations]
        assert gaps[-1] < gaps[0]
