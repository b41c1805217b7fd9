"""Tests of the lines and the lowest line of a replay, and of the keys that turn to other trials."""

import io
import re
from dataclasses import replace

import pytest
from rich.console import Console
from testkit.hand_clock import HandClock
from testkit.random_trials import SMALL, trial, write_and_read
from testkit.trials import in_lab

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.plan import State
from tetractl.core.trial import Note
from tetractl.view.player import Player, Recording
from tetractl.view.terminal import replay_screen
from tetractl.view.terminal.replay_screen import (
    KEY_HELP,
    KeyHelp,
    create_dashboard,
    format_result,
    format_step,
    play_trials,
    print_lines,
)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of six control steps, one each 0.2 s, without messages."""
    made = trial(steps=6, **SMALL)
    log = write_and_read(made, tmp_path_factory.mktemp("log") / "t.mcap")
    return replace(log, notes=())


@pytest.fixture
def recording(log):
    return Recording(log)


class Wall(HandClock):
    """A wall clock that keeps the times until which somebody waited."""

    def __init__(self):
        super().__init__()
        self.waits = []

    def sleep_until(self, when):
        super().sleep_until(when)
        self.waits.append(when)


def printed(recording, capsys, span=None, **options):
    """The lines that are printed of a recording, and until when each waited since the start."""
    wall = Wall()
    start_ns = 9 * SECOND
    wall.sleep_until(start_ns)
    print_lines(recording, wall, span or (0, recording.end_ns), **options)
    return capsys.readouterr().out.splitlines(), [when - start_ns for when in wall.waits[1:]]


def test_every_step_has_a_line_and_the_result_comes_last(recording, capsys):
    lines, waits = printed(recording, capsys)
    steps = [int(found[1]) for line in lines if (found := re.search(r"  k (\d+) ", line))]
    assert steps == list(range(6))
    assert lines[-1] == format_result(recording)
    assert len(lines) == 7
    assert waits == []  # all at once


def test_events_stand_behind_the_step_of_their_time(recording, capsys):
    at_step_2 = int(recording.step_ns[2])
    notes = (
        Note(at_step_2, "warning", "green is late"),
        Note(at_step_2 - 1, "info", "before"),
    )
    noted = Recording(replace(recording.log, notes=notes))
    lines, _ = printed(noted, capsys)
    number = next(i for i, line in enumerate(lines) if " k 2 " in line)
    assert lines[number - 1].endswith("info: before")
    assert lines[number + 1].endswith("warning: green is late")
    assert lines[number + 1].startswith(f"{recording.log.elapsed_s(at_step_2):6.2f} s")


def test_only_lines_of_the_span_are_printed_with_both_of_its_ends(recording, capsys):
    first, last = int(recording.step_ns[1]), int(recording.step_ns[3])
    lines, _ = printed(recording, capsys, (first, last))
    assert [re.search(r"  k (\d+) ", line)[1] for line in lines] == ["1", "2", "3"]
    lines, _ = printed(recording, capsys, (first + 1, last - 1))
    assert [re.search(r"  k (\d+) ", line)[1] for line in lines] == ["2"]


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_at_a_rate_each_line_waits_for_its_time_from_the_begin_of_the_span(recording, capsys, rate):
    first = int(recording.step_ns[1])
    _, waits = printed(recording, capsys, (first, int(recording.step_ns[4])), rate=rate)
    expected = [(int(ns) - first) / rate for ns in recording.step_ns[1:5]]
    assert waits == pytest.approx(expected, abs=1)


def test_a_loop_plays_again_after_its_span_and_never_without_lines(recording, capsys):
    first, last = int(recording.step_ns[1]), int(recording.step_ns[2])

    class EnoughError(Exception):
        pass

    class Lasting(Wall):
        def sleep_until(self, when):
            super().sleep_until(when)
            if len(self.waits) == 6:
                raise EnoughError

    wall = Lasting()
    with pytest.raises(EnoughError):
        print_lines(recording, wall, (first, last), loop=True)
    length = last - first
    once = [0, length, length]  # two lines, and the end of the span
    assert wall.waits == [*once, *(length + time for time in once)]
    print_lines(recording, wall, (first + 1, first + 2), loop=True)
    assert len(wall.waits) == 6


def test_a_log_without_a_result_has_no_line_of_one(recording, capsys):
    unfinished = Recording(replace(recording.log, result=None))
    lines, _ = printed(unfinished, capsys, (0, unfinished.end_ns + SECOND))
    assert len(lines) == 6


def test_the_result_has_the_true_or_the_measured_error(recording):
    error = recording.log.result.total_error
    assert format_result(recording).endswith(f"final total error {error:.1f} mm true")
    measured = Recording(in_lab(recording.log))
    assert format_result(measured).endswith("mm measured")


def with_step(recording, direction, **fields):
    step = recording.log.steps[1]
    command = replace(step.command, action=Steer(direction))
    changed = replace(step, command=command, plan=replace(step.plan, **fields))
    return Recording(replace(recording.log, steps=(recording.log.steps[0], changed)))


@pytest.mark.parametrize(
    ("direction", "text"), [(0.5, "+28.6"), (-0.5, "-28.6"), (6.0, "-16.2"), (-3.5, "+159.5")]
)
def test_a_direction_is_in_degrees_of_at_most_half_a_turn(recording, direction, text):
    line = format_step(with_step(recording, direction), 1)
    assert f"direction {text} deg".replace(" ", "") in line.replace(" ", "")


def test_only_a_state_other_than_driving_is_named(recording):
    assert State.DRIVING not in format_step(with_step(recording, 0.5), 1)
    assert format_step(with_step(recording, 0.5, state=State.PASSING), 1).endswith("  passing")


# ---- The lowest line and the keys ----


def footer(log, at_s=0.0, index=0, count=1):
    recording = Recording(log)
    since_ns = log.began_ns + round(at_s * SECOND)
    player = Player(recording, HandClock(), (since_ns, recording.end_ns), paused=True)
    return create_dashboard(player, index, count)._footer


def test_the_lowest_line_has_the_time_as_a_fraction_of_the_trial(log):
    end_s = log.elapsed_s(Recording(log).end_ns)
    half = footer(log, end_s / 2)
    assert half.fraction == pytest.approx(0.5)
    assert half.right_text == f"{end_s / 2:3.1f} / {end_s:.1f} s"
    assert half.left_text == "‖ 1×"


@pytest.mark.parametrize(
    ("index", "count", "has_next"), [(0, 1, False), (0, 2, True), (1, 2, False)]
)
def test_the_key_for_the_next_trial_is_shown_only_if_there_is_one(log, index, count, has_next):
    assert ("n next trial" in footer(log, index=index, count=count).hints) == has_next


class Keys:
    """Stands for a keyboard: keys that are pressed one after another."""

    def __init__(self, keys):
        self.keys = list(keys)
        self.interrupted = False

    def __call__(self, **_):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read(self, wait_s):
        return [self.keys.pop(0)]


class Screen:
    """Stands for the screen: it keeps what it was shown."""

    def __init__(self):
        self.shown = []

    def __call__(self, console):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def show(self, what):
        self.shown.append(what)

    def open(self):
        pass

    def close(self):
        pass


def played(monkeypatch, log, keys, count=1, turns=True):
    """The trials that were turned to, and what the screen showed, until q is pressed."""
    recording = Recording(log)
    wall = HandClock()
    turned = []

    def player():
        return Player(recording, wall, (0, recording.end_ns), paused=True)

    def select_trial(index, before):
        turned.append(index)
        return player()

    screen = Screen()
    monkeypatch.setattr(replay_screen, "Keyboard", Keys([*keys, "q"]))
    monkeypatch.setattr(replay_screen, "Screen", screen)
    ended = play_trials(Console(), player(), count, select_trial if turns else None)
    assert ended is False
    return turned, screen.shown


def test_n_and_p_turn_to_other_trials_and_stop_at_both_ends(monkeypatch, log):
    assert played(monkeypatch, log, "nnnpppn", count=3)[0] == [1, 2, 1, 0, 1]
    assert played(monkeypatch, log, "npn")[0] == []
    assert played(monkeypatch, log, "npn", count=3, turns=False)[0] == []


def test_nothing_is_drawn_again_while_nothing_changes(monkeypatch, log):
    shown = played(monkeypatch, log, ["x", "y", "z"])[1]
    assert len(shown) == 1
    assert len(played(monkeypatch, log, [".", "x", ".", "+"])[1]) == 4


def test_a_question_mark_shows_the_keys_until_the_next_key(monkeypatch, log):
    shown = played(monkeypatch, log, ["?", "?", "?", "x"])[1]
    assert [isinstance(what, KeyHelp) for what in shown] == [False, True, False, True, False]


@pytest.mark.parametrize("height", [4, len(KEY_HELP), len(KEY_HELP) + 2, len(KEY_HELP) + 3, 30])
def test_the_list_of_keys_fills_its_space_and_leaves_out_its_title_first(height):
    out = io.StringIO()
    console = Console(file=out, width=90, height=height, force_terminal=False)
    console.print(KeyHelp(), height=height)
    lines = out.getvalue().splitlines()[:height]
    named = [key for key in KEY_HELP if any(line.strip().startswith(key) for line in lines)]
    assert len(named) == min(height, len(KEY_HELP))
    assert any("Keys of the player" in line for line in lines) == (height > len(KEY_HELP) + 2)
