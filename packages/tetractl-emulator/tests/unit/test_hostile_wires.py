"""Whatever a camera server may send, and whatever stands in a script."""

import pytest
from support import wire_targets
from support.bounded_work import withstands
from support.wire_targets import TARGETS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", TARGETS)
def test_anything_may_come(name):
    withstands(TARGETS[name])


def test_good_conversations_come_through():
    """Else mutants of them would be refused at the door."""
    fed = []
    before = wire_targets.stream
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wire_targets, "stream", lambda: fed.append(before()) or fed[-1])
        for seed in wire_targets.datagrams():
            wire_targets.natnet_datagrams(seed)
    whole = [stream for stream in fed if stream.newest and stream.newest.poses[0]]
    assert len(whole) == len(wire_targets.VERSIONS)
    assert sum(stream.sync is not None and stream.sync.synced for stream in fed) == 4
    assert all(stream.unit_mm == 1000 for stream in whole)
