"""Tests of the screen of a replay at any size of the terminal."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from testkit.random_trials import experiment
from testkit.terminal import console as terminal
from testkit.trials import three_robots

from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Outcome, State
from tetractl.core.trial import Note
from tetractl.view.player import Moment, Player, Recording, span
from tetractl.view.terminal.dashboard import Dashboard, Footer, _end_lines, _format_length
from tetractl.view.terminal.replay_screen import create_dashboard, format_step
from tetractl.view.terminal.screen import can_show_screens

pytestmark = pytest.mark.slow


class StillWall:
    """A wall clock that stands: one picture is drawn, and nothing is waited for."""

    def now(self):
        return 0

    def sleep_until(self, when):
        raise AssertionError("nothing waits here")


def screen(recording, width, height, seconds, **options):
    console = terminal(width, height, **options)
    player = Player(recording, StillWall(), span(recording, seconds, None), paused=True)
    picture = create_dashboard(player)
    with console.capture() as captured:
        console.print(picture, height=height, end="")
    return re.sub(r"\x1b\[[0-9;]*m", "", captured.get()).split("\n")


@pytest.fixture
def recording():
    return Recording(three_robots())


@pytest.mark.parametrize(
    ("width", "height"), [(80, 24), (100, 30), (200, 60), (40, 12), (60, 50), (8, 3), (1, 1)]
)
@pytest.mark.parametrize("seconds", [0, 3, 8.2])
def test_it_fills_exactly_the_terminal_it_is_given(recording, width, height, seconds):
    lines = screen(recording, width, height, seconds)
    assert len(lines) == max(height, 2)
    assert {len(text) for text in lines} == {width}


def test_a_low_terminal_leaves_out_effort_first_then_plan_robots_and_total(recording):
    parts = ["step k", "total error", "to target", "plan cost", "solve time"]
    shown = []
    for height in range(24, 5, -1):
        text = "\n".join(screen(recording, 100, height, 3))
        shown.append([part in text for part in parts])
    assert shown[0] == [True] * 5
    for present in shown:
        assert present == sorted(present, reverse=True)  # what goes first is never kept longer
    assert shown[-1].count(True) < 3


@pytest.mark.parametrize("width", range(44, 80, 3))
def test_a_narrow_terminal_marks_where_it_cuts(recording, width):
    """Regression: at 44 columns a cost of 8.7e-06 mm was "8.7e-0"."""

    def numbers(columns):
        lines = screen(recording, columns, 40, 3.05)[:30]
        return [line.rpartition("│")[2].strip() for line in lines if "│" in line]

    whole = [line.rstrip("━─▁▂▃▄▅▆▇█· ") for line in numbers(160)]  # without bars and curves
    for line in numbers(width):
        start = line.rstrip("━─▁▂▃▄▅▆▇█·… ")
        assert any(of_wide.startswith(start) for of_wide in whole)
        assert line.endswith("…") or start in whole


def test_robots_that_stand_are_named(recording):
    log = recording.log
    ones = np.ones(3)
    estimate = Estimate(ones, ones, ones, ones, stands=np.array([0.95, 0, 0]))
    steps = [replace(step, plan=replace(step.plan, estimate=estimate)) for step in log.steps]
    with_green_standing = Recording(replace(log, steps=steps))
    lines = screen(with_green_standing, 80, 24, 3)
    (of_green,) = (line for line in lines if " green " in line)
    assert "stands" in of_green
    assert format_step(with_green_standing, 3).endswith("green: standing")
    assert "stand" not in "".join([*screen(recording, 80, 24, 3), format_step(recording, 3)])


@pytest.mark.parametrize(("state", "says"), [(State.RESTING, True), (State.STUCK, False)])
def test_a_pause_says_that_the_next_plan_is_searched_for(recording, state, says):
    """Regression: a trial of 42 s with seven pauses looked as if it hung."""
    log = recording.log
    paused = [
        replace(
            step,
            plan=replace(step.plan, instead=Stop(), state=state),
            command=replace(step.command, action=Stop()),
        )
        for step in log.steps
    ]
    lines = "\n".join(screen(Recording(replace(log, steps=paused)), 80, 24, 3))
    assert "standing" in lines
    assert ("standing, searching" in lines) == says


def test_a_terminal_shows_pictures_if_it_has_utf8_with_or_without_colour():
    assert can_show_screens(terminal())
    assert can_show_screens(terminal(no_color=True))
    assert not can_show_screens(terminal(encoding="ascii"))


def with_events(recording):
    log = recording.log
    aborted = replace(
        log.result, outcome=Outcome.ABORTED, reason="red is not tracked (0.30 s) for too long now"
    )
    notes = tuple(
        Note(round(t * SECOND), level, text)
        for t, level, text in (
            (1, "warning", "green did not get the command of step 5"),
            (3, "info", "red is tracked again"),
            (3.04, "error", "a cable came off, " + "and it is a very long one " * 5),
        )
    )
    return Recording(replace(log, result=aborted, notes=notes))


def test_events_show_as_they_pass(recording):
    eventful = with_events(recording)
    assert "did not get" not in "\n".join(screen(eventful, 80, 24, 0.9))
    assert screen(eventful, 80, 24, 2)[-2].startswith(
        "    1.0 s  warning: green did not get the command of step 5"
    )
    lines = screen(eventful, 80, 24, 3.05)
    assert lines[-3].startswith("    3.0 s  red is tracked again")
    assert lines[-2].startswith("    3.0 s  error: a cable came off")
    assert lines[-2].endswith("…")
    assert "did not get" in "\n".join(screen(eventful, 80, 40, 3.05))
    assert "evaluations" in "\n".join(lines)  # and the numbers are all there still


@pytest.mark.parametrize("outcome", [Outcome.ARRIVED, Outcome.TIME_LIMIT, Outcome.ABORTED])
@pytest.mark.parametrize("touched", [False, True])
def test_only_what_went_wrong_at_the_end_is_red(outcome, touched):
    result = three_robots().result
    clearance = (-1.0 if touched else 5.0,) * 3
    verdict = replace(result.verdict, entered=(touched,) * 3, clearance=clearance)
    ended = replace(result, outcome=outcome, reason="because of this and of that", verdict=verdict)
    lines = _end_lines(ended, 16)
    assert lines[0].plain == f"ended: {outcome}"
    reason = [line for line in lines if line.plain in ("because of this", "and of that")]
    assert len(reason) == 2
    assert {str(line.style) for line in reason} == {
        "bold red" if outcome is Outcome.ABORTED else ""
    }
    assert (lines[-1].plain == "a robot entered an obstacle") == touched


def of_distances(distances):
    """A moment at which robots are this far from their targets."""
    setup = experiment(len(distances)).setup
    poses = np.zeros((len(distances), 3))
    poses[:, :2] = setup.targets + np.column_stack([distances, np.zeros(len(distances))])
    trail = poses[None, :, :2]
    return Moment(setup, 1.0, None, poses, trail, None, np.zeros(0), 0, None)


@pytest.mark.parametrize("height", [14, 16, 18, 40])
@pytest.mark.parametrize(
    "distances",
    [
        (200.0, 300.0, 400.0, 500.0, 600.0, 700.0),
        (700.0, 600.0, 500.0, 400.0, 300.0, 200.0),
        (200.0, 300.0, 900.0, 400.0, 800.0, 300.0),
    ],
)
def test_robots_for_which_there_is_no_line_are_described_together(distances, height):
    """By their number and the largest distance of these, not of those that are listed."""
    view = Dashboard(of_distances(np.array(distances)), "t", Footer("", 0.5, ""))
    _, *lines = (line.plain for line in view._robots_block(60, height))
    listed = [line for line in lines if "robot " in line]
    for line, distance in zip(listed, distances, strict=False):
        assert f"{distance:.1f}" in line
    others = distances[len(listed) :]
    described = [f"and {len(others)} more, at most {max(others):.0f}"] if others else []
    assert lines[len(listed) :] == described


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1234.5, "1234"),
        (100.0, "100"),
        (99.94, "99.9"),
        (1.0, "1.0"),
        (0.999, "0.999"),
        (0.01234, "0.0123"),
        (0.0, "0"),
        (-250.4, "-250"),
        (-2.54, "-2.5"),
        (math.inf, "inf"),
        (math.nan, "nan"),
    ],
)
def test_a_length_has_three_digits_or_one_decimal(value, text):
    assert _format_length(value) == text
