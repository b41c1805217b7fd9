"""Tests of comparing the log of a trial with the log of the same trial run again."""

from dataclasses import replace

import pytest
from testkit.random_trials import trial, write

from tetractl.log.format.channels import (
    COMMANDS,
    ENVIRONMENT,
    FRAMES,
    HOST,
    HOST_TIMING,
    RESOLVED_SPEC,
    RESULT,
    STEP,
    Entry,
)
from tetractl.log.format.tetractl_pb2 import ControllerStep
from tetractl.log.format.tetractl_pb2 import Result as ResultMessage
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.salvage import scan
from tetractl.verification.log_comparison import log_differences


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    made = trial(steps=4, robots=2, frames=2, first=2, iterations=3, length=3)
    return scan(write(made, tmp_path_factory.mktemp("log") / "trial.mcap"))


def with_records(log, change):
    """The log with each record replaced by what `change` returns, or left out for None."""
    changed = [change(record) for record in log.records]
    return RawLog(log.path, records=[record for record in changed if record is not None])


def with_entry(log, topic, number, **fields):
    """The log with some fields of one message of a topic replaced."""
    entry = log.entries_by_topic[topic][number]
    return with_records(log, lambda r: entry._replace(**fields) if r is entry else r)


def without_entry(log, topic, number):
    entry = log.entries_by_topic[topic][number]
    return with_records(log, lambda record: None if record is entry else record)


def step_with(log, number, **fields):
    """The log with some fields of the message of a control step replaced."""
    message = ControllerStep.FromString(log.entries_by_topic[STEP][number].data)
    for name, value in fields.items():
        setattr(message, name, value)
    return with_entry(log, STEP, number, data=message.SerializeToString())


def found(again, log):
    """Step, field and message of each difference."""
    return [(d.step, d.field, d.message) for d in log_differences(again, log)]


def test_a_log_does_not_differ_from_itself(log):
    assert found(log, log) == []


def test_a_changed_step_is_named_with_its_number_and_field(log):
    ((step, field, message),) = found(log, step_with(log, 2, cost=1.5))
    assert (step, field) == (2, "cost")
    assert message.startswith("logged 1.5, computed ")


def test_a_changed_field_outside_of_steps_is_named_by_its_channel_and_message(log):
    message = ResultMessage.FromString(log.entries_by_topic[RESULT][0].data)
    message.total_error += 1
    changed = with_entry(log, RESULT, 0, data=message.SerializeToString())
    ((step, field, _),) = found(log, changed)
    assert (step, field) == (None, f"{RESULT}[0].total_error")


@pytest.mark.parametrize("number", [0, 3])
def test_a_message_that_the_log_lacks_is_missing_at_the_end_of_its_channel(log, number):
    """The messages behind it move up, and the first of them is the difference."""
    differences = found(log, without_entry(log, COMMANDS, number))
    assert [field.partition("[")[0] for _, field, _ in differences] == [COMMANDS]
    last = len(log.entries_by_topic[COMMANDS]) - 1
    assert found(log, without_entry(log, COMMANDS, last)) == [
        (None, f"{COMMANDS}[{last}]", "missing")
    ]


def test_a_message_that_only_the_log_has_does_not_belong_to_the_trial(log):
    last = len(log.entries_by_topic[FRAMES]) - 1
    assert found(without_entry(log, FRAMES, last), log) == [
        (None, f"{FRAMES}[{last}]", "does not belong to this trial")
    ]


@pytest.mark.parametrize("field", ["log_ns", "publish_ns"])
def test_each_of_the_two_times_of_a_message_has_to_agree(log, field):
    entry = log.entries_by_topic[COMMANDS][1]
    times = {"log_ns": entry.log_ns, "publish_ns": entry.publish_ns}
    changed = times | {field: times[field] + 1}
    expected = (
        f"has the times {tuple(changed.values())} instead of {(entry.log_ns, entry.publish_ns)}"
    )
    assert found(log, with_entry(log, COMMANDS, 1, **changed)) == [
        (None, f"{COMMANDS}[1]", expected)
    ]


def test_bytes_that_no_field_shows_differ_and_bytes_that_are_no_message_are_named(log):
    unknown_field = log.entries_by_topic[STEP][1].data + b"\xf8\x3e\x01"
    assert found(log, with_entry(log, STEP, 1, data=unknown_field)) == [
        (1, f"{STEP}[1]", "has other bytes")
    ]
    ((step, field, message),) = found(log, with_entry(log, STEP, 1, data=b"\xff"))
    assert (step, field) == (None, f"{STEP}[1]")
    assert "not a valid message" in message


def test_only_the_first_difference_of_a_channel_is_told_and_steps_come_first(log):
    changed = step_with(step_with(log, 1, cost=1.5), 3, cost=1.5)
    changed = without_entry(changed, FRAMES, 0)
    changed = without_entry(changed, COMMANDS, len(log.entries_by_topic[COMMANDS]) - 1)
    steps = [step for step, _, _ in found(log, changed)]
    assert steps == [1, None, None]


@pytest.mark.parametrize("topic", [HOST, HOST_TIMING])
def test_records_of_the_host_are_not_compared(log, topic):
    changed = with_entry(log, topic, 0, log_ns=17, data=b"")
    assert found(log, changed) == found(changed, log) == []


def with_attachment(log, name, data):
    """The log with other contents of an attachment, or without it for None."""

    def change(record):
        if isinstance(record, Entry) or record.name != name:
            return record
        return None if data is None else replace(record, data=data)

    return with_records(log, change)


def test_attachments_of_the_trial_have_to_be_in_the_log_and_equal(log):
    assert found(log, with_attachment(log, RESOLVED_SPEC, None)) == [
        (None, RESOLVED_SPEC, "missing")
    ]
    assert found(log, with_attachment(log, RESOLVED_SPEC, b"other")) == [
        (None, RESOLVED_SPEC, "differs from the experiment's")
    ]


def test_attachments_of_the_host_and_of_other_programs_are_not_compared(log):
    assert ENVIRONMENT in log.attachments
    assert found(log, with_attachment(log, ENVIRONMENT, None)) == []
    assert found(with_attachment(log, RESOLVED_SPEC, None), log) == []
