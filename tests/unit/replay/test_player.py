"""Replay: which keys move the time shown, and what a frame at that time shows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.hand_clock import HandClock
from support.trials import cut_short, three_robots

from tetractl.core.errors import UsageError
from tetractl.core.poses import Poses
from tetractl.core.trial import Note
from tetractl.replay.player import Playback, Player, Recording, span

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


def test_a_change_of_rate_never_leaps(recording, wall):
    player = player_of(recording, wall, start=1, rate=2)
    assert shown_after(player, wall, 1) == 3
    player.press("-")  # rate 1
    assert player.now == 3 * SECOND
    assert shown_after(player, wall, 1) == 4


def test_dot_goes_through_the_control_steps_one_by_one_and_pauses(recording, wall):
    player = player_of(recording, wall)
    steps = len(recording.step_ns)
    for k in range(1, steps):
        player.press(".")
        assert player.state in (Playback.PAUSED, Playback.ENDED)
        step = recording.at(player.now).step
        assert step is not None
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


def test_an_event_is_shown_from_its_time_on(recording):
    recording = recording_with_events(recording)
    before = recording.at(3 * SECOND - 1).events
    assert [event.text for event in before] == [recording.log.notes[0].text]


def sent_a_second_later(step):
    later_ns = step.command.sent_ns + SECOND
    return replace(step, command=replace(step.command, sent_ns=later_ns))


def test_what_came_before_the_first_direction_has_negative_times(recording, wall):
    log = recording.log
    steps = tuple(sent_a_second_later(step) for step in log.steps)
    recording = Recording(replace(log, commands=(), steps=steps))
    player = player_of(recording, wall, until=3)
    assert player.now == SECOND
    assert player.until_ns == 4 * SECOND
    assert recording.at(player.now).time_s == 0
    early = player_of(recording, wall, start=-1)
    assert early.now == 0
    assert recording.at(early.now).time_s == -1
    with pytest.raises(UsageError, match="--start -2 lies before the log, which begins at -1"):
        span(recording, -2, None)


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


def test_a_loop_begins_again_at_its_start(recording, wall):
    player = player_of(recording, wall, start=1, until=3, loop=True)
    assert shown_after(player, wall, 1.5) == 2.5
    assert shown_after(player, wall, 0.5) == 1
    assert player.state is Playback.PLAYING
    assert shown_after(player, wall, 1) == 2


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


def lab_log_of_cells_that_swim_on():
    """A log whose result has the poses of the last frame but 20, which follow every 10 ms."""
    log = three_robots()
    verdict = replace(log.result.verdict, final=Poses.of(log.mocap[-1]))
    frames_after = np.arange(1, 21)
    poses_after = log.mocap[-1] + 9.0 * frames_after[:, None, None]
    mocap = np.concatenate([log.mocap, poses_after])
    return replace(
        log,
        start=replace(log.start, plant=replace(log.start.plant, simulated=False)),
        mocap_ns=np.append(log.mocap_ns, log.mocap_ns[-1] + frames_after * 10_000_000),
        mocap=mocap,
        valid=np.ones(mocap.shape[:2], dtype=bool),
        result=replace(log.result, verdict=verdict),
    )


def test_a_trial_of_cells_that_swim_on_ends_where_its_result_was_taken():
    recording = Recording(lab_log_of_cells_that_swim_on())
    assert recording.end_ns == three_robots().mocap_ns[-1]
    assert recording.at(recording.end_ns).known == "measured"


def test_an_untracked_robot_keeps_its_last_pose():
    log = three_robots()
    valid = log.valid.copy()
    valid[50:55, 1] = False
    recording = Recording(replace(log, valid=valid))
    frame = recording.at(int(log.mocap_ns[52]))
    assert np.isnan(frame.trail[-1, 1]).all()
    assert (frame.poses[1] == log.mocap[49, 1]).all()
    assert (frame.poses[0] == log.mocap[52, 0]).all()


def test_a_log_without_anything_still_shows_the_start():
    recording = Recording(cut_short(three_robots(), 0))
    frame = recording.at(0)
    assert recording.end_ns == 0
    assert frame.step is None
    starts = [list(robot.start) for robot in recording.log.experiment.robots]
    assert frame.poses[:, :2].tolist() == starts
