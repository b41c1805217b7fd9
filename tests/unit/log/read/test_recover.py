"""Tests of `recover`: everything intact is saved, and everything lost is named."""

import os
import random
from pathlib import Path

import pytest
from mcap.records import Channel
from testkit.durable import small_disk
from testkit.mutate import rewrite
from testkit.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log.format.channels import HOST_TIMING, RECOVERED, Entry
from tetractl.log.read.find import find_logs
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.log.read.recover import PART_SUFFIX, recover, recovered_path
from tetractl.log.read.salvage import scan
from tetractl.log.write.sink import Sink
from tetractl.statistics.describe import describe
from tetractl.statistics.open_batch import open_batch
from tetractl.verification.comparison import first_difference

# In a chunk's record: the name of its compression with its length in front, then the data.
CHUNK_DATA = b"\x04\0\0\0zstd"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap")


def damaged(folder, data, name="trial.mcap"):
    path = folder / name
    path.write_bytes(data)
    return path


def torn(log, folder):
    """A copy that lost its end, and with it the index."""
    return damaged(folder, log.read_bytes()[:-2000], "trial.mcap.part")


def flipped(data, offset):
    """The bytes with one bit changed."""
    return data[:offset] + bytes([data[offset] ^ 0x10]) + data[offset + 1 :]


def out_path(done):
    """Where a recovery wrote the log."""
    return Path(done.path)


def test_what_was_lost_is_reported_after_all_that_came_back(log, tmp_path):
    """A defect planted in `recover.py`, which reported it first, was found by no test."""
    entries = scan(out_path(recover(torn(log, tmp_path)))).entries
    *others, lost = sorted(entries, key=lambda entry: entry.topic == RECOVERED)
    assert lost.topic == RECOVERED
    assert lost.log_ns == max(entry.log_ns for entry in others) > 0


def test_a_complete_log_needs_no_recovery(log, tmp_path):
    done = recover(log)
    assert (done.path, done.whole, done.damage.problems) == (None, True, ())
    copy = recover(log, tmp_path / "copy.mcap")
    assert copy.whole
    assert not first_difference(read_trial(tmp_path / "copy.mcap").steps, read_trial(log).steps)
    assert read_trial(tmp_path / "copy.mcap").damage is None


@pytest.fixture
def rotten(log, tmp_path):
    """A log with a bit flipped in its fourth chunk, which holds control steps and frames."""
    data = log.read_bytes()
    chunks = [i for i in range(len(data)) if data.startswith(CHUNK_DATA, i)]
    return damaged(tmp_path, flipped(data, chunks[3] + 60))


def test_what_is_lost_and_when_is_told(log, rotten):
    done = recover(rotten)
    assert not done.whole
    recovered = {step.k for step in read_trial(out_path(done)).steps}
    missing = [step.k for step in read_trial(log).steps if step.k not in recovered]
    assert missing
    assert missing == list(range(missing[0], missing[-1] + 1))
    text = " ".join(done.damage.lost)
    assert f"control steps {missing[0]} to {missing[-1]}, between " in text
    assert "camera frames" in text


@pytest.mark.long
def test_every_intact_record_comes_back(log, tmp_path):
    data = log.read_bytes()
    rng = random.Random(3)
    for i in range(30):
        spoilt = flipped(data, rng.randrange(len(data)))
        path = damaged(tmp_path, spoilt, f"{i}.mcap")
        before = scan(path)
        done = recover(path)
        if done.path is None:
            continue
        after = scan(Path(done.path))
        assert after.problems == []
        assert after.attachments == before.attachments
        assert after.entries[-1].topic == RECOVERED
        assert after.records[:-1] == before.records


def test_nothing_is_overwritten(log, tmp_path):
    source = torn(log, tmp_path)
    recovered_path(source).write_text("mine")
    with pytest.raises(LogError, match="exists already"):
        recover(source)
    assert recovered_path(source).read_text() == "mine"


@pytest.mark.parametrize("name", ["trial-000.mcap", "trial-000.mcap.part"])
@pytest.mark.parametrize("simulated", [True, False])
def test_a_recovered_trial_counts_once(tmp_path, name, simulated):
    log = write(trial(steps=34, simulated=simulated), tmp_path / "whole")
    data = log.read_bytes()
    log.unlink()
    cut = damaged(tmp_path, data[: len(data) // 2], name)
    out = out_path(recover(cut))
    assert find_logs([tmp_path]) == [cut]
    assert find_logs(tmp_path.glob("*")) == [cut]
    assert len(open_batch([cut, out]).trials) == 1
    cut.unlink()
    assert find_logs([tmp_path]) == [out]
    batch = open_batch([tmp_path])
    assert (len(batch.trials), batch.damaged) == (1, ())
    assert batch.trials[0].recovered
    assert describe(batch).experiment.name == "made-up"


def test_a_recovery_that_is_under_way_is_left_alone(log, tmp_path):
    source = torn(log, tmp_path)
    sink = Sink(recovered_path(source), PART_SUFFIX)
    with pytest.raises(LogError, match="another process is already writing this log"):
        recover(source)
    sink.discard()
    assert recover(source).whole


def test_an_unfinished_trial_is_never_replaced(log, tmp_path):
    source = torn(log, tmp_path)
    part = tmp_path / "other.mcap.part"
    part.write_bytes(b"a trial that runs")
    recover(source, tmp_path / "other.mcap")
    assert part.read_bytes() == b"a trial that runs"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts file systems")
def test_a_full_disk_leaves_nothing_behind(log, tmp_path):
    source = torn(log, tmp_path)
    with small_disk(tmp_path / "disk", "16k") as disk:
        with pytest.raises(LogError, match="No space left on device"):
            recover(source, disk / "out.mcap")
        assert list(disk.iterdir()) == []
    assert recover(source).whole


def test_a_lost_index_costs_nothing(log, tmp_path):
    done = recover(torn(log, tmp_path))
    assert done.path == str(tmp_path / "trial.recovered.mcap")
    assert (done.whole, done.damage.lost) == (True, ())
    out = out_path(done)
    again = read_trial(out)
    assert again.damage is None
    assert content_digest(out) == again.digest == content_digest(log)
    assert not read_result(out).recovered


def test_a_recovered_log_says_what_was_lost(rotten):
    done = recover(rotten)
    damage = read_trial(out_path(done)).damage
    assert damage.problems[0] == "this log was recovered from trial.mcap, which was damaged"
    assert set(done.damage.lost) <= set(damage.lost)
    assert read_result(out_path(done)).recovered


def test_a_recovered_log_has_the_digest_of_what_is_intact(rotten):
    out = out_path(recover(rotten))
    assert content_digest(out) == content_digest(rotten)


def test_a_log_that_is_recovered_twice_says_it_once(rotten, tmp_path):
    recover(out_path(recover(rotten)), tmp_path / "twice.mcap")
    assert len(scan(tmp_path / "twice.mcap").entries_by_topic[RECOVERED]) == 1


def test_what_a_killed_recovery_left_is_replaced(log, tmp_path):
    """Regression: `recover` refused to run again."""
    source = torn(log, tmp_path)
    unfinished = tmp_path / f"trial.recovered.mcap{PART_SUFFIX}"
    unfinished.write_bytes(log.read_bytes()[:5000])
    assert find_logs([tmp_path]) == [source]
    done = recover(source)
    assert done.whole
    assert not unfinished.exists()
    steps = read_trial(out_path(done)).steps
    assert not first_difference(steps, read_trial(log).steps)


def test_a_channel_that_is_only_in_the_index_is_copied(log, tmp_path):
    """Regression: `recover` copied messages of a channel that it had not made."""
    contents = scan(log)
    extra = Entry("/only", 1, 1, b"data")
    first = contents.records.index(contents.entries[0])
    records = [*contents.records[:first], extra, *contents.records[first:]]
    records.insert(first + 40, extra)  # the first takes the record of the channel with it
    more = {"/only": (Channel(77, "/only", "none", {}, 0), None)}
    changed = RawLog(log, records=records, channels=contents.channels | more)
    data = rewrite(changed, tmp_path / "whole", {}, apart=True).read_bytes()
    spoilt = flipped(data, data.index(CHUNK_DATA) + 60)
    done = recover(damaged(tmp_path, spoilt))
    assert extra in scan(out_path(done)).entries


def test_a_lost_record_of_the_host_is_a_loss(log, tmp_path):
    """The file is whole, and so is the trial: the digest of the host's records alone tells."""
    contents = scan(log)
    timing = contents.entries_by_topic[HOST_TIMING][3]
    path = tmp_path / "changed.mcap"
    sink = Sink(path)
    for record in contents.records:
        if record != timing:
            sink.add(record)
    sink.close(complete=True)
    assert recover(log).whole
    assert recover(path).damage.lost == (
        "at least one record, because a digest in the log does not match",
    )
