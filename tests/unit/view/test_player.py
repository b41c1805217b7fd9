"""Tests of replay: which keys change the shown time, and what a frame shows at this time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.hand_clock import HandClock
from testkit.trials import three_robots

from tetractl.core.trial import Note
from tetractl.view.player import Playback, Player, Recording, span

pytestmark = pytest.mark.slow

SECOND = 1_000_000_000
PERIOD = SECOND // 5
KEYS = ["space", "left", "right", ",", ".", "e", "E", "home", "end", "+", "-", "x"]


@pytest.fixture
def wall():
    return wall_clock()


def wall_clock():
    """The clock on the wall, which did not begin with the recording."""
    clock = HandClock()
    clock.advance(7)
    return clock


@pytest.fixture
def recording():
    return Recording(three_robots())


def player_of(recording, wall, start=0.0, until=None, **options):
    """A player of the time from `start` to `until` [s]."""
    return Player(recording, wall, span(recording, start, until), **options)


def shown_after(player, wall, seconds):
    """The time shown [s] once so many seconds have passed."""
    wall.advance(seconds)
    player.update()
    return player.now / SECOND


def test_dot_goes_through_the_control_steps_one_by_one_and_pauses(recording, wall):
    player = player_of(recording, wall)
    steps = len(recording.step_ns)
    for k in range(1, steps):
        player.press(".")
        assert player.state in (Playback.PAUSED, Playback.ENDED)
        step = recording.at(player.now).step
        assert step.k == k
    player.press(".")
    assert player.now == recording.end_ns


def recording_with_events(recording):
    """Two events at 3 s and one at 5 s, after the one at the start."""
    notes = (
        recording.log.notes[0],
        Note(3 * SECOND, "warning", "red is lost"),
        Note(3 * SECOND, "warning", "blue is lost"),
        Note(5 * SECOND, "info", "red is tracked again"),
    )
    return Recording(replace(recording.log, notes=notes))


def test_e_goes_to_the_next_event_and_pauses(recording, wall):
    recording = recording_with_events(recording)
    player = player_of(recording, wall)
    player.press("e")
    assert player.now == 3 * SECOND
    assert player.state == Playback.PAUSED
    assert recording.at(player.now).events[-1].text.startswith("blue is lost")
    for _ in range(2):  # the second press finds no later event
        player.press("e")
        assert player.now == 5 * SECOND
        assert player.state == Playback.PAUSED
        assert recording.at(player.now).events[-1].text.startswith("red is tracked again")


def test_capital_e_goes_to_the_event_before(recording, wall):
    player = player_of(recording_with_events(recording), wall)
    player.press("e")
    player.press("e")
    assert player.now == 5 * SECOND
    player.press("E")
    assert player.now == 3 * SECOND
    for _ in range(2):  # the second press finds no earlier event
        player.press("E")
        assert player.now == 0


@pytest.mark.parametrize("rate", [0.001, 1.0, 1000.0])
def test_the_rate_has_limits_but_keeps_what_was_asked_for(recording, wall, rate):
    player = player_of(recording, wall, rate=rate)
    for _ in range(30):
        player.press("+")
    assert player.rate == max(64.0, rate)
    for _ in range(30):
        player.press("-")
    assert player.rate == 1 / 16


def test_it_ends_at_the_end_and_space_plays_again(recording, wall):
    player = player_of(recording, wall, start=2)
    wall.advance(100)
    assert player.now == recording.end_ns
    player.update()
    assert player.state is Playback.ENDED
    player.press("space")
    assert player.state is Playback.PLAYING
    assert player.now == 2 * SECOND


def test_q_quits(recording, wall):
    player = player_of(recording, wall)
    player.press("q")
    assert player.state is Playback.QUIT


press = st.tuples(st.sampled_from(KEYS), st.floats(0, 3))  # and the seconds until the next


@given(st.lists(press, max_size=40), st.booleans())
def test_no_keys_ever_leave_the_span(presses, loop):
    wall = wall_clock()
    player = player_of(Recording(three_robots()), wall, start=1, until=6, loop=loop)
    for key, seconds in presses:
        player.press(key)
        assert 1 <= shown_after(player, wall, seconds) <= 6


def test_a_frame_shows_what_was_in_force_and_seen(recording):
    log = recording.log
    just_before_step_5 = 5 * PERIOD - 1
    frame = recording.at(just_before_step_5)
    assert frame.step is log.steps[4]
    assert len(frame.totals) == 5
    assert len(frame.trail) == np.count_nonzero(log.mocap_ns <= just_before_step_5)
    assert frame.result is None
    assert recording.at(5 * PERIOD).step is log.steps[5]
    assert recording.at(recording.end_ns).result is log.result


def test_the_end_shows_the_poses_and_errors_of_the_result(recording):
    log = recording.log
    before = recording.at(recording.end_ns - 1)
    assert before.known == "measured"
    end = recording.at(recording.end_ns)
    assert end.known == "true"
    assert np.array_equal(end.poses, log.result.verdict.final.array())
    assert end.distances.sum() == pytest.approx(log.result.total_error)
    assert not np.allclose(before.distances, end.distances)
