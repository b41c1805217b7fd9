"""`recover`: all that is intact comes back, and what does not is named."""

import os
import random
from pathlib import Path

import pytest
from mcap.records import Attachment, Channel
from support.durable import small_disk
from support.mutate import rewrite
from support.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log.format.channels import HOST_TIMING, RECOVERED, Entry
from tetractl.log.read.find import find_logs
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.log.read.recover import PART_SUFFIX, recover, recovered_path
from tetractl.log.read.salvage import scan
from tetractl.log.write.sink import Sink
from tetractl.replay.comparison import first_difference
from tetractl.results.describe import describe
from tetractl.results.open_batch import open_batch


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap")


def damaged(folder, data, name="trial.mcap"):
    path = folder / name
    path.write_bytes(data)
    return path


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


def test_a_complete_log_needs_no_recovery(log, tmp_path):
    done = recover(log)
    assert (done.path, done.whole, done.damage.problems) == (None, True, ())
    copy = recover(log, tmp_path / "copy.mcap")
    assert copy.whole
    assert not first_difference(read_trial(tmp_path / "copy.mcap").steps, read_trial(log).steps)
    assert read_trial(tmp_path / "copy.mcap").damage is None


def test_a_lost_index_costs_nothing(log, tmp_path):
    done = recover(torn(log, tmp_path))
    assert done.path == str(tmp_path / "trial.recovered.mcap")
    assert (done.whole, done.damage.lost) == (True, ())
    again = read_trial(Path(done.path))
    assert again.damage is None
    assert content_digest(Path(done.path)) == again.digest == content_digest(log)
    assert not read_result(Path(done.path)).recovered


def test_what_is_lost_and_when_is_told(log, tmp_path):
    data = log.read_bytes()
    chunks = [i for i in range(len(data)) if data.startswith(b"\x04\0\0\0zstd", i)]
    rotten = damaged(tmp_path, flipped(data, chunks[3] + 60))
    done = recover(rotten)
    assert not done.whole
    whole, left = read_trial(log), read_trial(Path(str(done.path)))
    missing = [step.k for step in whole.steps if step.k not in {s.k for s in left.steps}]
    assert missing
    assert missing == list(range(missing[0], missing[-1] + 1))
    text = " ".join(done.damage.lost)
    assert f"control steps {missing[0]} to {missing[-1]}, between " in text
    assert "camera frames" in text
    assert left.damage is not None
    assert left.damage.problems[0] == "recovered from trial.mcap, which was damaged"
    assert set(done.damage.lost) <= set(left.damage.lost)
    assert read_result(Path(str(done.path))).recovered
    assert content_digest(Path(str(done.path))) == content_digest(rotten)  # that of what is left
    recover(Path(str(done.path)), tmp_path / "twice.mcap")
    assert len(scan(tmp_path / "twice.mcap").by_topic[RECOVERED]) == 1


def test_every_intact_record_comes_back(log, tmp_path):
    data, rng = log.read_bytes(), random.Random(3)
    for i in range(30):
        cut = damaged(tmp_path, flipped(data, rng.randrange(len(data))), f"{i}.mcap")
        before = scan(cut)
        done = recover(cut)
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
    whole = write(trial(steps=34, simulated=simulated), tmp_path / "whole")
    damaged(tmp_path, whole.read_bytes()[: whole.stat().st_size // 2], name)
    whole.unlink()
    done = recover(tmp_path / name)
    assert find_logs([tmp_path]) == [tmp_path / name]
    assert find_logs(tmp_path.glob("*")) == [tmp_path / name]
    assert len(open_batch([tmp_path / name, str(done.path)]).trials) == 1
    (tmp_path / name).unlink()
    assert find_logs([tmp_path]) == [Path(str(done.path))]
    batch = open_batch([tmp_path])
    assert (len(batch.trials), batch.damaged) == (1, ())
    assert batch.trials[0].recovered
    assert describe(batch).experiment.name == "made-up"


def torn(log, folder):
    return damaged(folder, log.read_bytes()[:-2000], "trial.mcap.part")


def test_what_a_killed_recovery_left_is_replaced(log, tmp_path):
    """Regression: `recover` refused to run again."""
    source = torn(log, tmp_path)
    left = tmp_path / f"trial.recovered.mcap{PART_SUFFIX}"
    left.write_bytes(log.read_bytes()[:5000])
    assert find_logs([tmp_path]) == [source]
    done = recover(source)
    assert done.whole
    assert not left.exists()
    assert not first_difference(read_trial(Path(str(done.path))).steps, read_trial(log).steps)


def test_a_recovery_that_is_under_way_is_left_alone(log, tmp_path):
    source = torn(log, tmp_path)
    sink = Sink(recovered_path(source), PART_SUFFIX)
    with pytest.raises(LogError, match="another process is writing this log"):
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


def test_a_channel_that_is_only_in_the_index_is_copied(log, tmp_path):
    """Regression: `recover` copied messages of a channel that it had not made."""
    contents, extra = scan(log), Entry("/only", 1, 1, b"data")
    first = contents.records.index(contents.entries[0])
    records = [*contents.records[:first], extra, *contents.records[first:]]
    records.insert(first + 40, extra)  # the first takes the record of the channel with it
    more = {"/only": (Channel(77, "/only", "none", {}, 0), None)}
    changed = RawLog(log, records=records, channels=contents.channels | more)
    data = rewrite(changed, tmp_path / "whole", {}, apart=True).read_bytes()
    cut = damaged(tmp_path, flipped(data, data.index(b"\x04\0\0\0zstd") + 60))
    assert extra in scan(Path(str(recover(cut).path))).entries


def test_a_lost_record_of_the_host_is_a_loss(log, tmp_path):
    """The file is whole, and so is the trial: the digest of the host's records alone tells."""
    contents, path = scan(log), tmp_path / "changed.mcap"
    timing, sink = contents.by_topic[HOST_TIMING][3], Sink(path)
    for record in contents.records:
        if isinstance(record, Attachment):
            sink.attachment(record.name, record.media_type, record.log_time, record.data)
        elif record != timing:
            sink.messages([record])
    sink.close(complete=True)
    assert recover(log).whole
    assert recover(path).damage.lost == ("a record covered by the log's digest or its host digest",)
