"""Tests that no datagram of a camera server and no content of a script can do harm."""

import pytest
from testkit.bounded_work import withstands
from testkit.emulator import wire_targets
from testkit.emulator.wire_targets import TARGETS

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_anything_may_come(name):
    withstands(TARGETS[name])


def test_good_conversations_come_through():
    """Else mutants of them would be refused at the door."""
    new_stream = wire_targets.stream
    streams = []

    def recorded_stream():
        stream = new_stream()
        streams.append(stream)
        return stream

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wire_targets, "stream", recorded_stream)
        for seed in wire_targets.datagrams():
            wire_targets.natnet_datagrams(seed)
    with_poses = [stream for stream in streams if stream.newest and stream.newest.poses[0]]
    assert len(with_poses) == len(wire_targets.VERSIONS)
    assert all(stream.unit_mm == 1000 for stream in with_poses)
    synced = [
        stream
        for stream in streams
        if stream.clock_sync is not None and stream.clock_sync.is_synced
    ]
    assert len(synced) == 4
