"""Tests that tetractl always reads what it wrote, even if new specs are checked more strictly."""

from dataclasses import replace

import pytest
from mcap.records import Attachment
from testkit.cli import tetractl
from testkit.mutate import rewrite
from testkit.tampering import SIM

from tetractl.log.format.channels import RESOLVED_SPEC
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec

pytestmark = pytest.mark.slow

MEASURED = {"outside": (-2.694, 264.5), "in an obstacle": (250.0, 410.0)}


@pytest.fixture(scope="module", params=MEASURED.values(), ids=MEASURED)
def log(request, tmp_path_factory):
    """The log of a trial whose robot was measured where no spec may place it, as a cell may be."""
    written = parse_spec(SIM, "measured.yaml").experiment
    moved = written.robots[0].model_copy(update={"start": request.param})
    spec = written.model_copy(update={"robots": (moved, *written.robots[1:])})
    vars(spec).pop("setup", None)  # that of the robots where the spec places them
    folder = tmp_path_factory.mktemp("measured")
    run_logged(LoadedSpec(spec, SIM, "measured.yaml"), folder, 1)
    return log_path(folder, 1)


@pytest.mark.parametrize(
    "command",
    [
        "info {log}",
        "stats {log}",
        "verify {log}",
        "recover {log} -o recovered.mcap",
        pytest.param("report {log} -o report.html", marks=pytest.mark.long),
        "plot {log} -o plot.svg",
        "export {log} -o tables",
        "rerun {log} --out again",
    ],
)
def test_a_trial_that_began_anywhere_is_read(log, tmp_path, command):
    tetractl(tmp_path, *command.format(log=log).split()).ok()


def test_verify_still_notices_a_start_that_was_changed(log, tmp_path):
    contents = scan(log)
    records = [
        replace(record, data=record.data.replace(b"start: [100.0,", b"start: [-90.0,"))
        if isinstance(record, Attachment) and record.name == RESOLVED_SPEC
        else record
        for record in contents.records
    ]
    changed = RawLog(log, records=records, channels=contents.channels)
    done = tetractl(tmp_path, "verify", rewrite(changed, tmp_path / "changed.mcap", {}))
    assert done.returncode == 1
    assert "trial: /result[0]" in done.stdout
