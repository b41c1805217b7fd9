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

A = 4.0
ALTERNATING = SentDirections(np.arange(0, 24, 1.5), np.exp(1j * np.tile([1.2, -1.2], 8)))


def course_by(sent: SentDirections, late_s: float = 0.0) -> TurnedCourse:
    """The heading of a robot that turns by directions, each of which acts late."""
    times = np.arange(0, 24, GRID_S)
    heading = 0.3
    headings = []
    for acts in sent.at(times - late_s):
        headings.append(heading)
        heading += A * GRID_S * (acts * np.exp(-1j * heading)).imag
    return TurnedCourse(times, np.array(headings))


def test_directions_that_act_a_step_late_are_not_taken_for_their_mirror_image():
    """The mirror image of alternating directions is they themselves, a step of 1.5 s later."""
    check_side("p.csv", "c.csv", [course_by(ALTERNATING, late_s=1.5)], ALTERNATING)


def test_a_mirror_image_that_no_dead_time_explains_is_refused():
    sent = SentDirections(np.arange(0, 24, 1.5), np.exp(1.7j * np.arange(16)))
    check_side("p.csv", "c.csv", [course_by(sent)], sent)
    image = SentDirections(sent.times, sent.acts.conj())
    with pytest.raises(UsageError, match=r"p\.csv: robots turn right where c\.csv turns left"):
        check_side("p.csv", "c.csv", [course_by(image)], sent)
