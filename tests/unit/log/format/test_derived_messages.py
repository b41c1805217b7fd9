"""Tests of the operator messages that follow from other records, and of when there is none."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.random_trials import trial

from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation, Poses
from tetractl.core.trial import Note
from tetractl.log.format.derived_messages import (
    TrackingNotes,
    end_note,
    outcome_from_log,
    outcome_to_log,
    start_note,
    undelivered_notes,
)

NAMES = ("green", "blue", "red")
MADE_UP = trial(steps=2)


def frame(number, valid):
    poses = Poses.from_array(np.zeros((3, 3)))
    return Observation(number, 10 * number, 10 * number + 4, poses, np.array(valid))


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), max_size=8))
def test_each_loss_and_each_return_of_a_robot_is_told_once_at_the_arrival_of_its_frame(rows):
    notes = TrackingNotes(NAMES)
    before = (True,) * 3
    for number, valid in enumerate(rows):
        expected = [
            Note(10 * number + 4, "warning", f"{name} is lost")
            if was
            else Note(10 * number + 4, "info", f"{name} is tracked again")
            for name, was, now in zip(NAMES, before, valid, strict=True)
            if was != now
        ]
        assert notes.add(frame(number, valid)) == expected
        before = valid


def test_the_first_frame_says_nothing_of_robots_that_it_shows():
    assert TrackingNotes(NAMES).add(frame(0, (True, True, True))) == []
    assert [note.text for note in TrackingNotes(NAMES).add(frame(0, (True, False, True)))] == [
        "blue is lost"
    ]


@given(st.tuples(st.booleans(), st.booleans(), st.booleans()))
def test_each_robot_that_did_not_get_a_command_is_named(delivered):
    step = MADE_UP.steps[1]
    command = replace(step.command, delivered=delivered)
    notes = undelivered_notes(NAMES, replace(step, command=command))
    assert notes == [
        Note(command.sent_ns, "warning", f"{name} did not get the command of step 1")
        for name, got in zip(NAMES, delivered, strict=True)
        if not got
    ]


@pytest.mark.parametrize("outcome", Outcome)
def test_only_an_abort_ends_with_an_error(outcome):
    result = replace(MADE_UP.result, outcome=outcome, reason="why")
    note = end_note(MADE_UP.stop, result)
    assert note.t_ns == MADE_UP.stop.sent_ns
    assert note.level == ("error" if outcome is Outcome.ABORTED else "info")
    assert outcome_from_log(note.text) == f"{outcome} (why) after 2 control steps"


def test_a_trial_starts_with_its_number_and_name():
    start = replace(MADE_UP.start, trial=7)
    assert start_note(start) == Note(0, "info", "trial 7 of made-up starts")


@pytest.mark.parametrize("outcome", Outcome)
def test_an_outcome_is_read_by_its_present_name_and_only_one_has_another_in_logs(outcome):
    for text in (outcome.value, f"{outcome} (why) after 3 control steps"):
        logged = outcome_to_log(text)
        assert outcome_from_log(logged) == text
        assert (logged != text) == (outcome is Outcome.NO_BETTER_PLAN)
    inside = f"the controller says: {outcome}"  # only the beginning of a text is an outcome
    assert outcome_to_log(inside) == outcome_from_log(inside) == inside
