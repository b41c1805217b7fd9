"""Two runs of one trial differ in nothing but the host records."""

import pytest
from mcap.records import Attachment
from support.random_trials import trial, write

from tetractl.log import provenance
from tetractl.log.format.channels import DIGESTS, HOST_RECORDS, Entry
from tetractl.log.format.digest import LogDigests
from tetractl.log.read.reader import content_digest
from tetractl.log.read.salvage import scan


def _repeating(path):
    names = {Entry: "topic", Attachment: "name"}
    differ, records = HOST_RECORDS | {DIGESTS}, scan(path).records
    return [item for item in records if getattr(item, names[type(item)]) not in differ]


@pytest.fixture
def elsewhere(monkeypatch):
    """Another machine, another day, another checkout."""
    monkeypatch.setattr(provenance, "now", lambda: "2031-01-01T00:00:00.000+00:00")
    monkeypatch.setattr(provenance, "host", lambda: {"host": "another machine", "cpu": "other"})
    monkeypatch.setattr(provenance, "versions", lambda: {"python": "3.99.0"})


def test_the_digest_ignores_where_and_when(tmp_path, request):
    here = write(trial(), tmp_path / "here.mcap")
    request.getfixturevalue("elsewhere")
    there = write(trial(), tmp_path / "there.mcap", environment="other\n")
    assert scan(here).facts != scan(there).facts
    assert scan(here).text("environment.json") != scan(there).text("environment.json")
    assert _repeating(here) == _repeating(there)
    assert content_digest(here) == content_digest(there)


def test_every_part_of_a_record_counts():
    entry = Entry("/step", 1, 2, b"x")
    records = {"entry": entry, "data": b"x"}
    others = (
        *({"entry": entry._replace(**{name: new})} for name, new in
          (("topic", "/stop"), ("log_ns", 3), ("publish_ns", 3), ("data", b"y"))),
        {"data": b"y"},
    )  # fmt: skip

    def digest(entry, data):
        made = LogDigests()
        made.messages([entry])
        made.attachment("spec.yaml", "application/yaml", 0, data)
        return made.stated().content

    assert len({digest(**records | other) for other in ({}, *others)}) == 6
