from hypothesis import given
from hypothesis import strategies as st

from tetractl.lab.cameras.optitrack.stream import SECOND, ClockSync

MS = 1_000_000


@given(
    hz=st.sampled_from([1_000_000, 2_441_406, 10_000_000]),
    offset_s=st.integers(0, 10**6),
    delays=st.lists(st.tuples(st.integers(0, 3 * MS), st.integers(0, 3 * MS)), min_size=1),
    exposure=st.integers(0, 10 * SECOND),
)
def test_the_error_is_at_most_half_the_round_trip_it_tells(hz, offset_s, delays, exposure):
    sync = ClockSync(hz)

    def ticks(host_ns):
        return (host_ns + offset_s * SECOND) * hz // SECOND

    for i, (there, back) in enumerate(delays):
        sent = i * 10 * MS
        sync.add(sent, sent + there + back, ticks(sent + there))
    found = sync.to_host(ticks(exposure))
    assert abs(found - exposure) <= sync.round_trip_ns / 2 + 2 * SECOND / hz + 2


def test_a_drift_is_found_and_undone():
    sync = ClockSync(10_000_000)
    drift = 50e-6

    def ticks(host_ns):
        return round((host_ns * (1 + drift) + SECOND) / 100)

    for i in range(120):
        sent = i * SECOND // 2
        sync.add(sent, sent + 200_000 + i % 7 * 50_000, ticks(sent + 100_000))
    assert abs(sync.drift - drift) < 5e-6
    later = 65 * SECOND
    assert abs(sync.to_host(ticks(later)) - later) < 200_000


def test_without_echoes_it_is_not_synced_and_nonsense_is_ignored():
    sync = ClockSync(1_000_000)
    sync.add(1000, 0, 5)
    sync.add(0, 2 * SECOND, 5)
    assert not sync.synced
