"""Tests of how much of measured motion the commands explain, and when the two contradict."""

import numpy as np
import pytest
from tetractl_identify.explained import Explained, explained, windows_of

STEPS = 8000
STEP_S = 0.1
EACH_ALONE = np.arange(STEPS)
"""Windows of one step."""
WINDOWS = windows_of(STEP_S * np.arange(STEPS), STEP_S * np.arange(1, STEPS + 1))


def white(rng, std):
    """Independent normal numbers, one per step."""
    return np.asarray(rng.normal(0.0, std, STEPS), dtype=np.float64)


def noise_of_steps(rng, std):
    """The noise of steps between poses that each have a noise of this standard deviation."""
    return np.diff(np.asarray(rng.normal(0.0, std, STEPS + 1), dtype=np.float64))


@pytest.mark.parametrize("noise", [0.0, 0.3, 0.7])
def test_turns_of_which_half_follow_the_commands_are_half_explained_whatever_the_noise(noise):
    rng = np.random.default_rng(7741)
    asked = white(rng, 1.0)
    turned = asked + white(rng, 1.0) + noise_of_steps(rng, noise)
    of_turning = explained(turned, asked, asked, noise, EACH_ALONE)
    assert of_turning.fraction == pytest.approx(0.5, abs=0.05)
    assert of_turning.rest == pytest.approx(STEPS, rel=0.1)  # the variance of the others is 1


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.4])
def test_distances_have_the_noise_of_one_direction(noise):
    """Regression: the noise across the motion was taken off what was unexplained along it."""
    rng = np.random.default_rng(7742)
    asked = rng.uniform(2.0, 4.0, STEPS)
    other = white(rng, 1.0)
    along = asked + other + noise_of_steps(rng, noise)
    moved = along + 1j * noise_of_steps(rng, noise)
    of_distance = explained(moved, asked, asked, noise, EACH_ALONE)
    assert of_distance.rest == pytest.approx(np.square(other).sum(), rel=0.15)
    without_noise = explained(asked + other + 0j, asked, asked, 0.0, EACH_ALONE)
    assert of_distance.fraction == pytest.approx(without_noise.fraction, abs=0.02)


def test_a_car_that_slips_aside_drives_as_far_as_it_was_asked_to():
    asked = np.random.default_rng(7743).uniform(2.0, 4.0, STEPS)
    moved = np.asarray(asked * np.exp(0.6j), dtype=np.complex128)
    assert explained(moved, asked, asked, 0.0, WINDOWS).fraction == pytest.approx(1)


def test_a_robot_that_drives_backwards_instead_of_ahead_is_not_explained():
    asked = np.random.default_rng(7744).uniform(2.0, 4.0, STEPS)
    assert explained(-asked + 0j, asked, asked, 0.0, WINDOWS).fraction == 0


def test_of_noise_alone_nothing_can_be_explained():
    rng = np.random.default_rng(7745)
    turned = noise_of_steps(rng, 1.0)
    of_turning = explained(turned, np.zeros(STEPS), np.zeros(STEPS), 1.0, WINDOWS)
    assert of_turning.fraction is None
    assert str(of_turning) == "-"


def test_slow_turns_that_noise_hides_in_each_step_are_seen_over_seconds():
    rng = np.random.default_rng(7746)
    asked = np.repeat(white(rng, 0.2)[: STEPS // 10], 10)
    turned = asked + noise_of_steps(rng, 1.0)
    seen_in_steps = explained(turned, asked, asked, 1.0, EACH_ALONE)
    assert seen_in_steps.fraction is None
    assert explained(turned, asked, asked, 1.0, WINDOWS).fraction == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("fraction", "asked", "may_follow", "is_contradicted"),
    [
        (0.3, 9.0, True, True),  # it was asked to move, and did something else
        (0.3, 1.0, True, False),  # it was hardly asked to move, and wanders more
        (0.3, 1.0, False, True),  # nor can it follow the little that it was asked
        (0.5, 9.0, False, False),
        (None, 9.0, False, False),  # it did nothing that stands out from the noise
    ],
)
def test_commands_are_contradicted_by_other_motion_that_they_ask_for(
    fraction, asked, may_follow, is_contradicted
):
    of_motion = Explained(fraction, rest=4.0, asked=asked)
    assert of_motion.is_contradicted(may_follow) is is_contradicted
