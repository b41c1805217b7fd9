"""Compares what a log states of its run, and its messages for the operator, with its other records.

The messages of a lab's log are encoded again from the values that were read of them, of the record
of the run from the resolved spec: so copies of a value agree, and times follow from contents. Facts
of devices follow from nothing, but for `halts` and `emulated`: a trial of the plant `emulated`, and
one of devices that name themselves emulated, must say so. Of the messages for the operator these
follow from other records:

    NAME is lost, NAME is tracked again    the camera frames
    NAME did not get the command ...       the control steps
    the model does not fit, ...            the estimates in the control steps, by the same code
    the last one                           the result

The result states how many warnings there are, so that none of the others can be left out alone.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from tetractl.core.errors import printable
from tetractl.core.protocols import EMULATED_NAME
from tetractl.core.trial import EMULATED_DEVICES, EMULATED_PLANT, Note, Result, Start
from tetractl.log.format.channels import (
    BACKGROUND,
    LAYOUT,
    LOG,
    PICTURE,
    RUN,
    SCENE,
    SCENE_PLAN,
    TEXT,
    TRANSFORMS,
    WRITER,
    Entry,
)
from tetractl.log.format.run_records import encode_run
from tetractl.log.format.scene import encode_note
from tetractl.log.format.tetractl_pb2 import Run
from tetractl.log.provenance import CODE
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import Encoder, end_text, tracking_texts, undelivered_texts
from tetractl.replay.comparison import Difference, first_difference, log_differences
from tetractl.replay.run_again import Recorder
from tetractl.run.model_changes import ModelMonitor, stated_model
from tetractl.run.task import code_of


def run_differences(raw: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield how a simulation's records of the run contradict the resolved spec and one another."""
    expected = encode_run(_start_by_spec(log))
    for entry in raw.by_topic[RUN]:
        difference = first_difference(expected, Run.FromString(entry.data), name="run")
        if difference is not None:
            yield difference
    began_ns = raw.by_topic[RUN][0].log_ns
    if began_ns != log.start.start_unix_ns:
        text = f"states {log.start.start_unix_ns}, but its record is of {began_ns}"
        yield Difference(None, "run.start_unix_ns", text)


def encoding_differences(raw: RawLog, log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield how the messages of an undamaged lab's log differ from those that its own values give
    when they are encoded again, in each channel but /log and the camera's own; in what viewers
    draw only if this code wrote the log."""
    plant = log.start.plant
    says_so = any(EMULATED_NAME in value for value in plant.facts.values())
    is_emulated = log.experiment.plant.type == EMULATED_PLANT or says_so
    if is_emulated and not plant.facts.get(EMULATED_DEVICES):
        text = "does not say which devices are emulated"
        yield Difference(None, f"run.facts.{EMULATED_DEVICES}", text)
    sink = Recorder(math.inf)
    encoder = Encoder(sink, real_time=True)
    encoder.on_start(_start_by_spec(log))
    samples = [log.sample(row) for row in range(len(log.frames))]
    encoder.on_samples(samples)
    steps = {step.command.sent_ns: step for step in log.steps}
    rows = {sampled_ns: row for row, sampled_ns in enumerate(log.mocap_ns.tolist())}
    for command in log.commands:
        step = steps.get(command.sent_ns)
        if command is log.stop:
            encoder.warnings = raw.warnings
            encoder.on_stop(command, result)
        elif step is not None:
            row = rows.get(step.observation.sampled_ns)
            observation = step.observation if row is None else log.sample(row).observation
            encoder.on_step(replace(step, observation=observation))
        else:
            encoder.on_command(command)
    again = RawLog(raw.path, records=sink.records, library=WRITER)
    apart = {LOG, PICTURE, BACKGROUND}
    if log.facts.get(CODE) != code_of(log.experiment):
        apart |= {SCENE, SCENE_PLAN, TRANSFORMS, LAYOUT}
    yield from log_differences(again, raw, apart)


def _start_by_spec(log: TrialLog) -> Start:
    """Return the start of a trial with the plant that its resolved spec names."""
    plant = replace(log.start.plant, kind=log.experiment.plant.type)
    return replace(log.start, plant=plant)


def message_differences(raw: RawLog, log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield how messages for the operator contradict the other records of an undamaged log."""
    start_ns = log.start.start_unix_ns
    for entry, note in zip(raw.by_topic[LOG], log.notes, strict=True):
        t_ns = start_ns + note.t_ns
        if entry != Entry(LOG, t_ns, t_ns, encode_note(note, start_ns).SerializeToString()):
            yield Difference(None, "log", f"the record of {note.text!r} has other times or bytes")
            return
    end = _note(0 if log.stop is None else log.stop.sent_ns, *end_text(result))
    warnings = sum(note.level in ("warning", "error") for note in log.notes if note != end)
    if warnings != raw.warnings:
        text = f"states {raw.warnings}, but {warnings} are on /log"
        yield Difference(None, "result.warnings", text)
    logged = set(log.notes)
    for note in (*_of_frames(log), *_of_steps(log), end):
        if note not in logged:
            yield Difference(None, "log", f"lacks the message {note.text!r}")
            return


def _of_frames(log: TrialLog) -> Iterator[Note]:
    """Yield the messages on robots that were lost and found."""
    names = log.start.setup.names
    tracked = [(True,) * len(names), *map(tuple, log.valid.tolist())]
    for (before, now), t_ns in zip(pairwise(tracked), log.received_ns.tolist(), strict=True):
        for level, text in tracking_texts(names, before, now):
            yield _note(t_ns, level, text)


def _of_steps(log: TrialLog) -> Iterator[Note]:
    """Yield the messages on commands that were not delivered and, if this code wrote the log, those
    on a model that does not fit."""
    setup = log.start.setup
    is_same_code = log.facts.get(CODE) == code_of(log.experiment)
    news = ModelMonitor(stated_model(log.experiment))
    for step in log.steps:
        t_ns = step.command.sent_ns
        for text in undelivered_texts(setup.names, step):
            yield _note(t_ns, "warning", text)
        if is_same_code and step.plan.estimate is not None:
            for level, text in news.notices(step.plan.estimate, setup, t_ns):
                yield _note(t_ns, level, text)


def _note(t_ns: int, level: str, text: str) -> Note:
    """Return a message as it is read from a log."""
    return Note(t_ns, level, printable(text, TEXT))
