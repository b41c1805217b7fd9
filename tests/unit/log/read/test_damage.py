"""Tests that a log is complete or says what it lacks: file, source, result and digests."""

import pytest
from testkit.mutate import rewritten
from testkit.paths import ROOT

from tetractl.log.format.channels import FRAMES, RESULT, STEP
from tetractl.log.read.overview import overview
from tetractl.log.read.raw_log import ALTERED_TEXT
from tetractl.log.read.reader import trial_of
from tetractl.log.read.recover import losses, recover
from tetractl.log.read.salvage import scan
from tetractl.log.write.sink import Sink

WHOLE = ROOT / "tests/golden/format-4-sim.mcap"


def test_a_log_without_a_result_says_up_to_when_it_is_known():
    raw = scan(WHOLE)
    del raw.entries_by_topic[RESULT]
    assert raw.damaged
    trial = trial_of(raw)
    frames_s = trial.elapsed_s(int(trial.received_ns.max()))
    steps_s = trial.elapsed_s(trial.steps[-1].command.sent_ns)
    assert trial.damage.problems == (raw.result_or_problem,)
    (lost,) = trial.damage.lost
    frames = f"camera frames after {frames_s:.3f} s"
    assert lost == f"the result, {frames} and control steps after {steps_s:.3f} s"


def test_steps_that_are_kept_are_not_said_to_be_lost():
    """Regression: "everything after 0.000 s" of a killed game whose steps up to 1.35 s were kept.

    Steps reach the disk before the frames that were received meanwhile.
    """
    raw = scan(WHOLE)
    del raw.entries_by_topic[RESULT], raw.entries_by_topic[FRAMES]
    (lost,) = trial_of(raw).damage.lost
    assert lost.startswith("the result, all camera frames and control steps after ")
    assert not lost.endswith("after 0.000 s")


def test_a_copy_of_a_torn_log_is_damaged_as_its_source_is(tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(WHOLE.read_bytes()[: WHOLE.stat().st_size // 2])
    copy = tmp_path / "copy.mcap"
    recover(torn, copy)
    raw = scan(copy)
    assert raw.problems == []
    assert raw.damaged
    damage = trial_of(raw).damage
    assert damage.problems[0] == "this log was recovered from torn.mcap, which was damaged"


def test_an_altered_log_is_not_whole_though_all_its_records_can_be_read(tmp_path):
    whole = scan(WHOLE)
    (_, step, *_) = whole.entries_by_topic[STEP]
    altered = tmp_path / "altered.mcap"
    sink = Sink(altered)
    for record in whole.records:
        if record is not step:
            sink.add(record)
    sink.close(complete=True)
    raw = scan(altered)
    assert not raw.damaged
    damage = overview(altered).damage
    assert damage.problems == (ALTERED_TEXT,)
    assert losses(raw, trial_of(raw))[0].startswith("control step")
    copied = rewritten(altered, tmp_path / "copied.mcap", in_order=True, keeps_name=True)
    assert scan(copied).altered


def test_a_whole_log_has_no_damage_and_no_losses():
    raw = scan(WHOLE)
    assert not raw.damaged
    assert trial_of(raw).damage is None
    assert overview(WHOLE).damage is None
    assert losses(raw, trial_of(raw)) == ()


TORN = ROOT / "tests/golden/format-4-torn.mcap"


def test_a_torn_log_says_what_is_torn():
    raw = scan(TORN)
    assert raw.damaged
    damage = trial_of(raw).damage
    assert damage is not None
    assert damage.problems == tuple(raw.problems)


@pytest.mark.parametrize("log", [WHOLE, TORN])
def test_a_result_that_is_known_has_no_reason_to_be_unknown(log):
    raw = scan(log)
    assert (raw.result is None) == isinstance(raw.result_or_problem, str)
