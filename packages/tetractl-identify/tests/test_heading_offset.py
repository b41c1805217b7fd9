"""Tests of the angle from a robot's heading to its motion, which turning must not change."""

import math

import numpy as np
import pytest
from tetractl_identify.heading_offset import DrivenSteps, heading_offset

STEP_S = 0.1
COUNT = 600
BLOCK_STEPS = 60


def driven(seed, offset=0.0, ahead=0.0, slip=0.0, side=None, noise_m=5e-4):
    """Steps of a robot at 0.3 to 1.2 m/s that turns at up to 2 rad/s, by default to both sides.

    The motion points `offset` [rad] aside of the heading; the tracked point is `ahead` [m] of the
    axle; a car slips by `slip` [rad s2/m] times its speed times its turning rate.
    """
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(0.3, 1.2, COUNT // 10), 10)
    rate = np.repeat(rng.uniform(-2, 2, COUNT // 10), 10)
    if side is not None:
        rate = side * np.abs(rate)
    way = speed * STEP_S
    turn = rate * STEP_S
    moved = way * np.exp(1j * (offset + slip * speed * rate)) + 1j * ahead * turn
    moved += rng.normal(0, noise_m, COUNT) + 1j * rng.normal(0, noise_m, COUNT)
    block = np.arange(COUNT) // BLOCK_STEPS
    return DrivenSteps(moved, np.full(COUNT, STEP_S), way, turn, block)


@pytest.mark.parametrize("offset", [0.3, -1.57, 3.0])
def test_a_body_that_is_defined_rotated_is_found(offset):
    angle = heading_offset(driven(1, offset), in_one_ratio=False)
    assert angle.low <= offset <= angle.high
    assert angle.high - angle.low < 0.02


@pytest.mark.parametrize("side", [None, 1, -1])
def test_a_point_ahead_of_the_axle_and_a_slip_are_no_rotation(side):
    """Regression: a car that slips to one side had a heading offset of -0.27 rad."""
    steps = driven(2, ahead=0.03, slip=-0.2, side=side)
    angle = heading_offset(steps, in_one_ratio=False)
    mean = float(np.angle(steps.moved.sum()))
    assert angle.value == pytest.approx(0.0, abs=0.01)
    assert side is None or abs(mean) > 0.1


def test_a_rotation_is_found_of_a_car_that_slips_to_one_side():
    angle = heading_offset(driven(3, offset=0.5, slip=-0.2, side=1), in_one_ratio=False)
    assert angle.value == pytest.approx(0.5, abs=0.02)


def test_on_a_circle_nobody_can_tell():
    angle = heading_offset(driven(4, slip=-0.2, side=1), in_one_ratio=True)
    assert (angle.low, angle.high) == (-math.pi, math.pi)


def test_intervals_of_noisy_poses_hold_the_truth():
    """95 % intervals, of 60 recordings with steps as long as their noise."""
    angles = [heading_offset(driven(seed, 0.1, noise_m=0.05), False) for seed in range(100, 160)]
    assert sum(angle.low <= 0.1 <= angle.high for angle in angles) >= 52
