"""One module says whether a log is whole: by its file, its source, its result and its digests."""

from dataclasses import replace

import pytest
from support.paths import ROOT

from tetractl.log.format.channels import RESULT, STEP
from tetractl.log.read.damage import damage_of, is_damaged, losses, with_alteration
from tetractl.log.read.raw_log import ALTERED
from tetractl.log.read.reader import trial_of
from tetractl.log.read.recover import recover
from tetractl.log.read.salvage import scan

WHOLE = ROOT / "tests/golden/format-4-sim.mcap"
TORN = ROOT / "tests/golden/format-4-torn.mcap"


def test_a_whole_log_has_no_damage_and_no_losses():
    raw = scan(WHOLE)
    assert not is_damaged(raw)
    assert damage_of(raw, until_s=1.0) is None
    assert with_alteration(raw, None) is None
    assert losses(raw, trial_of(raw)) == ()


def test_a_torn_log_says_what_is_torn():
    raw = scan(TORN)
    assert is_damaged(raw)
    damage = damage_of(raw, until_s=1.25)
    assert damage is not None
    assert damage.problems == tuple(raw.problems)


def test_a_log_without_a_result_says_up_to_when_it_is_known():
    raw = scan(WHOLE)
    del raw.by_topic[RESULT]
    assert is_damaged(raw)
    damage = damage_of(raw, until_s=1.25)
    assert damage is not None
    assert damage.problems == (raw.why_no_result,)
    assert damage.lost == ("the result and everything after 1.250 s",)


def test_a_copy_of_a_torn_log_is_damaged_as_its_source_is(tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(WHOLE.read_bytes()[: WHOLE.stat().st_size // 2])
    copy = tmp_path / "copy.mcap"
    recover(torn, copy)
    raw = scan(copy)
    assert raw.problems == []
    assert is_damaged(raw)
    damage = damage_of(raw, until_s=0.0)
    assert damage is not None
    assert damage.problems[0] == "recovered from torn.mcap, which was damaged"


def test_an_altered_log_is_not_whole_though_all_its_records_can_be_read():
    raw = scan(WHOLE)
    (_, step, *_) = raw.by_topic[STEP]
    raw.records.remove(step)
    raw = replace(raw)  # what was computed of the records is forgotten
    assert not is_damaged(raw)
    damage = with_alteration(raw, None)
    assert damage is not None
    assert damage.problems == (ALTERED,)
    assert losses(raw, trial_of(raw))[0].startswith("control step")


@pytest.mark.parametrize("log", [WHOLE, TORN])
def test_a_result_that_is_known_has_no_reason_to_be_unknown(log):
    raw = scan(log)
    assert (raw.result is None) == bool(raw.why_no_result)
