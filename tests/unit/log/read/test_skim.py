"""One pass over an undamaged log gives what reading it whole gives."""

import pytest
from support.mutate import rewritten
from support.random_trials import trial, write

from tetractl.log.read.overview import channel_counts, overview
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.skim import skim
from tetractl.replay.comparison import first_difference


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(trial(steps=34), tmp_path_factory.mktemp("log") / "trial.mcap")


def test_it_tells_the_same_as_the_whole_log(log):
    few, whole = skim(log), scan(log)
    assert few is not None
    assert len(few.records) < len(whole.records) / 2
    assert channel_counts(few) == channel_counts(whole)
    assert (few.digests, few.run) == (whole.digests, whole.run)
    assert not first_difference(few.result, whole.result)
    assert trial_of(few).events == trial_of(whole).events
    last = [step for step in trial_of(whole).steps if step.plan.estimate][-1]
    assert overview(log).estimate_step == last.k


def test_what_is_damaged_or_of_another_writer_is_left_to_the_salvage(log, tmp_path):
    data, path = log.read_bytes(), tmp_path / "damaged.mcap"
    for at in range(9, len(data), len(data) // 40):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert skim(path) is None
    path.write_bytes(data[:-1])
    assert skim(path) is None
    assert skim(rewritten(log, tmp_path / "again.mcap")) is None


def test_the_indexes_of_messages_are_not_parsed(log, monkeypatch):
    """They are most of the records' parts of a long log, and nothing needs them."""

    def parsed(stream):
        raise AssertionError

    monkeypatch.setattr("mcap.records.MessageIndex.read", parsed)
    assert skim(log) is not None
