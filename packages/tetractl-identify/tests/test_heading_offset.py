"""Tests of the angle from a robot's heading to its motion, which turning must not change."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tetractl_identify.heading_offset import DrivenSteps, fit_heading_offset

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
    angle = fit_heading_offset(driven(1, offset), in_one_ratio=False)
    assert angle.low <= offset <= angle.high
    assert angle.high - angle.low < 0.02


@pytest.mark.parametrize("side", [None, 1, -1])
def test_a_point_ahead_of_the_axle_and_a_slip_are_no_rotation(side):
    """Regression: a car that slips to one side had a heading offset of -0.27 rad."""
    steps = driven(2, ahead=0.03, slip=-0.2, side=side)
    angle = fit_heading_offset(steps, in_one_ratio=False)
    mean = float(np.angle(steps.displacement.sum()))
    assert angle.value == pytest.approx(0.0, abs=0.01)
    assert side is None or abs(mean) > 0.1


def test_a_rotation_is_found_of_a_car_that_slips_to_one_side():
    angle = fit_heading_offset(driven(3, offset=0.5, slip=-0.2, side=1), in_one_ratio=False)
    assert angle.value == pytest.approx(0.5, abs=0.02)


def test_on_a_circle_nobody_can_tell():
    angle = fit_heading_offset(driven(4, slip=-0.2, side=1), in_one_ratio=True)
    assert (angle.low, angle.high) == (-math.pi, math.pi)


def test_intervals_of_noisy_poses_hold_the_truth():
    """95 % intervals, of 60 recordings with steps as long as their noise."""
    angles = [
        fit_heading_offset(driven(seed, 0.1, noise_m=0.05), False) for seed in range(100, 160)
    ]
    assert sum(angle.low <= 0.1 <= angle.high for angle in angles) >= 52


def changed(steps, **fields):
    return replace(steps, **fields)


def same(angle, other, sign=1.0):
    ends = (other.low, other.high) if sign > 0 else (-other.high, -other.low)
    assert angle.value == pytest.approx(sign * other.value, abs=1e-9)
    assert (angle.low, angle.high) == pytest.approx(ends, abs=1e-9)


STEPS = driven(7, offset=0.2, ahead=0.02, slip=-0.1, noise_m=5e-3)
ANGLE = fit_heading_offset(STEPS, False)


def test_a_unit_of_length_or_time_changes_no_angle():
    in_mm = changed(
        STEPS, displacement=1000 * STEPS.displacement, distance_sent=1000 * STEPS.distance_sent
    )
    same(fit_heading_offset(in_mm, False), ANGLE)
    slower = changed(STEPS, duration_s=7 * STEPS.duration_s)
    same(fit_heading_offset(slower, False), ANGLE)


def test_a_mirrored_robot_has_the_opposite_angle():
    mirrored = changed(STEPS, displacement=STEPS.displacement.conj(), turn_sent=-STEPS.turn_sent)
    same(fit_heading_offset(mirrored, False), ANGLE, -1.0)


def test_a_robot_that_is_sent_backwards_and_drives_backwards_has_the_same_angle():
    backwards = changed(STEPS, displacement=-STEPS.displacement, distance_sent=-STEPS.distance_sent)
    turned = fit_heading_offset(backwards, False)
    assert turned.value == pytest.approx(ANGLE.value, abs=0.02)
    half = np.where(np.arange(COUNT) % 2 == 0, 1.0, -1.0)
    both = changed(
        STEPS, displacement=half * STEPS.displacement, distance_sent=half * STEPS.distance_sent
    )
    assert fit_heading_offset(both, False).value == pytest.approx(ANGLE.value, abs=0.02)


def test_a_robot_that_drives_against_its_commands_is_half_a_turn_off():
    against = fit_heading_offset(changed(STEPS, displacement=-STEPS.displacement), False)
    turn = abs(against.value - ANGLE.value)
    assert turn == pytest.approx(math.pi, abs=0.02)


def test_more_noise_and_fewer_blocks_make_a_wider_interval():
    def width(steps):
        angle = fit_heading_offset(steps, False)
        return angle.high - angle.low

    quiet, loud = (
        [width(driven(seed, noise_m=noise)) for seed in range(5)] for noise in (1e-3, 1e-2)
    )
    assert np.mean(loud) / np.mean(quiet) == pytest.approx(10, rel=0.3)
    few = [
        width(changed(driven(seed), block=np.arange(COUNT) // (COUNT // 3))) for seed in range(20)
    ]
    many = [width(driven(seed)) for seed in range(20)]
    assert np.mean(few) > 1.3 * np.mean(many)


def test_a_few_steps_of_another_body_hardly_matter():
    moved = STEPS.displacement.copy()
    moved[::60] *= 1j
    angle = fit_heading_offset(changed(STEPS, displacement=moved), False)
    assert angle.value == pytest.approx(ANGLE.value, abs=0.03)


def test_slow_steps_hardly_matter():
    """Their angles are those of the noise."""
    way = STEPS.distance_sent.copy()
    moved = STEPS.displacement.copy()
    way[::10] *= 1e-4
    moved[::10] = 1e-4 * moved[::10] * np.exp(2j)
    angle = fit_heading_offset(changed(STEPS, distance_sent=way, displacement=moved), False)
    assert angle.value == pytest.approx(ANGLE.value, abs=0.02)


def test_a_robot_that_does_not_move_has_any_angle():
    still = fit_heading_offset(changed(STEPS, displacement=0 * STEPS.displacement), False)
    assert (still.low, still.high) == (-math.pi, math.pi)


def test_no_interval_is_wider_than_a_turn():
    lost = fit_heading_offset(driven(3, noise_m=50.0), False)
    assert lost.high - lost.low <= 2 * math.pi + 1e-9
