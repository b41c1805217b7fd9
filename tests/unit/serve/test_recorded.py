from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support import random_trials as made

from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.replay.player import RATE_MAX, Playback, Player, Recording
from tetractl.serve import live
from tetractl.serve.foxglove_protocol import Request
from tetractl.serve.live import ServedReplay

MS = 1_000_000


class Server:
    """Keeps what is sent since the last jump, in which time, and the states reported."""

    def __init__(self, name, span_ns, asked):
        self.span_ns, self.asked = span_ns, asked
        self.jumps, self.sent, self.told = [], [], []

    def jump(self, time_ns, entries):
        self.jumps.append(time_ns)
        self.sent = []
        self.publish(entries)

    def publish(self, entries):
        self.sent += entries

    def announce(self, state):
        self.told.append(state)


class Wall:
    time = 0

    def now(self):
        return self.time

    def sleep_until(self, when):
        raise AssertionError("`follow` never waits")


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
