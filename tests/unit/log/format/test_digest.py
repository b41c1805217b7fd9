"""Tests that two runs of one trial differ only in the records of the host."""

import pytest
from mcap.records import Attachment
from testkit.random_trials import trial, write

from tetractl.log import provenance
from tetractl.log.format.channels import DIGESTS, HOST_RECORDS, Entry
from tetractl.log.format.digest import LogDigests
from tetractl.log.read.reader import content_digest
from tetractl.log.read.salvage import scan


def _named(record):
    return record.topic if isinstance(record, Entry) else record.name


def _repeating(path):
    """The records that each run of one trial must repeat."""
    differing = HOST_RECORDS | {DIGESTS}
    return [record for record in scan(path).records if _named(record) not in differing]


@pytest.fixture
def elsewhere(monkeypatch):
    """Another machine, another day, another checkout."""
    monkeypatch.setattr(provenance, "utc_now", lambda: "2031-01-01T00:00:00.000+00:00")
    monkeypatch.setattr(provenance, "host", lambda: {"host": "another machine", "cpu": "other"})
    monkeypatch.setattr(provenance, "versions", lambda: {"python": "3.99.0"})
    monkeypatch.setattr(provenance, "git_state", dict)


def test_the_digest_ignores_where_and_when(tmp_path, request):
    on_this_machine = write(trial(), tmp_path / "here.mcap")
    request.getfixturevalue("elsewhere")
    on_another = write(trial(), tmp_path / "there.mcap", environment="other\n")
    contents = scan(on_this_machine)
    contents_of_another = scan(on_another)
    assert contents.facts != contents_of_another.facts
    assert contents.attachment_text("environment.json") != contents_of_another.attachment_text(
        "environment.json"
    )
    assert _repeating(on_this_machine) == _repeating(on_another)
    assert content_digest(on_this_machine) == content_digest(on_another)


def test_every_part_of_a_record_counts():
    def digest(entry, attached):
        digests = LogDigests()
        digests.add(entry)
        digests.add(Attachment(0, 0, "spec.yaml", "application/yaml", attached))
        return digests.hexdigests().content

    entry = Entry("/step", 1, 2, b"x")
    all_digests = {
        digest(entry, b"x"),
        digest(entry._replace(topic="/stop"), b"x"),
        digest(entry._replace(log_ns=3), b"x"),
        digest(entry._replace(publish_ns=3), b"x"),
        digest(entry._replace(data=b"y"), b"x"),
        digest(entry, b"y"),
    }
    assert len(all_digests) == 6  # no two are equal
