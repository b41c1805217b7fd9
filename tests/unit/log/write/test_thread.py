"""Tests of the log's thread: a simulation waits for the disk, but a lab's loop does not."""

import errno
import threading

import pytest
from testkit.random_trials import trial, write

from tetractl.core.errors import LogError
from tetractl.log import provenance
from tetractl.log.read.reader import content_digest, read_trial
from tetractl.log.write import sink
from tetractl.log.write import writer as module
from tetractl.log.write.writer import LogWriter


class Disk:
    """A disk whose syncs, from `stick` on, end only when the test sets `free`."""

    def __init__(self, monkeypatch):
        self.stuck = False
        self.free = threading.Event()
        monkeypatch.setattr(sink, "_sync_data", self.sync)

    def sync(self, handle):
        if self.stuck:
            self.free.wait(60)

    def stick(self, monkeypatch):
        self.stuck = True
        monkeypatch.setattr(sink, "CHUNK_S", 0.0)


def log_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("log ")]


def test_a_disk_that_stands_still_does_not_hold_up_the_loop(tmp_path, monkeypatch):
    """Every call returns while the disk stands still: nothing but the end waits."""
    disk = Disk(monkeypatch)
    random_trial = trial(steps=40)
    writer = LogWriter(tmp_path / "trial.mcap", real_time=True)
    with writer:
        writer.on_start(random_trial.start)
        disk.stick(monkeypatch)
        random_trial.give_rounds(writer)
        disk.free.set()
        writer.on_stop(random_trial.stop, random_trial.result)
    log = read_trial(tmp_path / "trial.mcap")
    assert (len(log.steps), len(log.frames), log.damage) == (40, len(random_trial.samples), None)


def test_a_simulation_waits_for_the_disk_and_loses_nothing(tmp_path, monkeypatch):
    plain = write(trial(steps=30), tmp_path / "plain.mcap")
    monkeypatch.setattr(module, "QUEUE_MAX", 1)
    monkeypatch.setattr(sink, "CHUNK_S", 0.0)
    slow = write(trial(steps=30), tmp_path / "slow.mcap")
    assert content_digest(slow) == content_digest(plain)
    assert read_trial(slow).damage is None


def test_a_disk_that_stays_still_ends_the_trial(tmp_path, monkeypatch):
    disk = Disk(monkeypatch)
    monkeypatch.setattr(module, "QUEUE_MAX", 4)
    monkeypatch.setattr(module, "DISK_PATIENCE_S", 0.5)
    provenance.host_facts({})  # asks git, once
    random_trial = trial(steps=40)
    writer = LogWriter(tmp_path / "trial.mcap")
    writer.on_start(random_trial.start)
    disk.stick(monkeypatch)
    with pytest.raises(LogError, match="the disk is too slow"):
        random_trial.give_rounds(writer)
    writer.on_stop(random_trial.stop, random_trial.result)  # reported once
    writer.close()
    disk.free.set()
    for thread in log_threads():
        thread.join(10)
    assert read_trial(tmp_path / "trial.mcap.part").damage is not None


@pytest.mark.long
@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_what_fails_in_the_thread_reaches_the_loop_at_its_next_call(tmp_path, monkeypatch, number):
    random_trial = trial(steps=3)
    writer = LogWriter(tmp_path / "trial.mcap", real_time=True)
    with writer:
        writer.on_start(random_trial.start)

        def refuse(handle):
            raise OSError(number, "the disk says no")

        monkeypatch.setattr(sink, "_sync_data", refuse)
        monkeypatch.setattr(sink, "CHUNK_S", 0.0)
        writer.on_samples(random_trial.samples)
        while writer.failure is None:  # the thread's own pace; no call asks for it
            pass
        with pytest.raises(LogError, match="cannot write the log: the disk says no"):
            writer.on_step(random_trial.steps[0])
    log = read_trial(tmp_path / "trial.mcap.part")
    assert len(log.frames) == len(random_trial.samples)
    assert log_threads() == []
