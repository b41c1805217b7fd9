"""Tests of how late messages are, by stamps of a clock that may differ from ours."""

from hypothesis import given
from hypothesis import strategies as st

from tetractl.lab.cameras.stamp_clock import STAMPS_MAX, StampClock


@given(st.integers(-(10**15), 10**15), st.lists(st.integers(0, 10**9), min_size=1, max_size=50))
def test_a_message_is_late_by_what_it_took_longer_than_the_fastest(offset_ns, taken_ns):
    clock = StampClock()
    for k, taken in enumerate(taken_ns):
        stamp_ns = 1000 * k
        fastest_ns = min(taken_ns[: k + 1])
        assert (
            clock.measure_lateness_ns(stamp_ns, stamp_ns + offset_ns + taken) == taken - fastest_ns
        )
        assert clock.shortest_gap_ns == offset_ns + fastest_ns


def test_before_the_first_message_nothing_is_known():
    assert StampClock().shortest_gap_ns is None


def test_a_message_is_forgotten_after_so_many_others():
    clock = StampClock()
    clock.measure_lateness_ns(0, 5)
    for _ in range(STAMPS_MAX - 1):
        assert clock.measure_lateness_ns(0, 8) == 3
    assert clock.measure_lateness_ns(0, 8) == 0
    assert clock.shortest_gap_ns == 8
