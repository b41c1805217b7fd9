from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trials import cut_short, three_robots

from tetractl.core.commands import Note
from tetractl.core.errors import UsageError
from tetractl.core.poses import Poses
from tetractl.replay.player import Playback, Player, Recording, span

pytestmark = pytest.mark.slow

SECOND = 1_000_000_000
PERIOD = SECOND // 5
KEYS = ["space", "left", "right", ",", ".", "e", "E", "home", "end", "+", "-", "x"]


class FakeWall:
    def __init__(self):
        self.time = 7 * SECOND

    def now(self):
        return self.time

    def sleep_until(self, when):
        self.time = max(self.time, when)

    def pass_by(self, seconds):
        self.time += round(seconds * SECOND)


@pytest.fixture
def wall():
    return FakeWall()


@pytest.fixture
def recording():
    return Recording(three_robots())


def player(recording, wall, **options):
    limits = span(recording, options.pop("start", 0.0), options.pop("until", None))
    return Player(recording, wall, limits, **options)


def after(p, wall, seconds):
    wall.pass_by(seconds)
    p.update()
    return p.now / SECOND


def test_a_change_of_rate_never_leaps(recording, wall):
    p = player(recording, wall, start=1, rate=2)
    assert after(p, wall, 1) == 3
    p.press("-")
    assert p.now == 3 * SECOND
    assert after(p, wall, 1) == 4


def test_dot_goes_through_the_control_steps_one_by_one_and_pauses(recording, wall):
    p = player(recording, wall)
    seen = []
    for _ in range(len(recording.step_ns) - 1):
        p.press(".")
        assert p.state in (Playback.PAUSED, Playback.ENDED)
        step = recording.at(p.now).step
        assert step is not None
        seen.append(step.k)
    assert seen == list(range(1, len(recording.step_ns)))
    p.press(".")
    assert p.now == recording.end_ns


def test_e_goes_to_the_next_event_and_capital_e_to_the_one_before(recording, wall):
    notes = (
        *recording.log.notes[:1],
        Note(3 * SECOND, "warning", "red is lost"),
        Note(3 * SECOND, "warning", "blue is lost"),
        Note(5 * SECOND, "info", "red is tracked again"),
    )
    recording = Recording(replace(recording.log, notes=notes))
    p = player(recording, wall)
    for seconds, newest in ((3, "blue is lost"), (5, "red is tracked again"), (5, "red is")):
        p.press("e")
        assert (p.now, p.state) == (seconds * SECOND, Playback.PAUSED)
        assert recording.at(p.now).events[-1].text.startswith(newest)
    for seconds in (3, 0, 0):
        p.press("E")
        assert p.now == seconds * SECOND
    assert [event.text for event in recording.at(3 * SECOND - 1).events] == [notes[0].text]


def test_what_came_before_the_first_direction_has_negative_times(recording, wall):
    log = recording.log
    steps = tuple(
        replace(one, command=replace(one.command, sent_ns=one.command.sent_ns + SECOND))
        for one in log.steps
    )
    recording = Recording(replace(log, commands=(), steps=steps))
    p = player(recording, wall, until=3)
    assert (p.now, p.until_ns) == (SECOND, 4 * SECOND)
    assert recording.at(p.now).time_s == 0
    early = player(recording, wall, start=-1)
    assert (early.now, recording.at(early.now).time_s) == (0, -1)
    with pytest.raises(UsageError, match="--start -2 lies before the log, which begins at -1"):
        span(recording, -2, None)


@pytest.mark.parametrize("rate", [0.001, 1.0, 1000.0])
def test_the_rate_has_limits_but_keeps_what_was_asked_for(recording, wall, rate):
    p = player(recording, wall, rate=rate)
    for _ in range(30):
        p.press("+")
    assert p.rate == max(64.0, rate)
    for _ in range(30):
        p.press("-")
    assert p.rate == 1 / 16


def test_it_pauses_at_the_end_and_space_plays_again(recording, wall):
    p = player(recording, wall, start=2)
    wall.pass_by(100)
    assert p.now == recording.end_ns
    p.update()
    assert p.state is Playback.ENDED
    p.press("space")
    assert (p.state, p.now) == (Playback.PLAYING, 2 * SECOND)
    p.press("q")
    assert p.state is Playback.QUIT


def test_until_and_loop(recording, wall):
    p = player(recording, wall, start=1, until=3, loop=True)
    assert after(p, wall, 1.5) == 2.5
    assert after(p, wall, 0.5) == 1
    assert p.state is Playback.PLAYING
    assert after(p, wall, 1) == 2


@given(st.lists(st.tuples(st.sampled_from(KEYS), st.floats(0, 3)), max_size=40), st.booleans())
def test_no_keys_ever_leave_the_span(presses, loop):
    wall, recording = FakeWall(), Recording(three_robots())
    p = player(recording, wall, start=1, until=6, loop=loop)
    for key, seconds in presses:
        p.press(key)
        after(p, wall, seconds)
        assert SECOND <= p.now <= 6 * SECOND


def test_a_frame_shows_what_was_in_force_and_seen(recording):
    log = recording.log
    frame = recording.at(5 * PERIOD - 1)
    assert frame.step is log.steps[4]
    assert len(frame.totals) == 5
    assert len(frame.trail) == np.searchsorted(log.mocap_ns, 5 * PERIOD - 1, side="right")
    assert recording.at(5 * PERIOD).step is log.steps[5]
    assert frame.result is None
    assert recording.at(recording.end_ns).result is log.result


def test_the_end_shows_the_poses_and_errors_of_the_result(recording):
    log = recording.log
    end, before = recording.at(recording.end_ns), recording.at(recording.end_ns - 1)
    assert np.array_equal(end.poses, log.result.verdict.final.array())
    assert end.distances.sum() == pytest.approx(log.result.total_error)
    assert (before.known, end.known) == ("measured", "true")
    assert not np.allclose(before.distances, end.distances)


def test_a_trial_of_cells_that_swim_on_ends_where_its_result_was_taken():
    log, swam = three_robots(), 20  # frames after the result
    mocap = np.concatenate([log.mocap, log.mocap[-1] + 9.0 * np.arange(1, swam + 1)[:, None, None]])
    frames = np.append(log.mocap_ns, log.mocap_ns[-1] + np.arange(1, swam + 1) * 10**7)
    final = replace(log.result, verdict=replace(log.result.verdict, final=Poses.of(log.mocap[-1])))
    start = replace(log.start, plant=replace(log.start.plant, simulated=False))
    valid = np.ones(mocap.shape[:2], dtype=bool)
    more = {"mocap_ns": frames, "mocap": mocap, "valid": valid, "result": final, "start": start}
    recording = Recording(replace(log, **more))
    assert recording.end_ns == log.mocap_ns[-1]
    assert recording.at(recording.end_ns).known == "measured"


def test_an_untracked_robot_keeps_its_last_pose():
    log = three_robots()
    valid = log.valid.copy()
    valid[50:55, 1] = False
    frame = Recording(replace(log, valid=valid)).at(int(log.mocap_ns[52]))
    assert np.isnan(frame.trail[-1, 1]).all()
    assert (frame.poses[1] == log.mocap[49, 1]).all()
    assert (frame.poses[0] == log.mocap[52, 0]).all()


def test_a_log_without_anything_still_shows_the_start():
    recording = Recording(cut_short(three_robots(), 0))
    frame = recording.at(0)
    assert (recording.end_ns, frame.step) == (0, None)
    assert frame.poses[:, :2].tolist() == [[900, 800], [900, 1200], [900, 1600]]
