"""Which directions robots turn by, where several explain their turning."""

import numpy as np
import pytest

from tetractl.core.errors import UsageError
from tetractl.replay.identification.sent_directions import (
    GRID_S,
    SentDirections,
    TurnedCourse,
    check_side,
)

A_RAD_S = 4.0
DRIVE_S = 24
SENT_S = np.arange(0, DRIVE_S, 1.5)


def sent_every_1_5_s(directions):
    """Directions [rad], each of which acts until the next."""
    return SentDirections(SENT_S, np.exp(1j * directions))


ALTERNATING = sent_every_1_5_s(np.tile([1.2, -1.2], 8))
TURNING = sent_every_1_5_s(1.7 * np.arange(16))


def course_by(sent: SentDirections, late_s: float = 0.0) -> TurnedCourse:
    """The heading of a robot that turns by directions, each of which acts late."""
    times = np.arange(0, DRIVE_S, GRID_S)
    heading = 0.3
    headings = []
    for acts in sent.at(times - late_s):
        headings.append(heading)
        sine = (acts * np.exp(-1j * heading)).imag  # of the angle towards the direction
        heading += A_RAD_S * GRID_S * sine
    return TurnedCourse(times, np.array(headings))


def test_directions_that_act_a_step_late_are_not_taken_for_their_mirror_image():
    """The mirror image of alternating directions is they themselves, a step of 1.5 s later."""
    check_side("p.csv", "c.csv", [course_by(ALTERNATING, late_s=1.5)], ALTERNATING)


def test_directions_by_which_robots_turn_are_accepted():
    check_side("p.csv", "c.csv", [course_by(TURNING)], TURNING)


def test_a_mirror_image_that_no_dead_time_explains_is_refused():
    image = SentDirections(TURNING.times, TURNING.acts.conj())
    with pytest.raises(UsageError, match=r"p\.csv: robots turn right where c\.csv turns left"):
        check_side("p.csv", "c.csv", [course_by(image)], TURNING)
