"""Tests of the record of a robot's step."""

import math

import numpy as np
import pytest
from scipy.stats import linregress

from tetractl.core.poses import Pose
from tetractl.core.robot_step import RobotStep


def test_a_robot_on_an_arc_has_gone_the_arc_and_nothing_across():
    """A quarter circle of radius 100: the arc is 157.1 long, the chord 141.4."""
    step = RobotStep.from_poses(Pose(0.0, 0.0, 0.0), Pose(100.0, 100.0, math.pi / 2))
    arc = 100 * math.pi / 2
    assert step.motion.tolist() == pytest.approx([arc, 0.0, math.pi / 2], abs=1e-9)


def test_a_shift_to_the_left_of_the_heading_is_positive_across():
    step = RobotStep.from_poses(Pose(5.0, 5.0, math.pi / 2), Pose(2.0, 5.0, math.pi / 2))
    assert step.motion.tolist() == pytest.approx([0.0, 3.0, 0.0])


def test_a_heading_that_passes_half_a_turn_turns_the_shorter_way():
    step = RobotStep.from_poses(Pose(0.0, 0.0, 3.1), Pose(0.0, 0.0, -3.1))
    assert step.motion[2] == pytest.approx(2 * math.pi - 6.2)


def test_a_fitted_step_is_the_speed_with_the_error_of_its_slope():
    """Noise e at n times over T gives a slope the error e sqrt(12 / n) / T."""
    rng = np.random.default_rng(620601)
    times_s = np.linspace(0, 1, 400)
    places = np.outer(times_s, [3.0, 0.0, 0.1]) + rng.normal(0, [0.5, 0.5, 0.01], (400, 3))
    step = RobotStep.fit(times_s, places)
    assert step.std == pytest.approx(np.array([0.5, 0.5, 0.01]) * math.sqrt(12 / 400), rel=0.15)
    assert np.all(abs(step.motion - [3.0, 0.0, 0.1]) < 4 * step.std)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_the_variance_of_a_step_from_few_poses_is_that_of_a_regression(n):
    """SciPy's standard error of a slope is the reference."""
    rng = np.random.default_rng(620602)
    times_s = 5 + np.sort(rng.uniform(0, 1, n))
    places = np.outer(times_s, [3.0, -2.0, 0.1]) + rng.normal(0, [0.5, 0.2, 0.01], (n, 3))
    step = RobotStep.fit(times_s, places)
    lines = [linregress(times_s, column) for column in places.T]
    assert step.motion == pytest.approx([line.slope for line in lines])
    assert step.std == pytest.approx([line.stderr for line in lines])
