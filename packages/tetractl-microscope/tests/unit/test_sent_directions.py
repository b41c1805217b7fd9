"""Tests of deciding which directions acted if several explain the turning of robots."""

from dataclasses import replace

import numpy as np
import pytest
from tetractl_microscope.sent_directions import (
    DELAYS_S,
    SHORT_DELAYS_S,
    TIME_STEP_S,
    RobotCourse,
    SentDirections,
    check_directions,
    create_mirror_reading,
    create_other_readings,
)

from tetractl.core.errors import UsageError

A_RAD_S = 4.0
DRIVE_S = 24
SENT_S = np.arange(0, DRIVE_S, 1.5)


def sent_every_1_5_s(directions):
    """Directions [rad], each of which acts until the next."""
    return SentDirections(SENT_S, directions)


RANDOM = sent_every_1_5_s(np.random.default_rng(3).uniform(-3, 3, 16))

EVEN_AT_FIRST = sent_every_1_5_s(np.tile([0.0, 1.57, 3.0, -1.57, -0.6, 2.2, 0.9, -2.4], 2))
"""A step late, four of eight are those that were sent, rotated by a quarter of a turn."""

REGULAR = sent_every_1_5_s(np.tile([0.0, 1.57, 3.14, -1.57], 4))


def course_by(sent: SentDirections, late_s: float = 0.0, drive_s=DRIVE_S) -> RobotCourse:
    """The heading of a robot that turns by directions, each of which acts late."""
    times = np.arange(0, drive_s, TIME_STEP_S)
    heading = 0.3
    headings = []
    for acts in sent.field_at(times - late_s):
        headings.append(heading)
        sine = (acts * np.exp(-1j * heading)).imag  # of the angle towards the direction
        heading += A_RAD_S * TIME_STEP_S * sine
    return RobotCourse(times, np.array(headings))


def check(turned: list[RobotCourse], sent: SentDirections, least: float = 0.0) -> None:
    readings = [
        create_mirror_reading("p.csv", "c.csv", sent),
        *create_other_readings("c.csv", sent, 1 / 30),
    ]
    check_directions("p.csv", turned, sent, DELAYS_S, readings, least)


@pytest.mark.parametrize(
    ("clock_s", "says"),
    [
        (1.2, "robots turn 1.2 s before the directions"),
        (-3.4, "robots turn 3.4 s after the directions"),
    ],
)
@pytest.mark.parametrize("sent", [RANDOM, EVEN_AT_FIRST], ids=["random", "even at first"])
def test_directions_of_another_clock_are_refused_with_the_difference(sent, clock_s, says):
    """Regression: of directions 1 s late, a was 2.40 (2.19 to 2.64) rad/s instead of 4."""
    stated = replace(sent, times=sent.times + clock_s)
    with pytest.raises(UsageError, match=rf"c\.csv: {says}"):
        check([course_by(sent)], stated)


def test_a_clock_within_a_regular_cycle_is_refused():
    """Regression: a warning that the field is rotated by 2 rad, and an a of -1.4 for 4."""
    turned = [course_by(REGULAR, late_s=-1.1)]
    readings = create_other_readings("c.csv", REGULAR, 1 / 30)
    with pytest.raises(UsageError, match=r"robots turn 1\.1 s before the directions"):
        check_directions("p.csv", turned, REGULAR, SHORT_DELAYS_S, readings)


def test_a_mirror_image_that_no_dead_time_explains_is_refused():
    mirrored = replace(RANDOM, angles=-RANDOM.angles)
    with pytest.raises(
        UsageError, match=r"p\.csv: robots turn right when the directions in c\.csv turn left"
    ):
        check([course_by(mirrored)], RANDOM)


TURNING_ON = {
    "a field that rotates": 0.9 * np.arange(0.0, DRIVE_S, 0.2),
    "one that rotates clockwise, to and fro": 4 * np.cos(0.7 * np.arange(0.0, DRIVE_S, 0.2)),
    "a random walk": np.cumsum(np.random.default_rng(5).normal(0, 0.4, 5 * DRIVE_S)),
}


@pytest.mark.parametrize("name", TURNING_ON)
def test_directions_in_degrees_that_count_on_by_small_steps_are_refused(name):
    """Regression: an a of 1.07 for 4. Their steps of up to 30 could be rad as well."""
    right = SentDirections(np.arange(0.0, DRIVE_S, 0.2), TURNING_ON[name])
    turned = [course_by(right, late_s=0.1)]
    check(turned, right)
    with pytest.raises(
        UsageError, match=r"c.csv: the motion of robots fits the directions only if .* degrees"
    ):
        check(turned, replace(right, angles=np.degrees(right.angles)))


def a_quarter_lost(sent):
    """Four of the directions, each sent once, did not reach the robot."""
    kept = np.ones(len(sent.times), dtype=bool)
    kept[[3, 6, 7, 12]] = False
    return SentDirections(sent.times[kept], sent.angles[kept])


FOLLOWED = {
    "as they are": lambda: course_by(RANDOM),
    "after 1.4 s": lambda: course_by(RANDOM, late_s=1.4),
    "a quarter of them lost": lambda: course_by(a_quarter_lost(RANDOM)),
    "rotated": lambda: course_by(replace(RANDOM, angles=RANDOM.angles + 0.4)),
}


@pytest.mark.parametrize("name", FOLLOWED)
def test_directions_that_robots_follow_explain_most_turns(name):
    check([FOLLOWED[name]()], RANDOM, least=0.4)


def test_directions_of_another_robot_explain_few_turns():
    """Regression: an a of 1.50 (1.30 to 1.74) for 4, exit code 0."""
    of_another = sent_every_1_5_s(np.random.default_rng(8).uniform(-3, 3, 16))
    with pytest.raises(UsageError, match=r"p\.csv: the commands explain only 1?\d% of the turns"):
        check([course_by(RANDOM)], of_another, least=0.2)


ALTERNATING = sent_every_1_5_s(np.tile([1.2, -1.2], 8))


def test_directions_that_act_a_step_late_are_not_taken_for_their_mirror_image():
    """The mirror image of alternating directions is they themselves, a step of 1.5 s later."""
    check([course_by(ALTERNATING, late_s=1.5)], ALTERNATING)


def test_robots_that_hardly_turn_show_nothing():
    times = np.arange(0, DRIVE_S, TIME_STEP_S)
    noise = np.random.default_rng(1).normal(0, 0.003, len(times))
    check([RobotCourse(times, 1.0 + noise)], sent_every_1_5_s(np.full(16, 1.0)), least=1.0)
