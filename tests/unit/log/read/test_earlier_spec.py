"""Tests that a log whose spec lacks later fields names the version that can read it."""

from dataclasses import replace

import pytest
from mcap.records import Attachment
from testkit.mutate import rewrite
from testkit.paths import ROOT

from tetractl.core.errors import LogError
from tetractl.log.format.channels import RESOLVED_SPEC
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan


def test_a_log_of_a_chosen_intensity_names_the_version_that_reads_it(tmp_path):
    log = ROOT / "tests" / "golden" / "format-4-sim.mcap"
    contents = scan(log)
    records = [
        replace(record, data=record.data + b"intensity: {max: 2.0}\n")
        if isinstance(record, Attachment) and record.name == RESOLVED_SPEC
        else record
        for record in contents.records
    ]
    earlier = RawLog(log, records=records, channels=contents.channels)
    path = rewrite(earlier, tmp_path / "earlier.mcap", {})
    with pytest.raises(LogError, match="intensity: unknown key") as caught:
        read_trial(path)
    written_by = f"tetractl {contents.facts['tetractl']}"
    assert written_by in (caught.value.hint or "")
    assert (caught.value.hint or "").endswith(": install this version")
