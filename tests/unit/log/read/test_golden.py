"""Tests that logs of every released format version still give the same values."""

import json
import sys

import pytest
from testkit.paths import ROOT

from tetractl.log.format.channels import FORMAT_VERSION
from tetractl.log.read.reader import content_digest, read_result, read_trial
from tetractl.verification.verify import verify

FOLDER = ROOT / "tests" / "golden"
sys.path.insert(0, str(FOLDER))

from make import values  # noqa: E402

EXPECTED = {
    name: values_of_log
    for page in sorted(FOLDER.glob("format-*.json"))
    for name, values_of_log in json.loads(page.read_text()).items()
}


def test_the_version_that_is_written_has_its_golden_logs():
    assert f"format-{FORMAT_VERSION}-sim.mcap" in EXPECTED
    assert {path.name for path in FOLDER.glob("*.mcap")} == EXPECTED.keys()
    files = [path for path in FOLDER.iterdir() if path.is_file()]
    assert max(path.stat().st_size for path in files) < 100_000


@pytest.mark.parametrize("name", EXPECTED)
def test_every_number_is_as_it_was(name):
    log = read_trial(FOLDER / name)
    assert json.loads(json.dumps(values(log))) == EXPECTED[name]
    if log.damage is None:
        assert content_digest(FOLDER / name) == log.digest
    summary = read_result(FOLDER / name)
    assert summary.recovered == (log.damage is not None)


def test_its_decisions_still_follow_from_it():
    """By their costs on any processor; if this fails, the controller no longer does what it did."""
    verification = verify(FOLDER / "format-4-sim.mcap")
    assert verification.problems == ()
    assert verification.checked == verification.steps > 0
