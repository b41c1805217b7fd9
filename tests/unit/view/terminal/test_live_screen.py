"""Tests of what an operator sees during trials: the live view, bars, and lines of progress."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from testkit.hand_clock import HandTimer
from testkit.terminal import console as terminal
from testkit.trials import run_three_robots, three_robots

from tetractl.core.clock import SECOND
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.protocols import Observer
from tetractl.core.trial import Note, PlantInfo
from tetractl.run.batch import Ending
from tetractl.run.task import Task
from tetractl.view.terminal.keys import STOP_HINT
from tetractl.view.terminal.live_screen import LabView, LiveView
from tetractl.view.terminal.progress import BatchProgress, StudyProgress, format_duration

pytestmark = pytest.mark.slow


class Wall(HandTimer, Observer):
    """A wall clock that the test moves on; as an observer of a trial, by 0.2 s a control step."""

    def on_step(self, step):
        self.now_s += 0.2


def plain(width=40):
    """A console that is no terminal."""
    return Console(file=io.StringIO(), force_terminal=False, width=width)


def written(console):
    """The text that a console wrote to its file, of text or of bytes."""
    file = console.file
    if isinstance(file, io.StringIO):
        return file.getvalue()
    return file.buffer.getvalue().decode()


def pictures(console):
    """What each picture showed: they begin at the home position."""
    texts = written(console).split("\x1b[H")[1:]
    return [without_codes(text) for text in texts]


def without_codes(text):
    """The text without what sets colours and moves the cursor."""
    return re.sub(r"\x1b\[[0-9;?]*[a-z]", "", text, flags=re.I)


def ended(trial, count, result, left_s=None):
    """How a trial ended: with a result, or without one as its camera was missing."""
    failure = None
    if result is None or result.outcome is Outcome.ABORTED:
        failure = "no camera" if result is None else f"aborted: {result.reason}"
    return Ending(Task(trial, count, b"", "arm"), result, failure, left_s)


@pytest.mark.long
def test_the_live_view_shows_trial_numbers_and_how_it_ended(tmp_path):
    console = terminal()
    wall = Wall()
    result = three_robots().result
    with LiveView(console, wall=wall) as view:
        view.trial_started(Task(2, 20, b""))
        run_three_robots(tmp_path, observers=[wall, view])
        view.trial_ended(ended(2, 20, result))
        view.trial_started(Task(3, 20, b""))
        view.on_start(three_robots().start)
    seen_pictures = pictures(console)
    assert "trial 3 of 20" in seen_pictures[1]
    assert any("ended: sequence completed" in picture for picture in seen_pictures)
    last = seen_pictures[-1]
    assert "trial 4 of 20" in last
    assert "left" in last
    assert f"mean total error {result.total_error:.1f} mm" in last
    assert "step k      none yet" in last


def test_the_live_view_counts_from_the_first_direction_and_shows_notes():
    log = three_robots()
    console = terminal()
    wall = Wall()
    first, second = (
        replace(step, command=replace(step.command, sent_ns=sent_s * SECOND))
        for step, sent_s in zip(log.steps, (20, 21), strict=False)
    )
    while_placed = replace(first.observation, sampled_ns=19 * SECOND)
    with LiveView(console, wall=wall) as view:
        view.on_start(log.start)
        wall.now_s = 1.0  # each later call comes when the next picture is due
        view.on_samples([Sample(while_placed, None)])
        wall.now_s = 2.0
        view.on_step(first)
        wall.now_s = 3.0
        view.on_step(second)
        wall.now_s = 4.0
        view.on_note(Note(20_500_000_000, "warning", "red turns the wrong way"))
    seen_pictures = pictures(console)
    times = re.findall(r"time +([0-9.]+) s", "\n".join(seen_pictures))
    assert times[0] == "0.0"
    assert times[-1] == "1.0"
    assert set(times) == {"0.0", "1.0"}
    assert "    0.5 s  warning: red turns the wrong way" in seen_pictures[-1]


def test_the_live_view_gives_the_terminal_back_whatever_happens():
    console = terminal()
    with pytest.raises(RuntimeError), LiveView(console) as view:
        view.on_start(three_robots().start)
        raise RuntimeError
    text = written(console)
    assert text.rindex("\x1b[?1049l") > text.rindex("\x1b[?1049h")
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")


@pytest.mark.parametrize(
    ("facts", "hint", "other_hint"),
    [({"real": "actuator"}, STOP_HINT, "Ctrl-C stops"), ({}, "Ctrl-C stops", STOP_HINT)],
)
def test_the_live_view_names_the_emergency_key_where_a_device_is_real(facts, hint, other_hint):
    """Regression: with one real device in an emulated lab it only named Ctrl-C, which lets the
    robots finish the step, as for a lab that is emulated as a whole."""
    console = terminal()
    info = PlantInfo("emulated", False, 100.0, facts)
    with LabView(console, Console(quiet=True), "mm", live=True) as watch:
        watch.on_start(replace(three_robots().start, plant=info))
    picture = pictures(console)[-1]
    assert hint in picture
    assert other_hint not in picture


def test_the_lab_prints_messages_but_no_calls_of_an_exception():
    """Regression: with --quiet, too, up to 20 lines of calls stood above the error."""
    always = plain(80)
    watch = LabView(always, Console(quiet=True), "mm", live=False)
    watch.on_start(three_robots().start)
    for level, text in (("warning", "low battery"), ("debug", "a.py:7 in plan: 1 / 0")):
        watch.on_note(Note(SECOND, level, text))
    assert written(always) == "warning: low battery\n"


def test_without_a_terminal_progress_is_one_plain_line_a_trial():
    console = plain()
    result = three_robots().result
    aborted = replace(result, outcome=Outcome.ABORTED, reason="no [new] frame for 500 ms")
    with BatchProgress(console, total=2) as progress:
        progress.trial_ended(ended(0, 2, result))
        progress.trial_ended(ended(1, 2, aborted))
    end = f"total error {result.total_error:.1f} mm, {result.steps} steps, 8.2 s"
    assert written(console).splitlines() == [
        f"trial 1 of 2: sequence completed, {end}",
        f"trial 2 of 2: aborted (no [new] frame for 500 ms), {end}",
    ]


def test_on_a_terminal_progress_is_a_bar_with_the_errors_so_far():
    console = terminal(100)
    result = three_robots().result
    entered = replace(result.verdict, entered=(True, False, False))
    with BatchProgress(console, total=3) as progress:
        progress.trial_ended(ended(0, 3, result, 100.0))
        second = replace(result, total_error=600.0, verdict=entered)
        progress.trial_ended(ended(1, 3, second, 65.0))
    text = without_codes(written(console))
    assert "2/3" in text
    mean = (result.total_error + 600) / 2
    assert f"1 min 5 s left, mean total error {mean:.1f} mm, 1 entered an obstacle" in text
    assert "steps" not in text


def study_progress(console, quiet=False):
    """What 20 trials print, of which the fifth has no outcome and the sixth is aborted."""
    result = three_robots().result
    aborted = replace(result, outcome=Outcome.ABORTED, reason="no frame")
    with StudyProgress(console, 20, quiet) as progress:
        for i in range(20):
            outcome = {4: None, 5: aborted}.get(i, result)
            progress.trial_ended(ended(i, 20, outcome, 19.0 - i))
    return written(console).splitlines()


FAILURES = ["failed: arm/4: no camera", "failed: arm/5: aborted: no frame"]


def test_a_study_prints_failures_the_expected_duration_and_each_tenth():
    lines = study_progress(plain())
    assert [line for line in lines if line.startswith("failed")] == FAILURES
    assert [line for line in lines if "expected" in line] == [
        "expected duration 17 s, estimated from the first 3 trials"
    ]
    tenths = [f"{2 * i} of 20 trials, {20 - 2 * i} s left" for i in range(1, 11)]
    assert [line for line in lines if "of 20" in line] == tenths
    quiet = plain()
    assert study_progress(quiet, quiet=True) == FAILURES


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(-1, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")],
)
def test_durations_read_as_people_say_them(seconds, words):
    assert format_duration(seconds) == words


def test_a_plain_view_names_who_entered_an_obstacle_and_no_steps():
    console = terminal(100, 40)
    start = three_robots().start
    left, bottom = start.setup.obstacles[0].box[:2]
    with LiveView(console, steered_by_hand=True) as view:
        view.on_start(start)
        poses = start.setup.starts.array().copy()
        poses[1, :2] = left + 1, bottom + 1
        poses[2, :2] = start.setup.arena.left - 1, bottom
        observation = Observation(0, 0, 0, Poses.from_array(poses), np.ones(3, dtype=bool))
        view.on_samples([Sample(observation, None)])
        view.show_text("words", "Any key ends")
    last = pictures(console)[-1]
    assert "blue entered an obstacle: lost" in last
    assert "red is outside: lost, 1 mm left" in last
    assert "green is" not in last
    assert "step k" not in last
    assert "Any key ends" in last
