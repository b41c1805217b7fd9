"""Tests of the timeline: events occur in order, after the world has advanced to their time."""

from hypothesis import given
from hypothesis import strategies as st
from tetractl_emulator.loop import Loop, Timeline

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
