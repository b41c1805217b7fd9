import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paths import ROOT

from tetractl.core.errors import LogError
from tetractl.lab.cameras.optitrack.messages import Request
from tetractl.lab.cameras.optitrack.placement import Placement
from tetractl.lab.cameras.optitrack.replay import replay_cameras
from tetractl.lab.cameras.optitrack.stream import FRAME_RATE, Stream
from tetractl.lab.cameras.optitrack.wire import pack
from tetractl.lab.recorder import Passage, WireRecorder
from tetractl.log.format.wire import read_wire
from tetractl.log.read import bounds

passages = st.lists(
    st.builds(
        Passage,
        st.sampled_from(["natnet", "radio"]),
        st.booleans(),
        st.integers(0, 10**12),
        st.binary(max_size=300),
    ),
    max_size=30,
)


@given(passages)
def test_what_passed_comes_back_in_the_order_of_its_times(tmp_path_factory, passed):
    path = tmp_path_factory.mktemp("wire") / "a.wire"
    with WireRecorder(path) as recorder:
        for passage in passed:
            note = recorder.received if passage.received else recorder.sent
            note(passage.wire, passage.t_ns, passage.data)
    assert recorder.error is None
    back = list(read_wire(path))
    assert [p.t_ns for p in back] == sorted(p.t_ns for p in passed)
    assert sorted(map(repr, back)) == sorted(map(repr, passed))


def test_a_file_is_never_overwritten_and_nonsense_is_refused(tmp_path):
    path = tmp_path / "a.wire"
    path.write_text("not a wire")
    with pytest.raises(LogError, match="cannot record the wire"), WireRecorder(path):
        pass
    with pytest.raises(LogError, match="not an MCAP file"):
        list(read_wire(path))
    with pytest.raises(LogError, match="No such file"):
        list(read_wire(tmp_path / "none"))


def test_a_disk_that_refuses_ends_the_recording_not_the_run():

    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("there is no /dev/full here")

    class Full(WireRecorder):
        def __enter__(self):
            self._file = full.open("wb", buffering=0)
            self._thread.start()
            return self

    with Full(full) as recorder:
        for i in range(100_000):
            recorder.received("natnet", i, b"x" * 100)
    assert recorder.error == "No space left on device"


def recorded(path, data=b"x" * 1000):
    with WireRecorder(path) as recorder:
        recorder.received("natnet", 1, data)
    return path


def test_a_bomb_is_not_unpacked(tmp_path):
    """Regression: 16 MB and more were unpacked, whatever a chunk said."""
    path = recorded(tmp_path / "a.wire", bytes(bounds.CHUNK))
    assert path.stat().st_size < 10_000
    tracemalloc.start()
    with pytest.raises(LogError, match="claims to unpack to"):
        list(read_wire(path))
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_damage_is_one_line(tmp_path):
    """Regression: ZstdError, KeyError, MemoryError, OverflowError, struct.error, wrong bytes."""
    data = recorded(tmp_path / "a.wire").read_bytes()
    path = tmp_path / "b.wire"
    for at in range(len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        try:
            found = list(read_wire(path))
        except LogError as error:
            assert "\n" not in str(error)
        else:
            assert found == list(read_wire(tmp_path / "a.wire"))


def test_a_log_is_no_wire():
    with pytest.raises(LogError, match="other channels"):
        list(read_wire(ROOT / "tests" / "golden" / "format-1-lab.mcap"))


def test_what_was_never_sent_is_not_replayed():
    """Regression: it was a WireError."""
    stream = Stream((), Placement(0.0, 0.0, 0.0, 1000.0))
    request = Passage("natnet", False, 0, pack(Request(FRAME_RATE)))
    replay_cameras([request, Passage("natnet", False, 1, b"\0")], stream)
    assert stream._asked == FRAME_RATE
