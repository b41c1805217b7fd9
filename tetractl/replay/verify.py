"""Verifies a log: checks that its records agree, and repeats its simulation and every decision.

Messages for viewers are computed from the records of the trial: the decoded records are encoded
again by the log writer's encoder, and every message and its times must have the same bytes. If
another machine or version wrote the log, numbers must agree within the tolerance `NEARLY`, and the
arena may be drawn differently.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from tetractl.core.errors import printable
from tetractl.experiment.load import resolved_yaml
from tetractl.experiment.registry_fields import packages
from tetractl.log import provenance
from tetractl.log.format import channels, layout
from tetractl.log.format.channels import CHANNELS, TEXT, Entry
from tetractl.log.format.codec import Frames
from tetractl.log.format.metadata import WARNINGS
from tetractl.log.format.scene import decode_note, encode_note
from tetractl.log.format.tetractl_pb2 import CameraFrames
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.messages import Messages
from tetractl.replay.audit import audit
from tetractl.replay.difference import EXACT, Difference, Tolerance, first_difference
from tetractl.replay.film_check import FilmCheck
from tetractl.replay.recompute import TOLERANCE, first_steps, recompute
from tetractl.replay.resimulate import resimulate

NEARLY = Tolerance(1e-9, 1e-9)
DRAWN = frozenset({channels.SCENE, channels.SCENE_PLAN})
"""Topics whose messages earlier versions may have drawn differently."""


def derived_differences(raw: RawLog, log: TrialLog, same_host: bool) -> Iterator[Difference]:
    """Yield the first difference in each topic, and differences in the operator messages that
    follow from the records; nothing for a damaged log.
    """
    if log.damage:
        return
    called_for: list[Entry] = []  # the required messages of /log
    yield from _messages(raw, log, same_host, called_for)
    yield from _operator_messages(raw, log, called_for)
    if not same_host:
        return
    for name, text in (
        (channels.RESOLVED_SPEC, resolved_yaml(log.experiment)),
        (channels.LAYOUT, layout.layout(log.start.setup)),
    ):
        if raw.text(name) != text:
            yield Difference(None, name, "differs from the experiment's")
    for name in (channels.SPEC, channels.ENVIRONMENT):
        if name not in raw.attachments:
            yield Difference(None, name, "missing")


def _messages(
    raw: RawLog, log: TrialLog, same_host: bool, called_for: list[Entry]
) -> Iterator[Difference]:
    """Compare the messages of all topics except /log and the film, one at a time to save memory.

    Messages encoded for /log are appended to `called_for`.
    """
    others = {channels.LOG, *channels.FILM}  # `FilmCheck` checks the film
    left = {topic: iter(raw.by_topic[topic]) for topic in CHANNELS.keys() - others}
    count, until = dict.fromkeys(left, 0), time.thread_time() + limits.seconds_limit()
    for made in _encoded(raw, log):
        if time.thread_time() > until:
            text = f"not encoded again: it would take over {limits.seconds_limit():g} s"
            yield Difference(None, made.topic, f"{text}; {limits.FACTOR}=2 allows twice as much")
            return
        if made.topic == channels.LOG:
            called_for.append(made)
        if made.topic not in left:  # a difference was reported already
            continue
        entry, number = next(left[made.topic], None), count[made.topic]
        count[made.topic] += 1
        if entry == made:
            continue
        if (difference := _entry_difference(made, entry, number, same_host)) is not None:
            yield difference
            del left[made.topic]
    for topic, rest in left.items():
        if next(rest, None) is not None:
            yield Difference(None, topic, f"has more than the {count[topic]} messages of the trial")


def _encoded(raw: RawLog, log: TrialLog) -> Iterator[Entry]:
    """Yield the encoded messages of a trial, in order within a topic; for /log only those that
    follow from the records.

    Camera frames are grouped into messages as in the log, since nothing else states how the log
    writer grouped them.
    """
    messages = Messages(log.start)
    yield from messages.start()
    begin = 0
    frames = Frames(log.frames, log.mocap_ns, log.received_ns, log.mocap, log.valid, log.truth)
    yield from messages.tracking(frames)
    for entry in raw.by_topic[channels.FRAMES]:
        end = begin + len(CameraFrames.FromString(entry.data).frame)
        if begin < end:
            yield from messages.block(frames.part(slice(begin, end)))
        begin = end
    for step in log.steps:
        yield from (entry for entry in messages.step(step) if entry.topic != channels.COMMANDS)
    for command in log.commands:
        if command is log.stop and log.result:
            yield from messages.stop(command, log.result)
        else:
            yield messages.command(command)


def _entry_difference(
    made: Entry, entry: Entry | None, number: int, same_host: bool
) -> Difference | None:
    name = f"{made.topic}[{number}]"
    if entry is None:
        return Difference(None, name, "missing")
    if entry[1:3] != made[1:3]:
        return Difference(None, name, f"has the times {entry[1:3]}, not {made[1:3]}")
    if not same_host and made.topic in DRAWN:
        return None
    try:
        ours, logged = (CHANNELS[made.topic].FromString(one.data) for one in (made, entry))
    except DecodeError:
        return Difference(None, name, "not a valid message of its channel")
    found = first_difference(ours, logged, EXACT if same_host else NEARLY)
    if found is None:
        return Difference(None, name, "has other bytes") if same_host else None
    return Difference(None, f"{name}.{found[0]}", found[1])


def _operator_messages(
    raw: RawLog, log: TrialLog, called_for: Sequence[Entry]
) -> Iterator[Difference]:
    """Check that /log has the messages that follow from the records, as tetractl writes them."""
    begin = log.start.start_unix_ns
    for number, entry in enumerate(raw.by_topic[channels.LOG]):
        note = decode_note(Log.FromString(entry.data), begin)
        stamp = begin + note.t_ns
        made = Entry(entry.topic, stamp, stamp, encode_note(note, begin).SerializeToString())
        if entry != made:
            yield Difference(
                None, f"{channels.LOG}[{number}]", "differs from the message that tetractl writes"
            )
            break
    notes = (decode_note(Log.FromString(entry.data), begin) for entry in called_for)
    shown = (replace(note, text=printable(note.text, TEXT)) for note in notes)
    logged = Counter(log.notes)
    for note in (Counter(shown) - logged).elements():
        yield Difference(None, "log", f"/log lacks {note.text!r} at {note.t_ns} ns")
        break
    if len(logged) < len(log.notes):
        note, _ = logged.most_common(1)[0]
        yield Difference(None, "log", f"/log has {note.text!r} twice at {note.t_ns} ns")
    stated = raw.metadata[channels.RESULT].get(WARNINGS)
    warnings = sum(note.level in ("warning", "error") for note in log.notes[:-1])
    if stated is not None and stated != str(warnings):
        text = f"states {stated}, but /log has {warnings}"
        yield Difference(None, f"result.{WARNINGS}", text)


DECIDES_BITS = (
    "cpu",
    "cpu_target",
    "cpu_features",
    "numba_settings",
    "numpy_dispatch",
    "code",
    "python",
    "numpy",
    "numba",
    "llvmlite",
)
"""Facts of a host that must agree for results with the same bits."""


class Method(StrEnum):
    """How the decisions of a log are checked; see `recompute`."""

    RECOMPUTED = "re-computed, bit-identical"
    REEVALUATED = f"costs of the logged plans re-evaluated, to {TOLERANCE:g}"


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying one log.

    `method` is REEVALUATED only if `elsewhere` names differences between the host that wrote the
    log and this one. `checked` is the number of steps whose repeated decision agrees with the log.
    """

    path: str
    steps: int
    checked: int
    method: Method
    elsewhere: tuple[str, ...]
    problems: tuple[Difference, ...]  # the first decision that differs comes first
    notes: tuple[str, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether no problem was found."""
        return not self.problems


def verify(path: Path) -> Verification:
    """Verify one log; raises LogError as `read_trial` does."""
    began = time.perf_counter()
    raw = scan(path)
    log = trial_of(raw)
    elsewhere = host_differences(log)
    findings = audit(log, same_host=not elsewhere)
    simulated = resimulate(log, same_host=not elsewhere)
    derived = derived_differences(raw, log, same_host=not elsewhere)
    film = FilmCheck(raw, log, same_host=not elsewhere)
    shown = tuple(film.differences())
    method, found = Method.RECOMPUTED, recompute(log, search_again=True)
    if found and elsewhere:
        method, found = Method.REEVALUATED, recompute(log, search_again=False)
    known = len(first_steps(log))
    checked = found.step if found and found.step is not None else known
    return Verification(
        path=str(path),
        steps=len(log.steps),
        checked=checked,
        method=method,
        elsewhere=elsewhere,
        problems=(*filter(None, (found, simulated)), *findings.problems, *derived, *shown),
        notes=(*findings.notes, *film.notes),
        seconds=time.perf_counter() - began,
    )


def host_differences(log: TrialLog) -> tuple[str, ...]:
    """Return the differences between the log's host and this one that may change bits, one per
    line.
    """
    used = provenance.plugins(packages(log.experiment))
    here = provenance.host() | provenance.versions() | used
    there = log.host | log.provenance
    return tuple(
        _difference(key, there.get(key), here.get(key))
        for key in (*DECIDES_BITS, *used)
        if here.get(key) != there.get(key)
    )


def _difference(key: str, there: str | None, here: str | None) -> str:
    """Return a text on the fact `key`, which differs between the log's host (`there`) and this one
    (`here`); of a list, only the words that differ.
    """
    if there is not None and here is not None and key in provenance.LISTS:
        ours, theirs = set(here.split()), set(there.split())
        only = (" ".join(sorted(words)) or "no more" for words in (theirs - ours, ours - theirs))
        return "{}: {} on the log's host, {} on this one".format(key, *only)
    return f"{key}: {there or 'unknown'} on the log's host, {here or 'unknown'} on this one"
