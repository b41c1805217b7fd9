from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import random_trials as made

from tetractl.core.commands import Command, Note, Steer
from tetractl.log.format import channels
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.replay.player import RATE_MAX, Playback, Player, Recording
from tetractl.serve import live
from tetractl.serve.foxglove_protocol import Request
from tetractl.serve.live import ServedReplay, ServedRun

MS = 1_000_000


class Server:
    """Keeps what is sent since the last jump, the times of jumps, and the states reported."""

    def __init__(self, name="", span_ns=None, asked=None, watched=True):
        self.asked, self.watched = asked, watched
        self.jumps, self.sent, self.told = [], [], []

    def jump(self, time_ns, entries):
        self.jumps.append(time_ns)
        self.sent = [*entries]

    def messages(self, entries):
        self.sent += entries

    def attachment(self, *attached):
        pass

    def flush(self):
        pass

    def announce(self, state):
        self.told.append(state)


class Wall:
    """A clock that only notes until when somebody wanted to sleep."""

    def __init__(self):
        self.time, self.slept = 1000, []

    def now(self):
        return self.time

    def sleep_until(self, when):
        self.slept.append(when)


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    return scan(made.write(made.trial(5, steps=5), tmp_path_factory.mktemp("log") / "t.mcap"))


@pytest.fixture
def play(contents, monkeypatch):
    monkeypatch.setattr(live, "Viewers", Server)

    def opened(**options):
        wall = Wall()
        recording = Recording(trial_of(contents))
        player = Player(recording, wall, (recording.began_ns, recording.end_ns), **options)
        served = ServedReplay(contents, player)
        return SimpleNamespace(
            wall=wall,
            player=player,
            served=served,
            server=served.viewers,
            start_ns=contents.run.start_unix_ns,
        )

    return opened


def newest(contents, until_ns):
    """The newest message of each topic at a time, by topic."""
    past = [entry for entry in contents.entries if entry.log_ns <= until_ns]
    return {entry.topic: entry for entry in sorted(past, key=lambda entry: entry.log_ns)}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.floats(0.01, 100), st.none() | st.integers(-99, 1200))))
def test_what_was_sent_is_always_all_up_to_the_time_shown(contents, play, requests):
    shown = play(loop=True)
    shown.served.follow()
    for playing, rate, seek_ms in requests:
        seek_ns = None if seek_ms is None else shown.start_ns + seek_ms * MS
        before = shown.player.now
        answer = shown.server.asked(Request(playing, rate, seek_ns))
        assert answer.sought is (seek_ns is not None)
        assert shown.player.now == before  # it is obeyed by `follow`, in the player's thread
        shown.wall.time += 37 * MS
        shown.served.follow()
        assert shown.wall.slept == []
        jumped_ns, now_ns = shown.server.jumps[-1], shown.start_ns + shown.player.now
        since = [one for one in contents.entries if jumped_ns < one.log_ns <= now_ns]
        expected = [*newest(contents, jumped_ns).values(), *since]
        assert sorted(shown.server.sent) == sorted(expected)
        assert shown.player.rate == min(max(rate, 1 / 16), RATE_MAX)
        assert shown.server.told[-1].rate == shown.player.rate
        assert shown.server.told[-1].playback is shown.player.state


def test_states_are_told_when_they_change(play):
    shown = play()
    for _ in range(3):
        shown.served.follow()
    assert [state.playback for state in shown.server.told] == [Playback.PLAYING]
    shown.player.press("space")
    shown.served.follow()
    shown.player.press("+")
    shown.served.follow()
    shown.wall.time += 3600 * 1000 * MS
    shown.player.press("space")
    shown.wall.time += 3600 * 1000 * MS
    shown.served.follow()
    told = [(state.playback, state.rate, state.sought) for state in shown.server.told]
    assert told[1:] == [
        (Playback.PAUSED, 1.0, False),
        (Playback.PAUSED, 2.0, False),
        (Playback.ENDED, 2.0, False),
    ]


def run(trial, server, wall):
    observer = ServedRun(server, wall)
    observer.on_start(trial.start)
    trial.give_rounds(observer)
    observer.on_command(Command(Steer(0.5), 7, (True,) * 3))
    observer.on_note(Note(8, "info", "a note"))
    observer.on_stop(trial.stop, trial.result)
    return server


def test_every_message_of_the_log_is_sent(tmp_path):
    for simulated in (True, False):
        trial = made.trial(3, steps=4, simulated=simulated)
        sent = run(trial, Server(), Wall()).sent
        logged = scan(made.write(trial, tmp_path / f"{simulated}.mcap")).entries
        frames = {"/frames", "/tf"}  # each by itself, in the log those of a chunk together
        of_file = {channels.HOST, channels.HOST_END, channels.DIGESTS}
        logged = [entry for entry in logged if entry.topic not in frames | of_file]
        extra = [one for one in sent if one.topic not in frames and one not in logged]
        assert [entry.topic for entry in extra] == ["/commands", "/log"]
        assert [entry for entry in sent if entry in logged] == logged
        for topic in frames:
            assert [entry.topic for entry in sent].count(topic) == len(trial.samples)


def test_a_simulation_is_slowed_to_the_wall_and_the_lab_is_not():
    trial = made.trial(3, steps=2)
    wall = Wall()
    run(trial, Server(), wall)
    assert wall.slept == [1000 + one.observation.received_ns for one in trial.samples]
    wall = Wall()
    run(made.trial(3, steps=2, simulated=False), Server(), wall)
    assert wall.slept == []


def test_while_nobody_looks_only_the_newest_poses_are_encoded():
    trial = made.trial(3, steps=4)
    sent = run(trial, Server(watched=False), Wall()).sent
    times = [entry.publish_ns for entry in sent if entry.topic == "/frames"]
    start = trial.start.start_unix_ns
    assert times == [start + samples[-1].observation.sampled_ns for samples, _ in trial.rounds]
    assert [entry.topic for entry in sent].count("/controller/step") == 4
