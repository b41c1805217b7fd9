"""Tests of how the writer handles its file: names, flushes, and failing file systems."""

import pytest
from mcap.reader import make_reader
from testkit.random_trials import trial, write, write_and_read

from tetractl.core.clock import SECOND
from tetractl.core.errors import LogError
from tetractl.log.format.channels import FORMAT_VERSION
from tetractl.log.read.reader import read_trial
from tetractl.log.write.writer import LogWriter

pytestmark = pytest.mark.slow


def test_a_log_is_a_part_until_its_trial_has_ended(tmp_path):
    random_trial = trial(steps=1)
    path = tmp_path / "trial.mcap"
    part = tmp_path / "trial.mcap.part"
    writer = LogWriter(path)
    assert not part.exists()
    writer.on_start(random_trial.start)
    assert part.exists()
    assert not path.exists()
    writer.on_stop(random_trial.stop, random_trial.result)
    assert path.exists()
    assert not part.exists()
    writer.close()
    assert read_trial(path).result is not None


def test_a_long_environment_keeps_no_reader_from_a_log_that_is_cut_off(tmp_path):
    path = write(trial(steps=1), tmp_path / "trial.mcap", environment="+ a changed line\n" * 9000)
    with path.open("r+b") as file:
        file.truncate(30_000)
    log = read_trial(path)
    assert log.damage is not None
    assert log.start == write_and_read(trial(steps=1), tmp_path / "other.mcap").start


def test_no_robot_moves_before_the_start_is_on_the_disk(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr("tetractl.log.write.sink._sync_data", synced.append)
    with LogWriter(tmp_path / "trial.mcap") as writer:
        writer.on_start(trial().start)
        assert synced


@pytest.mark.parametrize(("real_time", "seconds"), [(False, 2.2), (True, 0.45)])
def test_little_trial_time_is_all_a_crash_can_cost(real_time, seconds, tmp_path):
    random_trial = trial(steps=32)
    writer = LogWriter(tmp_path / "trial.mcap", real_time)
    writer.on_start(random_trial.start)
    for samples, step in random_trial.rounds:
        writer.on_samples(samples)
        writer.on_step(step)
        writer.drain()
        received_ns = read_trial(tmp_path / "trial.mcap.part").received_ns  # as if killed here
        logged_ns = int(received_ns[-1]) if len(received_ns) else 0
        assert samples[-1].observation.received_ns - logged_ns <= seconds * SECOND
    writer.close()


def test_other_readers_find_metadata_and_attachments(tmp_path):
    """Some report a file that has none of either as damaged."""
    with write(trial(), tmp_path / "trial.mcap").open("rb") as file:
        reader = make_reader(file)
        metadata = [(record.name, record.metadata) for record in reader.iter_metadata()]
        attachments = {attachment.name for attachment in reader.iter_attachments()}
    assert metadata == [("tetractl", {"format": str(FORMAT_VERSION)})]
    assert "spec.yaml" in attachments


@pytest.mark.parametrize("existing", ["trial.mcap", "trial.mcap.part"])
def test_a_log_is_never_overwritten(tmp_path, existing):
    old = write(trial(), tmp_path / "old.mcap").rename(tmp_path / existing)
    before = old.read_bytes()
    with pytest.raises(LogError, match=f"{existing}: a log of this name exists already"):
        LogWriter(tmp_path / "trial.mcap").on_start(trial(2).start)
    assert old.read_bytes() == before


@pytest.mark.parametrize(
    ("folder", "why"),
    [("a-file", "Not a directory"), ("missing", "No such file or directory"), ("n" * 300, "long")],
)
def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path, folder, why):
    (tmp_path / "a-file").write_text("")
    random_trial = trial()
    writer = LogWriter(tmp_path / folder / "trial.mcap")
    with pytest.raises(LogError, match=why) as caught:
        writer.on_start(random_trial.start)
    assert "\n" not in caught.value.message
    assert caught.value.hint is None
    random_trial.give_rounds(writer)  # what comes while the trial is ended is dropped
    writer.on_stop(random_trial.stop, random_trial.result)
    writer.close()


def test_a_folder_moved_during_the_trial_takes_its_log_along(tmp_path):
    random_trial = trial(steps=1)
    folder = tmp_path / "logs"
    folder.mkdir()
    writer = LogWriter(folder / "trial.mcap")
    writer.on_start(random_trial.start)
    folder.rename(tmp_path / "moved")
    writer.on_samples(random_trial.samples)
    with pytest.raises(LogError, match="was moved during the trial") as caught:
        writer.on_stop(random_trial.stop, random_trial.result)
    assert caught.value.hint is None
    assert not folder.exists()
    assert len(read_trial(tmp_path / "moved" / "trial.mcap.part").frames) == len(
        random_trial.samples
    )
