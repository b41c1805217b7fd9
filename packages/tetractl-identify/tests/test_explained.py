"""Tests of how much of measured motion the commands explain, and when the two contradict."""

import numpy as np
import pytest
from tetractl_identify.explained import (
    Explained,
    assign_windows,
    explain_steps,
    refuse_contradicted,
)

from tetractl.core.errors import UsageError

STEPS = 8000
STEP_S = 0.1
EACH_ALONE = np.arange(STEPS)
"""Windows of one step."""
WINDOWS = assign_windows(STEP_S * np.arange(STEPS), STEP_S * np.arange(1, STEPS + 1))


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
    of_turning = explain_steps(turned, asked, asked, noise, EACH_ALONE)
    assert of_turning.fraction == pytest.approx(0.5, abs=0.05)
    assert of_turning.unexplained_sum == pytest.approx(
        STEPS, rel=0.1
    )  # the variance of the others is 1


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.4])
def test_distances_have_the_noise_of_one_direction(noise):
    """Regression: the noise across the motion was taken off what was unexplained along it."""
    rng = np.random.default_rng(7742)
    asked = rng.uniform(2.0, 4.0, STEPS)
    other = white(rng, 1.0)
    along = asked + other + noise_of_steps(rng, noise)
    moved = along + 1j * noise_of_steps(rng, noise)
    of_distance = explain_steps(moved, asked, asked, noise, EACH_ALONE)
    assert of_distance.unexplained_sum == pytest.approx(np.square(other).sum(), rel=0.15)
    without_noise = explain_steps(asked + other + 0j, asked, asked, 0.0, EACH_ALONE)
    assert of_distance.fraction == pytest.approx(without_noise.fraction, abs=0.02)


def test_a_car_that_slips_aside_drives_as_far_as_it_was_asked_to():
    asked = np.random.default_rng(7743).uniform(2.0, 4.0, STEPS)
    moved = np.asarray(asked * np.exp(0.6j), dtype=np.complex128)
    assert explain_steps(moved, asked, asked, 0.0, WINDOWS).fraction == pytest.approx(1)


def test_a_robot_that_drives_backwards_instead_of_ahead_is_not_explained():
    asked = np.random.default_rng(7744).uniform(2.0, 4.0, STEPS)
    assert explain_steps(-asked + 0j, asked, asked, 0.0, WINDOWS).fraction == 0


def test_of_noise_alone_nothing_can_be_explained():
    rng = np.random.default_rng(7745)
    turned = noise_of_steps(rng, 1.0)
    of_turning = explain_steps(turned, np.zeros(STEPS), np.zeros(STEPS), 1.0, WINDOWS)
    assert of_turning.fraction is None
    assert str(of_turning) == "-"


def test_slow_turns_that_noise_hides_in_each_step_are_seen_over_seconds():
    rng = np.random.default_rng(7746)
    asked = np.repeat(white(rng, 0.2)[: STEPS // 10], 10)
    turned = asked + noise_of_steps(rng, 1.0)
    seen_in_steps = explain_steps(turned, asked, asked, 1.0, EACH_ALONE)
    assert seen_in_steps.fraction is None
    assert explain_steps(turned, asked, asked, 1.0, WINDOWS).fraction == pytest.approx(
        1.0, abs=0.15
    )


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
    of_motion = Explained(fraction, unexplained_sum=4.0, asked_sum=asked)
    assert of_motion.is_contradicted(may_follow) is is_contradicted


def test_all_motion_that_follows_the_commands_is_explained_and_none_that_opposes_them():
    asked = white(np.random.default_rng(7747), 1.0)
    whole = explain_steps(asked, asked, asked, 0.0, WINDOWS)
    assert whole.fraction == pytest.approx(1.0)
    assert whole.unexplained_sum == pytest.approx(0.0, abs=1e-9)
    assert explain_steps(asked, -asked, asked, 0.0, WINDOWS).fraction == 0.0
    assert explain_steps(asked, np.zeros(STEPS), asked, 0.0, EACH_ALONE).fraction == pytest.approx(
        0
    )


def test_the_scale_that_explains_more_counts():
    """Motion back and forth cancels over seconds, and noise hides slow motion in single steps."""
    back_and_forth = np.where(np.arange(STEPS) % 2 == 0, 1.0, -1.0)
    found = explain_steps(back_and_forth, back_and_forth, back_and_forth, 0.0, WINDOWS)
    assert found.fraction == pytest.approx(1.0)
    assert found.asked_sum == pytest.approx(STEPS)


def test_what_is_asked_is_a_sum_of_squares_over_steps_or_windows():
    ones = np.ones(STEPS)
    assert explain_steps(ones, ones, 2 * ones, 0.0, EACH_ALONE).asked_sum == pytest.approx(
        4 * STEPS
    )
    complex_ones = ones + 0j
    assert explain_steps(complex_ones, ones, ones, 0.0, EACH_ALONE).asked_sum == pytest.approx(
        STEPS
    )


@pytest.mark.parametrize(("fraction", "text"), [(1.0, "100%"), (0.476, "48%"), (0.0, "0%")])
def test_a_fraction_is_printed_as_percent(fraction, text):
    assert str(Explained(fraction, 0.0, 0.0)) == text


@pytest.mark.parametrize(
    ("fraction", "is_contradicted"), [(0.49, True), (0.5, False), (0.51, False)]
)
def test_half_of_the_motion_is_enough(fraction, is_contradicted):
    assert (
        Explained(fraction, unexplained_sum=1.0, asked_sum=1.0).is_contradicted(False)
        is is_contradicted
    )
    assert (
        Explained(fraction, unexplained_sum=1.0, asked_sum=1.0).is_contradicted(True)
        is is_contradicted
    )


def windows(*steps):
    return assign_windows(*np.array(steps, dtype=float).T).tolist()


def test_windows_last_a_second_from_the_first_step():
    times = np.arange(25) * 0.1 + 7.3
    numbers = assign_windows(times, times + 0.1)
    assert [int((numbers == k).sum()) for k in np.unique(numbers)] == [10, 10, 5]


def test_a_gap_begins_a_new_window_and_counts_anew():
    assert windows((0, 0.4), (0.4, 0.8), (0.9, 1.3), (1.3, 1.7)) == [1, 1, 2, 2]
    assert windows((0, 0.6), (0.6, 1.2), (1.2, 1.8)) == [1, 1, 2]
    assert windows((0, 0.6), (0.7, 1.2), (1.2, 1.8)) == [1, 2, 2]
    assert assign_windows(np.zeros(0), np.zeros(0)).tolist() == []


def test_steps_of_an_earlier_track_are_in_another_window():
    assert windows((5, 5.5), (0, 0.5), (0.5, 1.0)) == [1, 2, 2]


def test_robots_whose_commands_contradict_them_are_refused_by_name():
    refuse_contradicted(("p.csv",), [])
    with pytest.raises(UsageError) as caught:
        refuse_contradicted(("p.csv", "c.csv"), [("one", "3% of the turning"), ("two", "x")])
    assert caught.value.message.startswith(
        "p.csv and c.csv: the commands and the poses of one, two do not belong together"
    )
    assert caught.value.message.endswith("(one: 3% of the turning; two: x)")
