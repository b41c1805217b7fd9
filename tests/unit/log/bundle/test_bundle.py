"""Tests that logs in a bundle stay valid, and that nothing in it names the lab."""

import json
import zipfile

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from testkit.paths import ROOT

from tetractl.core.errors import UsageError
from tetractl.log.bundle.bundle import write_bundle
from tetractl.log.format.channels import DIGESTS, ENVIRONMENT, LOG, SPEC, Entry
from tetractl.log.provenance import environment
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.log.write.sink import Sink

GOLDEN = ROOT / "tests/golden/format-4-lab.mcap"
SECRET = b"# by Ada, ada@uni.edu, tracker at 192.168.1.5\n"


@pytest.fixture
def lab_log(tmp_path):
    """A log of a lab trial whose spec and messages name a person and an address."""
    original = scan(GOLDEN)
    path = tmp_path / "trial-000.mcap"
    sink = Sink(path, ".copying", original.channels)
    for record in original.records:
        if getattr(record, "name", "") == SPEC:
            record.data += SECRET
        if getattr(record, "name", "") == ENVIRONMENT:
            record.data = environment().encode()
        if isinstance(record, Entry) and record.topic == LOG:
            message = Log.FromString(record.data)
            message.message += " at 192.168.1.5"
            record = record._replace(data=message.SerializeToString())
        if not isinstance(record, Entry) or record.topic != DIGESTS:
            sink.add(record)
    sink.seal(original.entries[-1].log_ns)
    sink.close(complete=True)
    return path


def unpacked(archive, folder):
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)
    return folder


def test_a_log_in_a_bundle_is_valid_and_says_nothing_of_who_wrote_it(lab_log, tmp_path):
    write_bundle([lab_log], tmp_path / "report.zip", ["Ada"])
    place = unpacked(tmp_path / "report.zip", tmp_path / "report")
    path = place / "logs/000-trial-000.mcap"
    log, original = scan(path), scan(lab_log)
    assert not log.problems and not log.altered and not log.host_altered
    assert log.facts["host"] == "removed" != original.facts["host"]
    assert log.attachment_text(SPEC).endswith(
        "# by removed-1, person-1@example.org, tracker at 192.0.2.1\n"
    )
    assert json.loads(log.attachment_text(ENVIRONMENT))["host"]["host"] == "removed"
    assert "packages" in json.loads(log.attachment_text(ENVIRONMENT))
    messages = [message.message for message in log.messages(LOG)]
    assert all(text.endswith(" at 192.0.2.1") for text in messages)
    everything = b"".join(entry.data for entry in log.entries)
    everything += b"".join(item.data for item in log.attachments.values())
    for secret in (b"Ada", b"uni.edu", b"192.168.1.5"):
        assert secret not in everything
    trial, before = read_trial(path), read_trial(lab_log)
    assert len(trial.steps) == len(before.steps) > 0
    assert trial.result.total_error == before.result.total_error


def test_a_changed_log_is_not_made_to_look_unchanged(tmp_path):
    """A log without digests, as of a trial that was killed, gets none."""
    write_bundle([ROOT / "tests/golden/format-4-torn.mcap"], tmp_path / "report.zip", [])
    place = unpacked(tmp_path / "report.zip", tmp_path / "report")
    before = scan(ROOT / "tests/golden/format-4-torn.mcap")
    log = scan(next((place / "logs").iterdir()))
    if before.altered or before.host_altered or not before.entries_by_topic[DIGESTS]:
        assert not log.entries_by_topic[DIGESTS]
    assert "damaged" in (place / "contents.txt").read_text()


def test_texts_of_files_and_of_this_computer_are_packed(lab_log, tmp_path):
    (tmp_path / "lab.txt").write_text("Ada's lab, camera at 192.168.1.5")
    bundle = write_bundle([lab_log, tmp_path / "lab.txt"], tmp_path / "report.zip", ["Ada"])
    place = unpacked(tmp_path / "report.zip", tmp_path / "report")
    assert (place / "files/lab.txt").read_text() == "removed-1's lab, camera at 192.0.2.1"
    assert "python" in json.loads((place / "environment.json").read_text())["versions"]
    assert bundle.replaced == {"addresses": 1, "names": 1, "persons": 1}
    assert "addresses: 1, names: 1, persons: 1" in (place / "contents.txt").read_text()


def test_what_cannot_be_packed_is_refused_and_nothing_is_left(lab_log, tmp_path):
    picture = tmp_path / "arena.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    out = tmp_path / "report.zip"
    with pytest.raises(UsageError, match="neither a log, nor a capture"):
        write_bundle([lab_log, picture], out, [])
    assert not list(tmp_path.glob("report.zip*"))
    out.write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        write_bundle([lab_log], out, [])
    assert out.read_text() == "mine"
    with pytest.raises(UsageError, match="none does not exist"):
        write_bundle([lab_log], tmp_path / "none" / "report.zip", [])
