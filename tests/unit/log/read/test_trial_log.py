"""Tests of a log's messages for users, and of the times of its parts."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import three_robots

from tetractl.core.trial import Note

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("green is lost", "is it hidden"),
        ("the model does not fit: heading of green", "`tetractl identify` measures"),
        ("the model fits again: with the same values", ""),
        ("green stands still although it is sent a direction", ""),
        ("lost packets", ""),
    ],
)
def test_only_messages_that_need_it_say_what_to_do(text, advice):
    log = three_robots()
    (event,) = replace(log, notes=(Note(log.began_ns + 2_500_000_000, "warning", text),)).events
    assert event.text.startswith(text)
    assert advice in event.text
    assert (event.text == text) == (advice == "")
    assert (event.time_s, event.level) == (pytest.approx(2.5), "warning")


def test_messages_come_in_the_order_of_their_times():
    log = three_robots()
    notes = tuple(Note(log.began_ns + second * 10**9, "info", str(second)) for second in (3, -1, 2))
    assert [event.text for event in replace(log, notes=notes).events] == ["-1", "2", "3"]


def test_times_count_from_the_first_direction():
    log = three_robots()
    assert log.steps_s[0] == pytest.approx(0.0, abs=0.5)
    assert np.diff(log.steps_s) == pytest.approx(
        np.diff([step.command.sent_ns for step in log.steps]) / 1e9
    )
    assert (log.frames_s * 1e9 + log.began_ns) == pytest.approx(log.mocap_ns)


def test_a_robot_that_was_not_tracked_has_no_measured_position():
    log = three_robots()
    valid = log.valid.copy()
    valid[3, 1] = False
    positions = replace(log, valid=valid).positions
    assert np.isnan(positions[3, 1]).all()
    assert positions[3, 0] == pytest.approx(log.mocap[3, 0, :2])
