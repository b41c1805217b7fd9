"""Tests of the timeline: events occur in order, after the world has advanced to their time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_emulator.loop import Loop, Timeline

from tetractl.core.clock import SECOND
from tetractl.tools.worker import POLL_S

planned_times = st.lists(st.integers(0, 100), max_size=30)


@given(planned_times, st.integers(0, 120))
def test_events_happen_in_order_at_their_times(times, until):
    moved = []
    happened = []
    timeline = Timeline(moved.append)
    for number, when in enumerate(times):
        timeline.at(when, lambda n=number: happened.append((timeline.now_ns, n)))
    timeline.run_to(until)
    due = [(when, number) for number, when in enumerate(times) if when <= until]
    assert happened == sorted(due)  # those of one time in the order they were planned
    assert timeline.now_ns == until
    assert moved == sorted(set(moved))
    assert (moved or [0])[-1] == until


def test_lateness_is_noted():
    late = []
    timeline = Timeline(lambda t: None)
    loop = Loop(timeline, late.append)
    timeline.at(1, loop.end)  # long ago on the host's clock
    loop.run()
    assert late == [loop.worst_lag_ns]
    assert late[0] > 0


class Selecting:
    """Stands for the module `select`; it keeps how long the loop would wait [s]."""

    def __init__(self):
        self.waits_s = []

    def select(self, readers, writers, failed, wait_s):
        self.waits_s.append(wait_s)
        return [], [], []


def test_a_loop_waits_for_its_next_event_but_never_longer_than_a_poll(monkeypatch):
    selecting = Selecting()
    monkeypatch.setattr("tetractl_emulator.loop.select", selecting)
    timeline = Timeline(lambda t: None)
    loop = Loop(timeline, lambda lag_ns: None)
    monkeypatch.setattr(loop, "now", lambda: 1000 * SECOND)
    loop.turn()
    timeline.at(1000 * SECOND + SECOND // 1000, lambda: None)
    loop.turn()
    assert selecting.waits_s == [POLL_S, pytest.approx(0.001)]
    assert POLL_S > 0.001
    far = Timeline(lambda t: None)
    far.at(2000 * SECOND, lambda: None)
    waiting = Loop(far, lambda lag_ns: None)
    monkeypatch.setattr(waiting, "now", lambda: 1000 * SECOND)
    waiting.turn()
    assert selecting.waits_s[-1] == POLL_S


@pytest.mark.parametrize(("lag_ms", "noted"), [(5, []), (6, [6_000_000])])
def test_only_a_delay_above_5_ms_is_reported_and_the_worst_is_kept(monkeypatch, lag_ms, noted):
    monkeypatch.setattr("tetractl_emulator.loop.select", Selecting())
    late = []
    timeline = Timeline(lambda t: None)
    loop = Loop(timeline, late.append)
    now_ns = [SECOND]
    monkeypatch.setattr(loop, "now", lambda: now_ns[0])
    timeline.at(SECOND - lag_ms * 1_000_000, lambda: None)
    timeline.at(SECOND + 2_000_000, lambda: None)
    loop.turn()
    assert late == noted
    assert loop.worst_lag_ns == lag_ms * 1_000_000
    now_ns[0] = SECOND + 3_000_000
    loop.turn()
    assert loop.worst_lag_ns == lag_ms * 1_000_000
