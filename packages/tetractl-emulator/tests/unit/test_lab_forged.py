"""Tests that the log of an emulated lab is never accepted as the log of a real lab."""

from collections.abc import Callable
from typing import Any

import pytest
from testkit.emulator.lab_logs import lab_log

from tetractl.log.format.channels import RUN, Entry
from tetractl.log.format.tetractl_pb2 import Run
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import read_result, trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Origin
from tetractl.verification.result_check import result_differences
from tetractl.verification.verify import verify

pytestmark = pytest.mark.system

Edit = Callable[[Any], None]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A lab on the radio's wires, of which 30 % of the commands are lost."""
    return scan(lab_log(tmp_path_factory.mktemp("lab"), ("controller.time_limit=1",)))


def found(log: RawLog) -> list[str]:
    """Return the fields of what contradicts the records, without computing decisions again."""
    trial = trial_of(log)
    return [difference.field for difference in result_differences(trial, trial.result)]


def with_records(log: RawLog, changes: dict[int, list[Entry]]) -> RawLog:
    """Return a log with other records in the place of some, by their index."""
    records = [
        record
        for index, original in enumerate(log.records)
        for record in changes.get(index, [original])
    ]
    return RawLog(log.path, records=records, channels=log.channels, library=log.library)


def edited(log: RawLog, index: int, edit: Edit) -> list[Entry]:
    """Return the message `index` of /run after an edit."""
    entry = log.records[index]
    message = Run.FromString(entry.data)
    edit(message)
    return [entry._replace(data=message.SerializeToString())]


def indices(log: RawLog, topic: str) -> list[int]:
    """Return where the messages of a topic are."""
    return [i for i, r in enumerate(log.records) if isinstance(r, Entry) and r.topic == topic]


def test_an_honest_log_has_nothing_wrong(log):
    assert found(log) == []
    assert verify(log.path).problems == ()


def as_real(run: Run) -> None:
    """Take from a run the fact that names its emulated devices."""
    facts = [(fact.key, fact.value) for fact in run.facts if fact.key != "emulated"]
    del run.facts[:]
    for key, value in facts:
        run.facts.add(key=key, value=value)


def test_an_emulated_trial_cannot_pass_for_one_of_a_lab(log):
    """Regression: with one fact of /run removed, and digests made to fit, `verify` said ok, and
    tables were of a lab. Here the devices still say that they are emulated."""
    changes = {index: edited(log, index, as_real) for index in indices(log, RUN)}
    assert found(with_records(log, changes)) == ["run.facts.emulated"]


def test_the_spec_decides_what_a_trial_of_plant_emulated_is_called(log):
    experiment = trial_of(log).experiment
    lab = trial_of(log).start.plant
    plant = experiment.plant.model_copy(update={"type": "emulated"})
    bare = type(lab)(lab.kind, False, lab.camera_rate_hz, {})
    emulated = experiment.model_copy(update={"plant": plant})
    assert Origin.from_spec(emulated, bare) is Origin.EMULATED
    assert Origin.from_spec(experiment, bare) is Origin.LAB
    assert read_result(log.path).origin is Origin.EMULATED
