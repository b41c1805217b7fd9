import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.errors import LogError
from tetractl.lab.recorded import Passage, WireRecorder, read_wire

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
    with pytest.raises(LogError, match="not a recorded wire"):
        list(read_wire(path))
    with pytest.raises(LogError, match="No such file"):
        list(read_wire(tmp_path / "none"))


def test_a_disk_that_refuses_ends_the_recording_not_the_run():
    from pathlib import Path

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
