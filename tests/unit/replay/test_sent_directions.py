"""Which directions robots turn by, where several explain their turning."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tetractl.core.errors import UsageError
from tetractl.replay.identification.sent_directions import (
    AT_ONCE_S,
    DELAYS_S,
    GRID_S,
    SentDirections,
    TurnedCourse,
    check_clock_rate,
    check_directions,
    check_rotation,
    image,
    other_readings,
)

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


def course_by(sent: SentDirections, late_s: float = 0.0, drive_s=DRIVE_S) -> TurnedCourse:
    """The heading of a robot that turns by directions, each of which acts late."""
    times = np.arange(0, drive_s, GRID_S)
    heading = 0.3
    headings = []
    for acts in sent.at(times - late_s):
        headings.append(heading)
        sine = (acts * np.exp(-1j * heading)).imag  # of the angle towards the direction
        heading += A_RAD_S * GRID_S * sine
    return TurnedCourse(times, np.array(headings))


def check(turned: list[TurnedCourse], sent: SentDirections, least: float = 0.0) -> None:
    readings = [image("p.csv", "c.csv", sent), *other_readings("c.csv", sent, 1 / 30)]
    check_directions("p.csv", turned, sent, DELAYS_S, readings, least)


@pytest.mark.parametrize(
    ("clock_s", "says"),
    [
        (1.2, "robots turn 1.2 s before the times"),
        (-3.4, "robots turn 3.4 s after the times"),
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
    readings = other_readings("c.csv", REGULAR, 1 / 30)
    with pytest.raises(UsageError, match=r"robots turn 1\.1 s before the times"):
        check_directions("p.csv", turned, REGULAR, AT_ONCE_S, readings)


def test_a_mirror_image_that_no_dead_time_explains_is_refused():
    mirrored = replace(RANDOM, angles=-RANDOM.angles)
    with pytest.raises(UsageError, match=r"p\.csv: robots turn right where c\.csv turns left"):
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
    with pytest.raises(UsageError, match=r"c.csv: robots turn by its directions if .* degrees"):
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


# ---- Is one clock fast? ----

LONG_S = 60
SENT_LONG = SentDirections(
    np.arange(0, LONG_S, 1.5), np.random.default_rng(4).uniform(-3, 3, round(LONG_S / 1.5))
)


def long_course(sent=SENT_LONG, late_s=0.1):
    """The heading of a robot that turns by directions for a minute."""
    return course_by(sent, late_s, drive_s=LONG_S)


@pytest.mark.parametrize(
    ("rate", "says"),
    [(1.01, "about (0.9|1.0|1.1)% fast"), (0.99, "about (0.9|1.0|1.1)% slow")],
)
def test_a_clock_that_is_fast_is_refused(rate, says):
    """Regression: of one 1 % fast, a misfit, and a lag of wheels was asked for."""
    stated = replace(SENT_LONG, times=SENT_LONG.times * rate)
    with pytest.raises(UsageError, match=r"c\.csv: after .* s robots follow") as error:
        check_clock_rate("c.csv", [long_course()], stated)
    assert re.search(f"is the clock of the commands {says}", str(error.value))


ALTERNATING_LONG = replace(SENT_LONG, angles=np.tile([1.2, -1.2], 20))
SELDOM = SentDirections(SENT_LONG.times[::10], SENT_LONG.angles[::10])
ONE_CLOCK = {
    "as it is": (long_course(), SENT_LONG),
    "1.4 s late": (long_course(late_s=1.4), SENT_LONG),
    "a clock 0.1 % fast": (long_course(), replace(SENT_LONG, times=SENT_LONG.times * 1.001)),
    "alternating": (long_course(ALTERNATING_LONG), ALTERNATING_LONG),
    "four directions": (long_course(SELDOM), SELDOM),
    "a quarter lost": (long_course(a_quarter_lost(SENT_LONG)), SENT_LONG),
    "of another robot": (long_course(ALTERNATING_LONG), SENT_LONG),
}


@pytest.mark.parametrize("name", ONE_CLOCK)
def test_directions_by_one_clock_are_accepted(name):
    course, sent = ONE_CLOCK[name]
    check_clock_rate("c.csv", [course], sent)


def test_directions_of_another_robot_explain_few_turns():
    """Regression: an a of 1.50 (1.30 to 1.74) for 4, exit code 0."""
    of_another = sent_every_1_5_s(np.random.default_rng(8).uniform(-3, 3, 16))
    with pytest.raises(UsageError, match=r"p\.csv: the commands explain 1?\d% of the turns"):
        check([course_by(RANDOM)], of_another, least=0.2)


ROBOTS_ANGLES = {
    "one at 0.3": [0.3, 0, 0],
    "one at 0.5": [0.5, 0, 0],
    "one at 1.0": [1.0, 0, 0],
    "one a quarter turn off": [math.pi / 2, 0, 0],
    "all at 0.2": [0.2, 0.2, 0.2],
    "all at 1.0": [1.0, 1.0, 1.0],
    "to both sides": [1.4, -1.4, 1.4],
}


def rotated_by(sent, angle):
    return replace(sent, angles=sent.angles + angle)


@pytest.mark.parametrize("late_s", [0.1, 1.4])
@pytest.mark.parametrize("sent", [RANDOM, EVEN_AT_FIRST, REGULAR], ids=["random", "even", "four"])
@pytest.mark.parametrize("name", ROBOTS_ANGLES)
def test_heading_biases_are_no_quarter_turn(name, sent, late_s):
    turned = [course_by(rotated_by(sent, angle), late_s) for angle in ROBOTS_ANGLES[name]]
    check_rotation("p.csv", "c.csv", turned, sent)


ROTATED = {
    "a quarter turn": (RANDOM, math.pi / 2, "90 degrees to the left .* add 1.571 rad to"),
    "to the right": (RANDOM, -math.pi / 2, "90 degrees to the right .* take 1.571 rad off"),
    "by more": (RANDOM, 3 * math.pi / 4, "135 degrees to the left"),
    "half a turn": (RANDOM, math.pi - 0.01, "180 degrees to the left"),
    "a step of a cycle": (REGULAR, -math.pi / 2, "90 degrees to the right"),
    "two steps of a cycle": (REGULAR, math.pi - 0.01, "180 degrees to the left"),
}


@pytest.mark.parametrize("name", ROTATED)
def test_directions_a_quarter_turn_off_or_more_are_refused(name):
    """Regression: a heading bias of -1.570 of each robot without a word, or an a of 1.8 for 4."""
    sent, angle, says = ROTATED[name]
    turned = [course_by(rotated_by(sent, angle + off), 0.1) for off in (0.0, 0.1, -0.1)]
    with pytest.raises(UsageError, match=f"(?s)robots turn to directions {says}"):
        check_rotation("p.csv", "c.csv", turned, sent)
