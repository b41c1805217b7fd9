"""Tests of replay: which keys change the shown time, and what a frame shows at this time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.hand_clock import HandClock
from testkit.trials import in_lab, three_robots

from tetractl.core.errors import UsageError
from tetractl.core.poses import Poses
from tetractl.core.trial import Note
from tetractl.view.player import (
    Playback,
    Player,
    Recording,
    find_end_ns,
    find_first_positions,
    span,
)

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
    return player.now_ns / SECOND


def test_dot_goes_through_the_control_steps_one_by_one_and_pauses(recording, wall):
    player = player_of(recording, wall)
    steps = len(recording.step_ns)
    for k in range(1, steps):
        player.press(".")
        assert player.state in (Playback.PAUSED, Playback.ENDED)
        step = recording.moment_at(player.now_ns).step
        assert step.k == k
    player.press(".")
    assert player.now_ns == recording.end_ns


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
    assert player.now_ns == 3 * SECOND
    assert player.state == Playback.PAUSED
    assert recording.moment_at(player.now_ns).events[-1].text.startswith("blue is lost")
    for _ in range(2):  # the second press finds no later event
        player.press("e")
        assert player.now_ns == 5 * SECOND
        assert player.state == Playback.PAUSED
        assert recording.moment_at(player.now_ns).events[-1].text.startswith("red is tracked again")


def test_capital_e_goes_to_the_event_before(recording, wall):
    player = player_of(recording_with_events(recording), wall)
    player.press("e")
    player.press("e")
    assert player.now_ns == 5 * SECOND
    player.press("E")
    assert player.now_ns == 3 * SECOND
    for _ in range(2):  # the second press finds no earlier event
        player.press("E")
        assert player.now_ns == 0


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
    assert player.now_ns == recording.end_ns
    player.update()
    assert player.state is Playback.ENDED
    player.press("space")
    assert player.state is Playback.PLAYING
    assert player.now_ns == 2 * SECOND


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
    frame = recording.moment_at(just_before_step_5)
    assert frame.step is log.steps[4]
    assert len(frame.totals) == 5
    assert len(frame.trail) == np.count_nonzero(log.mocap_ns <= just_before_step_5)
    assert frame.result is None
    assert recording.moment_at(5 * PERIOD).step is log.steps[5]
    assert recording.moment_at(recording.end_ns).result is log.result


def test_the_end_shows_the_poses_and_errors_of_the_result(recording):
    log = recording.log
    before = recording.moment_at(recording.end_ns - 1)
    assert before.pose_kind == "measured"
    end = recording.moment_at(recording.end_ns)
    assert end.pose_kind == "true"
    assert np.array_equal(end.poses, log.result.verdict.final.array())
    assert end.distances.sum() == pytest.approx(log.result.total_error)
    assert not np.allclose(before.distances, end.distances)


# ---- When a trial ends for its viewers ----


def test_a_simulation_ends_with_its_stop_and_not_with_its_last_frame():
    log = three_robots()
    assert find_end_ns(log) == log.stop.sent_ns < log.mocap_ns[-1]
    last_ns = log.steps[-1].command.sent_ns
    early = replace(log, stop=replace(log.stop, sent_ns=5))
    assert find_end_ns(early) == last_ns


def test_without_a_stop_the_result_or_else_the_last_frame_says_when_a_trial_ended():
    log = replace(three_robots(), stop=None)
    longer = replace(log, result=replace(log.result, duration_s=9.5))
    assert find_end_ns(longer) == round(9.5 * SECOND)
    assert find_end_ns(replace(longer, result=None)) == log.mocap_ns[-1]
    no_frames = replace(log, result=None, mocap_ns=log.mocap_ns[:0])
    assert find_end_ns(no_frames) == log.steps[-1].command.sent_ns
    assert find_end_ns(replace(no_frames, steps=())) == 0


@pytest.mark.parametrize("back", [1, 5, 20])
def test_a_lab_ends_with_the_last_frame_that_shows_its_final_poses(back):
    """Cells swim on."""
    log = in_lab(three_robots())
    poses = Poses.from_array(log.mocap[-back])
    verdict = replace(log.result.verdict, final=poses)
    ended = replace(log, result=replace(log.result, verdict=verdict))
    assert find_end_ns(ended) == log.mocap_ns[-back]
    mocap = log.mocap.copy()
    mocap[-back:] = mocap[-back]  # robots that stand still
    assert find_end_ns(replace(ended, mocap=mocap)) == log.mocap_ns[-1]


def test_frames_before_the_last_command_are_never_the_end_of_a_lab():
    log = in_lab(three_robots())
    early = Poses.from_array(log.mocap[10])
    verdict = replace(log.result.verdict, final=early)
    ended = replace(log, result=replace(log.result, verdict=verdict))
    assert find_end_ns(ended) >= log.steps[-1].command.sent_ns


def test_a_robot_that_is_not_tracked_keeps_its_last_pose_and_before_that_its_start():
    log = three_robots()
    valid = log.valid.copy()
    valid[:5, 1] = False
    valid[40:60, 2] = False
    recording = Recording(replace(log, valid=valid))
    start = log.start.setup.starts.array()[1]
    assert recording.moment_at(int(log.mocap_ns[4])).poses[1].tolist() == start.tolist()
    assert recording.moment_at(int(log.mocap_ns[5])).poses[1].tolist() == log.mocap[5, 1].tolist()
    assert recording.moment_at(int(log.mocap_ns[59])).poses[2].tolist() == log.mocap[39, 2].tolist()
    assert recording.moment_at(int(log.mocap_ns[60])).poses[2].tolist() == log.mocap[60, 2].tolist()
    assert recording.moment_at(int(log.mocap_ns[59])).poses[0].tolist() == log.mocap[59, 0].tolist()


def test_where_a_robot_was_first_seen_is_its_start_if_it_never_was():
    trail = np.full((3, 3, 2), np.nan)
    trail[0, 0] = (1, 2)
    trail[1:, 0] = (3, 4)
    trail[2, 1] = (5, 6)
    starts = np.array([[10.0, 10], [20, 20], [30, 30]])
    assert find_first_positions(trail, starts).tolist() == [[1, 2], [5, 6], [30, 30]]
    assert find_first_positions(trail[:0], starts).tolist() == starts.tolist()


def test_arrows_seek_by_a_second_and_home_and_end_go_to_the_ends(recording, wall):
    player = player_of(recording, wall, start=2, until=6, paused=True)
    for key, at_s in (("right", 3), ("right", 4), ("left", 3), ("left", 2), ("left", 2)):
        player.press(key)
        assert player.now_ns == at_s * SECOND
    player.press("end")
    assert (player.now_ns, player.state) == (6 * SECOND, Playback.ENDED)
    player.press("home")
    assert (player.now_ns, player.state) == (2 * SECOND, Playback.PAUSED)


def test_a_player_shows_time_at_its_rate_from_where_it_is(recording, wall):
    player = player_of(recording, wall, start=1, rate=2.0)
    assert shown_after(player, wall, 0.5) == 2
    player.press("-")
    assert shown_after(player, wall, 1) == 3
    player.press("space")
    assert shown_after(player, wall, 9) == 3
    player.press("space")
    assert shown_after(player, wall, 1) == 4


def test_a_loop_begins_again_at_its_end(recording, wall):
    player = player_of(recording, wall, start=1, until=3, loop=True)
    assert shown_after(player, wall, 1.9) == 2.9
    assert shown_after(player, wall, 0.1) == 1
    assert player.state is Playback.PLAYING


@pytest.mark.parametrize(
    ("start", "until", "message"),
    [
        (-0.1, None, "lies before the log, which begins with the first command, at 0"),
        (float("nan"), None, "lies before the log"),
        (8.3, None, "lies after the end of the trial, which lasts 8.2 s"),
        (3.0, 3.0, "must lie before --until 3"),
        (3.0, 2.0, "must lie before --until 2"),
        (3.0, float("nan"), "must lie before --until nan"),
    ],
)
def test_an_empty_span_is_refused(recording, start, until, message):
    with pytest.raises(UsageError, match=message):
        span(recording, start, until)


def test_a_span_ends_at_the_end_of_the_trial_at_the_latest(recording):
    assert span(recording, 0.0, None) == (0, recording.end_ns)
    assert span(recording, 0.0, 99.0) == (0, recording.end_ns)
    assert span(recording, 8.2, None) == (recording.end_ns, recording.end_ns)
    assert span(recording, 1.0, 2.5) == (SECOND, 2.5 * SECOND)
