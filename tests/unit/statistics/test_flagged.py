"""Tests of flagging robots that turn on their own in one trial of a batch, but not in others."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from testkit.batches import batch, experiment, group

from tetractl.core.plan import Outcome
from tetractl.log.read.trial_log import Origin
from tetractl.statistics.as_json import batch_items
from tetractl.statistics.describe import contrast
from tetractl.statistics.flagged import flagged, turning_remarks, unconfirmed_heading_remarks
from tetractl.statistics.tables import summary, texts_by_label
from tetractl.tools.table.terminal_table import print_tables

WHEELS_TURN_RAD_S = np.array([0.03, -0.17, 0.11])  # of green, blue and red
ERROR_RAD_S = 0.014  # as of 15 s at 180 mm/s before a camera of 120 Hz


def emulated_trials(n, spread=0.005, seed=1, false_turns=None):
    """Trials of the emulated lab, of robots whose wheels differ.

    `spread` is the standard deviation of how a robot turns from trial to trial [rad/s].
    `false_turns` says by how much more the three robots turn in those trials [rad/s].
    """
    rng = np.random.default_rng(seed)
    spec = experiment(3, wheels={"radius": 40})
    trials = []
    for k, trial in enumerate(batch([[1.0, 2.0, 3.0]] * n, spec)):
        turn = WHEELS_TURN_RAD_S + rng.normal(0.0, spread, 3)
        if false_turns and k in false_turns:
            turn += false_turns[k]
        trial = with_verdict(trial, turn=tuple(turn.tolist()), turn_std=(ERROR_RAD_S,) * 3)
        trials.append(replace(trial, origin=Origin.EMULATED, digest=trial.log))
    return trials


def with_verdict(trial, **fields):
    verdict = replace(trial.result.verdict, **fields)
    return replace(trial, result=replace(trial.result, verdict=verdict))


def printed_summary(described):
    out = io.StringIO()
    shown_tables = summary(contrast([described]))
    print_tables(shown_tables, Console(file=out, width=100))
    return out.getvalue()


def turning_by(*rates):
    """A trial of the emulated lab in which three robots turned by themselves at these rates."""
    (trial,) = emulated_trials(1)
    return with_verdict(trial, turn=rates, turn_std=(0.02,) * 3)


def test_a_robot_that_turns_by_itself_has_no_confirmed_heading():
    """Regression: a pose that turned slowly while its robot drove passed without a word."""
    trial = turning_by(0.03, -0.1, 0.0)
    (text,) = unconfirmed_heading_remarks([trial])[trial.log]
    assert text.startswith(
        "the measured heading of blue may be wrong: blue turned by -0.10 rad/s without a command"
    )
    setup = trial.experiment.setup
    drove_mm = setup.speed[1] * setup.metres * 1000 * trial.result.duration_s
    assert text.endswith(f"by up to {0.1 * trial.result.duration_s * drove_mm / 2:.0f} mm")


def test_headings_of_robots_that_do_not_turn_are_confirmed():
    assert not unconfirmed_heading_remarks([turning_by(0.03, -0.03, 0.0)] * 3)


def test_robots_with_enough_trials_are_compared_instead():
    """Wheels that differ turn a robot in each of its trials."""
    trials = emulated_trials(8)
    assert unconfirmed_heading_remarks(trials[:3])
    assert not unconfirmed_heading_remarks(trials)
    assert not turning_remarks(trials)


FALSE_TURNS = {3: [0.1, 0.0, 0.0], 7: [0.0, 0.0, 0.2], 9: [0.0, -0.15, 0.0]}


def test_a_trial_in_which_a_robot_turns_unlike_in_the_others_is_marked():
    trials = emulated_trials(20, false_turns=FALSE_TURNS)
    marks = turning_remarks(trials)
    assert sorted(marks) == ["trial-003.mcap", "trial-007.mcap", "trial-009.mcap"]
    (of_trial_3,) = marks["trial-003.mcap"]
    assert of_trial_3.startswith("green ")
    (of_trial_7,) = marks["trial-007.mcap"]
    assert of_trial_7.startswith("red ")
    (of_trial_9,) = marks["trial-009.mcap"]
    assert of_trial_9.startswith("blue ")
    assert [trial.log for trial in flagged(group(trials).batch)] == sorted(marks)


def test_the_summary_says_which_trials_are_marked_and_why():
    text = printed_summary(group(emulated_trials(20, false_turns=FALSE_TURNS)))
    assert len(text.splitlines()) <= 12
    (line,) = re.findall("less certain: .*", text)
    assert line.startswith(
        "less certain: 3 of 20 trials, because wheels changed or poses are false: "
    )
    assert re.search(r"green in trial-003, \+0\.\d\d rad/s; blue in trial-009, -0\.1", line)
    assert (
        "trial-007: red turned at a rate that differs by +0.20 rad/s from its other trials" in text
    )


@pytest.mark.parametrize("n", [6, 10, 20])
@pytest.mark.parametrize("spread", [0.0, 0.005, 0.03])
def test_honest_batches_are_hardly_ever_marked(n, spread):
    """In 3 % of small batches and 1 % of others one is marked by chance: at most 2 of 60."""
    batches = [emulated_trials(n, spread, seed) for seed in range(60)]
    marked = [trials for trials in batches if turning_remarks(trials)]
    assert len(marked) <= 2


def test_a_batch_without_marks_says_in_full_which_turns_would_be_seen():
    described = group(emulated_trials(20))
    text = texts_by_label(described)["less certain"]
    assert text == "0 of 20 trials (a change of a turning rate by over 0.05 rad/s would be noticed)"
    assert batch_items(described)["less_certain"] == 0
    assert "less certain" not in printed_summary(described)


def test_a_simulation_has_no_such_figures():
    described = group(batch([[1.0, 2.0, 3.0]] * 6))
    assert "less certain" not in texts_by_label(described)
    trial_items = batch_items(described)["trials"][0]
    assert not [key for key in trial_items if key.startswith("turn")]


def test_few_trials_are_not_compared_and_nothing_is_said_of_them():
    """Regression: a marker that may turn unnoticed was said of every small batch of a lab."""
    few = group(emulated_trials(5, false_turns={3: [0.3, 0.0, 0.0]}))
    assert "less certain" not in texts_by_label(few)
    assert batch_items(few)["less_certain"] is None
    assert "less certain" not in printed_summary(few)


def test_a_marked_trial_counts():
    """One trial cannot show which of the two it was: wheels that changed, or a false pose."""
    described = group(emulated_trials(20, false_turns=FALSE_TURNS))
    assert batch_items(described)["less_certain"] == 3
    assert described.counted == 20


def test_one_that_was_stopped_for_another_reason_is_marked_too():
    trials = emulated_trials(8, false_turns={2: [0.2, 0.0, 0.0]})
    aborted = {"outcome": Outcome.ABORTED, "reason": "green and red are too close"}
    trials[2] = replace(trials[2], result=replace(trials[2].result, **aborted))
    (flag,) = flagged(group(trials).batch)
    assert flag.notes[:2] == ("excluded", "green and red are too close")
    assert flag.notes[2].startswith("green turned at a rate that differs by +0.2")


def test_robots_that_did_not_drive_and_older_logs_are_not_marked():
    trials = emulated_trials(9, false_turns={1: [9.0, 0.0, 0.0]})
    trials[1] = with_verdict(trials[1], turn_std=(np.inf, ERROR_RAD_S, ERROR_RAD_S))
    trials[2] = with_verdict(trials[2], turn=(), turn_std=())
    assert turning_remarks(trials) == {}
    usual, green_stood, older = batch_items(group(trials))["trials"][:3]
    assert usual["turn_blue_rad_s"] == trials[0].result.verdict.turn[1]
    assert usual["turn_std_blue_rad_s"] == ERROR_RAD_S
    assert green_stood["turn_green_rad_s"] is None
    assert older["turn_blue_rad_s"] is None


def test_a_batch_of_older_logs_does_not_mention_turns():
    trials = emulated_trials(9)
    older = [with_verdict(trial, turn=(), turn_std=()) for trial in trials]
    assert "less certain" not in texts_by_label(group(older))
