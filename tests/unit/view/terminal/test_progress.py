"""Tests of what a run, a study, a script and a notebook say of trials that have ended."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from testkit.batches import result
from testkit.hand_clock import HandTimer

from tetractl.core.errors import AbortError
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.run.batch import Ending
from tetractl.run.task import Task
from tetractl.view.terminal.progress import (
    BAR_INTERVAL_S,
    LINE_INTERVAL_S,
    RESULTS_TO_ESTIMATE,
    STUDY_LINES,
    BatchProgress,
    NotebookProgress,
    ResultTally,
    ScriptProgress,
    StudyProgress,
    format_duration,
    format_trial_line,
)

ENTERED = Verdict(Poses.from_array(np.zeros((2, 3))), (False, True), (9.0, -1.0))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (-3, "0 s"),
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min 0 s"),
        (60, "1 min 0 s"),
        (200, "3 min 20 s"),
        (3599, "59 min 59 s"),
        (3600, "1 h 0 min"),
        (7530, "2 h 5 min"),
        (90000, "25 h 0 min"),
    ],
)
def test_a_duration_is_in_its_two_largest_units(seconds, text):
    assert format_duration(seconds) == text


def test_a_tally_is_the_mean_and_what_went_wrong():
    tally = ResultTally()
    assert tally.summary("mm") == ""
    tally.add(result([1.0, 2.0]))
    assert tally.summary("mm") == "mean total error 3.0 mm"
    tally.add(result([4.0, 5.0], verdict=ENTERED))
    tally.add(result([0.0, 0.0], outcome=Outcome.ABORTED))
    assert tally.summary("um") == "mean total error 4.0 um, 1 entered an obstacle, 1 aborted"


def test_the_line_of_a_trial_says_how_it_ended_and_only_an_abort_says_why():
    task = Task(2, 9, b"")
    line = format_trial_line(task, result([1.0, 2.0]), "mm")
    assert line == "trial 3 of 9: sequence completed, total error 3.0 mm, 31 steps, 6.2 s"
    aborted = result([1.0, 2.0], outcome=Outcome.ABORTED, reason="lost", verdict=ENTERED)
    assert format_trial_line(task, aborted, "mm") == (
        "trial 3 of 9: aborted (lost), total error 3.0 mm, 31 steps, 6.2 s, entered an obstacle"
    )


def ending(trial=0, failure=None, left_s=None, arm="", every_arm=True, count=40):
    task = Task(trial, count, b"", arm)
    return Ending(task, None if failure else result([1.0]), failure, left_s, every_arm)


def lines_of(progress_of, endings):
    """What is printed without a terminal, line by line after each trial."""
    out = io.StringIO()
    printed = []
    with progress_of(Console(file=out, width=200)) as progress:
        for one in endings:
            before = len(out.getvalue())
            progress.trial_ended(one)
            printed.append(out.getvalue()[before:].splitlines())
    return printed


def test_without_a_terminal_a_batch_prints_a_line_for_each_trial_that_has_a_result():
    endings = [ending(0), ending(1, failure="no camera"), ending(2)]
    printed = lines_of(lambda console: BatchProgress(console, 3, "um"), endings)
    assert [len(lines) for lines in printed] == [1, 0, 1]
    assert printed[2][0].startswith("trial 3 of 40: sequence completed, total error 1.0 um")


def test_a_study_prints_a_line_after_each_tenth_of_its_trials():
    endings = [ending(k, left_s=float(39 - k)) for k in range(40)]
    printed = lines_of(lambda console: StudyProgress(console, 40), endings)
    at = [k for k, lines in enumerate(printed) if any("of 40 trials" in line for line in lines)]
    assert at == list(range(3, 40, 40 // STUDY_LINES))
    assert printed[3] == ["4 of 40 trials, 36 s left"]


def test_a_study_says_once_how_long_it_will_take_when_it_knows_of_every_arm():
    def expected(endings):
        printed = lines_of(lambda console: StudyProgress(console, 40), endings)
        return [
            (k, line) for k, lines in enumerate(printed) for line in lines if "expected" in line
        ]

    known = [ending(k, left_s=90.0) for k in range(9)]
    first = RESULTS_TO_ESTIMATE - 1
    text = f"expected duration 1 min 30 s, estimated from the first {RESULTS_TO_ESTIMATE} trials"
    assert expected(known) == [(first, text)]
    failed = [ending(0, failure="x", left_s=90.0), *known]
    assert expected(failed) == [(first + 1, text)]
    late = [replace(one, has_time_of_each_arm=k >= 5) for k, one in enumerate(known)]
    assert expected(late) == [(5, text.replace(f"first {RESULTS_TO_ESTIMATE}", "first 6"))]
    nothing_left = [ending(k, left_s=0.0) for k in range(9)]
    assert expected(nothing_left) == []


def test_failures_are_printed_even_if_a_study_is_quiet_and_nothing_else_is():
    endings = [ending(k, left_s=5.0) for k in range(30)]
    endings[4] = ending(4, failure="the camera is off", arm="a=3", left_s=5.0)
    printed = lines_of(lambda console: StudyProgress(console, 30, quiet=True), endings)
    assert [lines for lines in printed if lines] == [["failed: a=3/4: the camera is off"]]


def test_a_script_prints_at_most_every_ten_seconds(capsys):
    clock = HandTimer(50.0)
    progress = ScriptProgress(5, clock)
    printed = []
    for after_s in (LINE_INTERVAL_S - 0.1, 0.1, LINE_INTERVAL_S - 0.1, 0.1):
        clock.now_s += after_s
        progress.trial_ended(ending(left_s=61.0))
        printed.append(capsys.readouterr().err)
    assert printed == ["", "2 of 5 trials; 1 min 1 s left\n", "", "4 of 5 trials; 1 min 1 s left\n"]
    clock.now_s += LINE_INTERVAL_S
    progress.trial_ended(ending())
    assert capsys.readouterr().err == "5 of 5 trials\n"


class Output:
    """Stands for the output of a notebook's cell."""

    def __init__(self):
        self.updates = 0

    def update(self, shown):
        self.updates += 1


def test_a_notebooks_bar_changes_now_and_then_and_at_the_end():
    clock = HandTimer(50.0)
    output = Output()
    progress = NotebookProgress(4, lambda shown, display_id: output, clock)
    updates = []
    for after_s in (BAR_INTERVAL_S / 2, BAR_INTERVAL_S, 0.0, 0.0):
        clock.now_s += after_s
        progress.trial_ended(ending(left_s=8.0))
        updates.append(output.updates)
    assert updates == [0, 1, 1, 2]
    assert repr(progress) == "4 of 4 trials"  # nothing is left


def test_a_notebooks_bar_says_how_many_have_ended_and_what_is_left():
    progress = NotebookProgress(4, lambda shown, display_id: Output(), HandTimer(50.0))
    assert repr(progress) == "0 of 4 trials"
    progress.trial_ended(ending(left_s=8.0))
    assert repr(progress) == "1 of 4 trials; 8 s left"
    html = progress._repr_html_()
    assert html == '<progress value="1" max="4"></progress> 1 of 4 trials; 8 s left'
    progress.trial_ended(ending())
    assert repr(progress) == "2 of 4 trials"


def test_an_error_is_a_failure_without_a_line_of_a_result():
    """As a batch gives it: the error's message, and no result."""
    failed = ending(failure=AbortError("no camera").message)
    (lines,) = lines_of(lambda console: BatchProgress(console, 3), [failed])
    assert lines == []
