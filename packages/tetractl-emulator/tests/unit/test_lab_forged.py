"""What `verify` notices of the log of an emulated lab that was forged so that all digests fit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from support.lab_logs import lab_log
from support.mutate import rewrite, stating

from tetractl.log.format.channels import (
    COMMANDS,
    FRAMES,
    LOG,
    RESULT,
    RUN,
    SCENE,
    STEP,
    TRANSFORMS,
    Entry,
)
from tetractl.log.format.tetractl_pb2 import Run, WheelCommand
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import read_result, trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import Origin
from tetractl.replay.lab_commands import command_differences
from tetractl.replay.lab_result import lab_differences
from tetractl.replay.run_and_messages import encoding_differences, message_differences
from tetractl.replay.verify import verify

pytestmark = pytest.mark.system

Edit = Callable[[Any], None]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A lab on the radio's wires, of which 30 % of the commands are lost."""
    return scan(lab_log(tmp_path_factory.mktemp("lab"), ("controller.time_limit=1",)))


def found(log: RawLog) -> list[str]:
    """Return the fields of what contradicts the records, without computing decisions again."""
    trial = trial_of(log)
    differences = [
        *command_differences(trial, trial.result),
        *encoding_differences(log, trial, trial.result),
        *message_differences(log, trial, trial.result),
    ]
    return [difference.field for difference in differences]


def with_records(log: RawLog, changes: dict[int, list[Entry]]) -> RawLog:
    """Return a log with other records in the place of some, by their index."""
    records = [
        record
        for index, original in enumerate(log.records)
        for record in changes.get(index, [original])
    ]
    return RawLog(log.path, records=records, channels=log.channels, library=log.library)


def edited(log: RawLog, index: int, edit: Edit) -> list[Entry]:
    """Return the message `index` of /commands, /run or /log after an edit."""
    entry = log.records[index]
    message = {COMMANDS: WheelCommand, RUN: Run, LOG: Log}[entry.topic].FromString(entry.data)
    edit(message)
    return [entry._replace(data=message.SerializeToString())]


def indices(log: RawLog, topic: str) -> list[int]:
    """Return where the messages of a topic are."""
    return [i for i, r in enumerate(log.records) if isinstance(r, Entry) and r.topic == topic]


def repeats(log: RawLog) -> list[int]:
    """Return where the commands between control steps are."""
    trial = trial_of(log)
    decided = {step.command.sent_ns for step in trial.steps}
    between = []
    for index in indices(log, COMMANDS):
        command = WheelCommand.FromString(log.records[index].data)
        if command.sent_ns not in decided and not command.stop:
            between.append(index)
    return between


def test_an_honest_log_has_nothing_wrong(log):
    assert len(repeats(log)) > 10
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
    assert Origin.of(emulated, bare) is Origin.EMULATED
    assert Origin.of(experiment, bare) is Origin.LAB
    assert read_result(log.path).origin is Origin.EMULATED


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("run_id", "x"),
        ("name", "x"),
        ("seed", 8),
        ("trial", 1),
        ("spec_hash", "x"),
        ("robots", ["green", "blue", "yellow"]),
        ("start_unix_ns", 5),
        ("plant", "x"),
    ],
)
def test_each_field_of_a_run_is_compared(log, tmp_path, field, value):
    """Regression: none of these was noticed of a lab's log."""
    path = rewrite(log, tmp_path / "forged.mcap", stating(log, RUN, **{field: value}))
    assert any(name.startswith("/run[0]") for name in found(scan(path)))


def negated(command: WheelCommand) -> None:
    command.left[0] *= -1


def turned_round(command: WheelCommand) -> None:
    left = list(command.left)
    command.left[:] = command.right
    command.right[:] = left


def further(command: WheelCommand) -> None:
    command.direction += 1e-9


# a robot that hardly turns has almost equal wheels, and one that turns at its rate may have such
# speeds as a wheel that is negated gives
@pytest.mark.parametrize(("edit", "share"), [(negated, 0.9), (turned_round, 0.2), (further, 1.0)])
def test_commands_between_steps_are_those_of_the_last_step(log, edit, share):
    """Regression: a negated wheel was noticed in 1 of 15 of them."""
    between = repeats(log)[3:]
    noticed = [bool(found(with_records(log, {i: edited(log, i, edit)}))) for i in between]
    assert len(noticed) > 12
    assert sum(noticed) >= share * len(noticed)


def test_a_stop_is_sent_ten_times(log):
    last = indices(log, COMMANDS)[-3]
    assert found(with_records(log, {last: []})) == ["commands"]


def test_a_frame_cannot_be_left_out_in_one_copy(log):
    index = indices(log, FRAMES)[20]
    assert found(with_records(log, {index: []})) == ["/tf[20]"]


@pytest.mark.parametrize("topic", [COMMANDS, FRAMES, LOG, RESULT, RUN, STEP, SCENE, TRANSFORMS])
@pytest.mark.parametrize("change", [{"log_ns": 1}, {"publish_ns": 1}, {"data": b"\xf8\x3e\x01"}])
def test_times_and_bytes_of_a_record_follow_from_its_values(log, topic, change):
    """Regression: of a lab none of these was noticed, nor a changed copy in /tf."""
    index = indices(log, topic)[-1]
    entry = log.records[index]
    fields = {name: getattr(entry, name) + more for name, more in change.items()}
    assert found(with_records(log, {index: [entry._replace(**fields)]}))


def test_a_least_distance_is_that_of_a_frame(log, tmp_path):
    """Regression: any distance between two that the frames show was taken."""
    result = log.result
    for name in ("clearance", "edge", "apart"):
        stated = [1e-9 + value for value in getattr(result.verdict, name)]
        forged = scan(rewrite(log, tmp_path / name, stating(log, RESULT, **{name: stated})))
        trial = trial_of(forged)
        fields = [difference.field for difference in lab_differences(trial, trial.result)]
        assert f"result.{name}.0" in fields


@pytest.mark.parametrize("every", [1, 2, 6])
def test_commands_come_at_the_actuators_rate(log, every):
    """Regression: every second command could be left out."""
    changes = {index: [] for index in repeats(log)[2::every]}
    assert found(with_records(log, changes)) == ["commands"]


def test_a_computer_on_which_control_steps_are_late_repeats_late(log):
    """Regression: honest trials on a busy computer had up to a third of late repetitions, and were
    called false."""
    trial = trial_of(with_records(log, {index: [] for index in repeats(log)[2::2]}))
    control = trial.experiment.controller
    for share_of_period, fields in ((1.0, ["commands"]), (0.5, [])):
        stated = control.model_copy(update={"period": control.period * share_of_period})
        experiment = trial.experiment.model_copy(update={"controller": stated})
        differences = command_differences(replace(trial, experiment=experiment), trial.result)
        assert [difference.field for difference in differences] == fields


def lost_robot(run: Log) -> None:
    run.message = "green is lost"
    run.level = Log.WARNING


def test_warnings_are_counted_and_the_last_message_is_the_end(log, tmp_path):
    """Regression: neither `warnings` of a lab's result nor the messages were compared."""
    stated = log.warnings
    path = rewrite(log, tmp_path / "count.mcap", stating(log, RESULT, warnings=stated + 1))
    assert found(scan(path)) == ["result.warnings"]
    messages = indices(log, LOG)
    added = {messages[0]: edited(log, messages[0], lost_robot)}
    assert found(with_records(log, added)) == ["result.warnings"]
    assert found(with_records(log, {messages[-1]: []})) == ["log"]
