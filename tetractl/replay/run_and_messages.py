"""Compares what a log states of its run, and its messages for the operator, with its other records.

The record of the run follows from the resolved spec, seed, trial and start; facts of devices do
not, but for `halts` and `emulated`. A trial of the plant `emulated`, and one of devices that name
themselves emulated, must say so. Of the messages these follow from other records:

    NAME is lost, NAME is tracked again    the camera frames
    NAME did not get the command ...       the control steps
    the model does not fit, ...            the estimates in the control steps, by the same code
    the last one                           the result

The result states how many warnings there are, so that none of the others can be left out alone.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from tetractl.core.commands import EMULATED_DEVICES, EMULATED_NAME, EMULATED_PLANT, Note
from tetractl.core.errors import printable
from tetractl.core.trial import Result
from tetractl.log.format.channels import FRAMES, RUN, TEXT, TRANSFORMS
from tetractl.log.format.run_records import encode_run
from tetractl.log.format.tetractl_pb2 import Run
from tetractl.log.provenance import CODE
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import end_text, tracking_texts, undelivered_texts
from tetractl.replay.comparison import Difference, first_difference
from tetractl.run.model_news import ModelNews, stated_model
from tetractl.run.task import code_of


def run_differences(raw: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield how the records of the run contradict the resolved spec and one another."""
    start = log.start
    plant = replace(start.plant, kind=log.experiment.plant.type)
    expected = encode_run(replace(start, plant=plant))
    for entry in raw.by_topic[RUN]:
        difference = first_difference(expected, Run.FromString(entry.data), name="run")
        if difference is not None:
            yield difference
    began_ns = raw.by_topic[RUN][0].log_ns
    if began_ns != start.start_unix_ns:
        text = f"states {start.start_unix_ns}, but its record is of {began_ns}"
        yield Difference(None, "run.start_unix_ns", text)
    facts = start.plant.facts
    says_so = any(EMULATED_NAME in value for value in facts.values())
    if (plant.kind == EMULATED_PLANT or says_so) and not facts.get(EMULATED_DEVICES):
        text = "does not say which devices are emulated"
        yield Difference(None, f"run.facts.{EMULATED_DEVICES}", text)


def frame_differences(raw: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield that the two copies of a lab's camera frames, of one message each, do not have the same
    times. A camera may slow down amid a trial, so its rate is not compared with that of frames."""
    times = [(entry.log_ns, entry.publish_ns) for entry in raw.by_topic[FRAMES]]
    copied = [(entry.log_ns, entry.publish_ns) for entry in raw.by_topic[TRANSFORMS]]
    if len(times) != len(log.frames) or times != copied:
        text = f"{len(log.frames)} on {FRAMES}, but {len(copied)} on {TRANSFORMS}, or other times"
        yield Difference(None, "frames", text)


def message_differences(raw: RawLog, log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield how messages for the operator contradict the other records of an undamaged log."""
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
    news = ModelNews(stated_model(log.experiment))
    for step in log.steps:
        t_ns = step.command.sent_ns
        for text in undelivered_texts(setup.names, step):
            yield _note(t_ns, "warning", text)
        if is_same_code and step.plan.estimate is not None:
            for level, text in news.of(step.plan.estimate, setup, t_ns):
                yield _note(t_ns, level, text)


def _note(t_ns: int, level: str, text: str) -> Note:
    """Return a message as it is read from a log."""
    return Note(t_ns, level, printable(text, TEXT))
