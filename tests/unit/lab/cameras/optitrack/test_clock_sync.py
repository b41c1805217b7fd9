"""Tests of relating the server's clock to the host's clock, with a fake server."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack.stream import ClockSync

HZ = 10_000_000
MS = SECOND // 1000


class Server:
    """A server whose clock showed `offset_s` at 0 and gains `drift` [s/s]."""

    def __init__(self, offset_s=50.0, drift=0.0):
        self.offset_s = offset_s
        self.drift = drift

    def ticks(self, host_ns):
        return round((self.offset_s + host_ns / SECOND * (1 + self.drift)) * HZ)


def synced(server, sync, times_s, there_ms=1, back_ms=1):
    """Exchange times at these moments [s]; a message takes so long there and back [ms]."""
    for second in times_s:
        sent_ns = round(second * SECOND)
        at_ns = sent_ns + there_ms * MS
        sync.add(sent_ns, at_ns + back_ms * MS, server.ticks(at_ns))
    return sync


@given(st.floats(0, 1e6), st.floats(-5e-4, 5e-4), st.integers(0, 30), st.integers(0, 30))
def test_a_time_of_the_server_becomes_the_hosts_within_the_error(offset_s, drift, there, back):
    server = Server(offset_s, drift)
    sync = synced(server, ClockSync(HZ), range(10), there, back)
    assert sync.is_synced
    assert sync.fault == ""
    assert sync.round_trip_ns == (there + back) * MS
    for seconds in (8.0, 9.0, 9.5, 12.0):
        host_ns = round(seconds * SECOND)
        off_ns = abs(sync.to_host(server.ticks(host_ns)) - host_ns)
        assert off_ns <= sync.error_ns(host_ns)
    drifted_ns = 2 * 1_000_000 * 9  # by twice the largest drift, 1 ms/s, since the first echo
    assert sync.error_ns(9 * SECOND) <= (there + back) * MS // 2 + drifted_ns + 1000


@pytest.mark.parametrize(("jump_s", "verb"), [(0.25, "gained 250.0 ms"), (-0.25, "lost 250.0 ms")])
def test_a_clock_that_was_set_is_said_to_have_gained_or_lost(jump_s, verb):
    server = Server()
    sync = synced(server, ClockSync(HZ), range(5))
    assert sync.fault == ""
    server.offset_s += jump_s
    synced(server, sync, [5])
    assert f"the camera server's clock {verb} on this computer's clock within 1.00 s" in sync.fault
    first = sync.fault
    synced(server, sync, [6, 7])
    assert sync.fault == first


def test_the_quickest_of_the_newest_echoes_counts():
    server = Server()
    sync = synced(server, ClockSync(HZ), [0.0], 5, 5)
    synced(server, sync, [1.0], 400, 0)
    assert sync.round_trip_ns == 10 * MS
    assert sync.to_host(server.ticks(2 * SECOND)) == pytest.approx(2 * SECOND, abs=MS)


@pytest.mark.parametrize(("sent_ns", "returned_ns"), [(0, SECOND + 1), (2 * SECOND, SECOND)])
def test_an_echo_that_took_over_a_second_or_less_than_nothing_is_ignored(sent_ns, returned_ns):
    sync = ClockSync(HZ)
    sync.add(sent_ns, returned_ns, 12345)
    assert not sync.is_synced
    sync.add(0, SECOND, 12345)
    assert sync.is_synced
