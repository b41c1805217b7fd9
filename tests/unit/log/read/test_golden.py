"""Logs of every released format version read as they did when they were written."""

import json
import sys

import pytest
from support.mutate import rewrite
from support.paths import ROOT

from tetractl.log.format.channels import CHANNELS, FORMAT_VERSION, FRAMES
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.log.read.salvage import scan
from tetractl.replay.verify import verify

FOLDER = ROOT / "tests" / "golden"
sys.path.insert(0, str(FOLDER))

from make import values  # noqa: E402

EXPECTED = {
    name: found
    for page in sorted(FOLDER.glob("format-*.json"))
    for name, found in json.loads(page.read_text()).items()
}


def test_the_version_that_is_written_has_its_golden_logs():
    assert f"format-{FORMAT_VERSION}-sim.mcap" in EXPECTED
    assert {path.name for path in FOLDER.glob("*.mcap")} == EXPECTED.keys()
    assert all(path.stat().st_size < 100_000 for path in FOLDER.iterdir() if path.is_file())


@pytest.mark.parametrize("name", EXPECTED)
def test_every_number_is_as_it_was(name):
    log = read_trial(FOLDER / name)
    assert json.loads(json.dumps(values(log))) == EXPECTED[name]
    if log.damage is None:
        assert content_digest(FOLDER / name) == log.digest
    summary = read_result(FOLDER / name)
    assert summary.recovered == (log.damage is not None)


def test_what_earlier_versions_found_in_pictures_is_passed_over(tmp_path):
    """Format 4 had crops of pictures on channel 12, which is still listed in its golden logs."""
    old = scan(FOLDER / "format-4-sim.mcap")
    (crops,) = (one for one, _ in old.channels.values() if one.id == 12)
    assert crops.topic.startswith("/camera/") and crops.topic not in CHANNELS
    first = old.by_topic[FRAMES][0]
    records = [first._replace(topic=crops.topic), *old.records]
    kept = RawLog(old.path, records=records, channels=old.channels)
    log = rewrite(kept, tmp_path / "crops.mcap", {})
    assert [one.data for one in scan(log).by_topic[crops.topic]] == [first.data]
    assert read_trial(log).frames.tolist() == read_trial(old.path).frames.tolist()
    assert verify(log).problems == ()


def test_its_decisions_still_follow_from_it():
    """By their costs on any processor; if this fails, the controller no longer does what it did."""
    found = verify(FOLDER / "format-4-sim.mcap")
    assert found.problems == ()
    assert found.checked == found.steps > 0
