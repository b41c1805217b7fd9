"""Tests of when a log's file is flushed and synced, and of what becomes of the file."""

from types import SimpleNamespace

import pytest
from mcap.records import Attachment

from tetractl.core.errors import LogError
from tetractl.log.format.channels import DIGESTS, LOG, Entry
from tetractl.log.read.salvage import scan
from tetractl.log.write import sink
from tetractl.log.write.sink import CHUNK_S, SYNC_S, Sink


def entry(number):
    return Entry(LOG, number, number, b"")


class Watched:
    """A sink on a clock that a test sets, which counts how often its file is synced."""

    def __init__(self, path, monkeypatch):
        self.now_s = 100.0
        self.syncs = 0
        clock = SimpleNamespace(monotonic=lambda: self.now_s)
        monkeypatch.setattr(sink, "time", clock)
        monkeypatch.setattr(sink, "_sync_data", self._synced)
        self.sink = Sink(path)
        self.part = path.with_name(path.name + ".part")

    def _synced(self, handle):
        self.syncs += 1

    def due_at(self, now_s):
        """What `flush_if_due` returns at a time [s]."""
        self.now_s = now_s
        return self.sink.flush_if_due()

    @property
    def on_disk(self):
        return [e.log_ns for e in scan(self.part).entries]


@pytest.fixture
def watched(tmp_path, monkeypatch):
    watched = Watched(tmp_path / "trial.mcap", monkeypatch)
    yield watched
    watched.sink.discard()


def test_nothing_is_due_before_anything_is_added(watched):
    assert watched.due_at(500.0) is None
    assert watched.syncs == 0


def test_a_message_is_on_the_disk_when_its_time_is_over_and_not_before(watched):
    watched.sink.add(entry(1))
    assert watched.due_at(100.0 + 0.4 * CHUNK_S) == pytest.approx(0.6 * CHUNK_S)
    watched.sink.add(entry(2))  # the oldest message counts
    assert watched.due_at(100.0 + 0.9 * CHUNK_S) == pytest.approx(0.1 * CHUNK_S)
    assert watched.syncs == 0
    assert watched.due_at(100.0 + CHUNK_S) is None
    assert watched.on_disk == [1, 2]
    assert watched.syncs == 1
    assert watched.due_at(500.0) is None
    assert watched.syncs == 1


def test_what_was_flushed_is_synced_when_its_time_is_over(watched):
    watched.sink.add(entry(1))
    watched.sink.flush()
    watched.now_s = 100.0 + 0.5 * SYNC_S
    watched.sink.add(entry(2))
    watched.sink.flush()  # the oldest write counts
    assert watched.due_at(100.0 + 0.9 * SYNC_S) == pytest.approx(0.1 * SYNC_S)
    assert watched.syncs == 0
    assert watched.due_at(100.0 + SYNC_S) is None
    assert watched.syncs == 1
    watched.sink.add(entry(3))
    watched.sink.flush()
    assert watched.due_at(100.0 + 1.9 * SYNC_S) == pytest.approx(0.1 * SYNC_S)


def test_a_sync_does_not_end_a_chunk_that_is_not_due(watched):
    """Chunks of a simulation end by the trial's clock, so that they are the same in every run."""
    watched.sink.add(entry(1))
    watched.sink.flush()
    watched.now_s = 100.0 + 0.9 * SYNC_S
    watched.sink.add(entry(2))
    left_s = watched.due_at(100.0 + SYNC_S)
    assert left_s == pytest.approx(CHUNK_S - 0.1 * SYNC_S)
    assert watched.syncs == 1
    assert watched.on_disk == [1]
    assert watched.due_at(100.0 + 0.9 * SYNC_S + CHUNK_S) is None
    assert watched.on_disk == [1, 2]


def test_an_attachment_ends_the_chunk_before_it(watched):
    watched.sink.add(entry(1))
    watched.sink.add(Attachment(0, 0, "a.txt", "text/plain", b"text"))
    watched.sink.add(entry(2))
    watched.sink.sync()
    kinds = [type(record) for record in scan(watched.part).records]
    assert kinds == [Entry, Attachment, Entry]


def test_after_its_end_a_sink_takes_nothing_and_nothing_is_due(watched):
    watched.sink.add(entry(1))
    watched.sink.close(complete=False)
    size = watched.part.stat().st_size
    watched.sink.add(entry(2))
    watched.sink.flush()
    watched.sink.close(complete=True)
    assert watched.due_at(900.0) is None
    assert watched.part.stat().st_size == size
    assert watched.on_disk == [1]


# ---- Files ----


@pytest.mark.parametrize("complete", [True, False])
def test_only_a_complete_log_loses_its_suffix(tmp_path, complete):
    path = tmp_path / "trial.mcap"
    log = Sink(path)
    log.add(entry(1))
    log.seal(7)
    log.close(complete)
    assert [file.name for file in tmp_path.iterdir()] == [
        "trial.mcap" if complete else "trial.mcap.part"
    ]
    (written,) = tmp_path.iterdir()
    raw = scan(written)
    assert raw.entries_by_topic[DIGESTS][0].log_ns == 7
    assert not raw.altered
    assert raw.problems == []


def test_a_log_that_is_not_wanted_leaves_nothing(tmp_path):
    log = Sink(tmp_path / "trial.mcap")
    log.add(entry(1))
    log.discard()
    assert list(tmp_path.iterdir()) == []
    log.discard()


@pytest.mark.parametrize("name", ["trial.mcap", "trial.mcap.part"])
def test_a_trial_never_overwrites_a_log_and_a_copy_replaces_only_an_unfinished_copy(tmp_path, name):
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(LogError, match="exists already"):
        Sink(tmp_path / "trial.mcap")
    assert (tmp_path / name).read_bytes() == b"old"
    (tmp_path / "trial.mcap.copying").write_bytes(b"an unfinished copy" * 99)
    if name == "trial.mcap":
        with pytest.raises(LogError, match="exists already"):
            Sink(tmp_path / "trial.mcap", ".copying")
        return
    copy = Sink(tmp_path / "trial.mcap", ".copying")
    copy.add(entry(1))
    copy.close(complete=True)
    assert [e.log_ns for e in scan(tmp_path / "trial.mcap").entries] == [1]
    assert (tmp_path / name).read_bytes() == b"old"
    assert not (tmp_path / "trial.mcap.copying").exists()


def test_two_processes_never_write_the_same_copy(tmp_path):
    first = Sink(tmp_path / "trial.mcap", ".copying")
    first.add(entry(1))
    with pytest.raises(LogError, match="another process is already writing this log"):
        Sink(tmp_path / "trial.mcap", ".copying")
    first.close(complete=True)
    assert [e.log_ns for e in scan(tmp_path / "trial.mcap").entries] == [1]


def test_a_log_that_was_removed_is_restored_and_the_error_says_where_it_is(tmp_path):
    log = Sink(tmp_path / "trial.mcap")
    log.add(entry(1))
    log.sync()
    part = tmp_path / "trial.mcap.part"
    part.unlink()
    log.add(entry(2))
    with pytest.raises(LogError, match="was removed during the trial") as caught:
        log.sync()
    assert caught.value.hint == f"the log written so far is in {part}"
    assert [e.log_ns for e in scan(part).entries] == [1, 2]
    log.add(entry(3))  # nothing happens
    log.sync()


@pytest.mark.parametrize(
    ("error", "why"),
    [(OSError(28, "No space left on device"), "No space left on device"), (OSError("odd"), "odd")],
)
def test_a_failed_write_says_why_in_the_words_of_the_system(tmp_path, error, why):
    path = tmp_path / "trial.mcap"
    log = Sink(path)
    log.add(entry(1))
    with pytest.raises(LogError) as caught:
        log.fail(error)
    assert caught.value.message == f"{path}: cannot write the log: {why}"
    assert caught.value.hint == f"the log written so far is in {path}.part"
