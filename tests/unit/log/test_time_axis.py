"""Tests that displayed times count from the first direction, while stamps stay unchanged."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.random_trials import trial, write_and_read
from testkit.trials import three_robots

from tetractl.core.trial import Note
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import step_gaps
from tetractl.log.write.writer import LogWriter

PLACING_NS = 20_000_000_000


def later(log, by_ns=PLACING_NS):
    """The same trial, with a clock that started while the robots were still being placed."""

    def sent_later(command):
        return replace(command, sent_ns=command.sent_ns + by_ns)

    commands = tuple(sent_later(command) for command in log.commands)
    steps = tuple(replace(step, command=sent_later(step.command)) for step in log.steps)
    return replace(log, commands=commands, steps=steps, mocap_ns=log.mocap_ns + by_ns)


def test_the_axis_starts_with_the_first_direction():
    log = three_robots()
    assert log.began_ns == 0
    placed = later(log)
    assert placed.began_ns == PLACING_NS
    assert placed.elapsed_s(0) == -20
    assert placed.steps[0].command.sent_ns == PLACING_NS  # the raw stamp
    assert [gap.since_s for gap in step_gaps(replace(placed, steps=placed.steps[::2]))][:2] == [
        pytest.approx(0.0),
        pytest.approx(0.4),
    ]


def test_a_stop_is_no_direction_and_no_direction_leaves_the_clock_as_it_is():
    log = later(three_robots())
    stops = tuple(command for command in log.commands if command.direction is None)
    assert stops
    assert replace(log, commands=stops, steps=()).began_ns == 0
    stopped_first = replace(stops[0], sent_ns=5)
    assert replace(log, commands=(stopped_first, *log.commands)).began_ns == PLACING_NS
    lost_first = replace(log, steps=log.steps[7:], commands=log.commands[7:])
    assert lost_first.began_ns == PLACING_NS


def test_notes_come_back_as_they_were(tmp_path):
    random_trial = trial(steps=3, simulated=False)
    notes = (Note(100_000_001, "warning", "robot 1 turns the wrong way"), Note(7, "error", "ü"))
    path = tmp_path / "trial.mcap"
    with LogWriter(path) as writer:
        writer.on_start(random_trial.start)
        random_trial.give_rounds(writer)
        for note in notes:
            writer.on_note(note)
        writer.on_stop(random_trial.stop, random_trial.result)
    log = read_trial(path)
    assert [note for note in log.notes if note in notes] == list(notes)
    assert log.notes[0] == Note(0, "info", "trial 0 of made-up starts")
    ended = "sequence completed (no signal left) after 3 control steps"
    assert log.notes[-1] == Note(random_trial.stop.sent_ns, "info", ended)


def test_undelivered_commands_and_lost_robots_are_notes(tmp_path):
    random_trial = trial(steps=4, simulated=False)
    texts = [note.text for note in write_and_read(random_trial, tmp_path / "trial.mcap").notes]
    lost = sum(np.count_nonzero(~np.array(step.command.delivered)) for step in random_trial.steps)
    assert sum("did not get the command" in text for text in texts) == lost > 0
    assert any(text.endswith("is lost") for text in texts)
    events = [event.text for event in read_trial(tmp_path / "trial.mcap").events]
    assert any("is lost: the camera sends no poses of this robot; check" in text for text in events)
