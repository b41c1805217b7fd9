"""Verifies a log: runs its trial again from spec, seed and logged frames, and compares the records.

Each decision is computed again (`recompute`), and with the plans in the log the trial is repeated
(`repeat`): the log writer's encoder makes every record again, and each must have the same bytes and
times as in the log (`comparison`). If another machine or version wrote the log, numbers must agree
within a tolerance, and the arena may be drawn differently.
"""

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from google.protobuf.message import DecodeError

from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome
from tetractl.experiment.registry_fields import packages
from tetractl.log import provenance
from tetractl.log.format import channels
from tetractl.log.format.channels import Entry
from tetractl.log.read import limits
from tetractl.log.read.raw_log import ALTERED, RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog, frame_gaps, step_gaps
from tetractl.replay.comparison import (
    SAME_BITS,
    Comparison,
    Difference,
    Tolerance,
    TooLongError,
    first_difference,
)
from tetractl.replay.file_check import file_differences
from tetractl.replay.lab_checks import lab_differences
from tetractl.replay.recompute import TOLERANCE, first_steps, recompute
from tetractl.replay.repeat import Repetition, give_again, simulate

NEARLY = Tolerance(1e-9, 1e-9)
"""Tolerance for the records of another processor that follow from other records."""
ROUGHLY = Tolerance(1e-6, 1e-6)
"""Tolerance for the simulation of another processor, since a sine may differ in its last bit."""


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
DECIDES_BYTES = ("tetractl", "git_commit", "mcap", "protobuf", "zstandard")
"""Facts that must also agree for files with the same bytes."""


class Method(StrEnum):
    """How the decisions of a log are checked; see `recompute`."""

    RECOMPUTED = "re-computed, bit-identical"
    REEVALUATED = f"costs of the logged plans re-evaluated, to {TOLERANCE:g}"


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying one log.

    `rewritten` is the program that wrote the file again from a log of tetractl, "" if none did.
    `method` is REEVALUATED only if `elsewhere` names differences between the host that wrote the
    log and this one. `checked` is the number of steps whose repeated decision agrees with the log.
    """

    path: str
    rewritten: str
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
    method, found = Method.RECOMPUTED, recompute(log, search_again=True)
    if found and elsewhere:
        method, found = Method.REEVALUATED, recompute(log, search_again=False)
    others = [*differences(raw, log)]
    if others and elsewhere:
        tolerance = ROUGHLY if log.start.plant.simulated else NEARLY
        others = [*differences(raw, log, tolerance)]
    known = len(first_steps(log))
    lost = [f"missing: {gap}" for gap in frame_gaps(log)]
    notes = lost if log.experiment.plant.loses_frames and not log.damage else []
    missing = [Difference(None, "frames", text) for text in lost if not notes]
    if raw.reordered:
        notes = [*notes, "the content digest is of another order of the messages: not compared"]
    file = [Difference(None, "file", text) for text in _file(raw, log, bool(elsewhere))]
    return Verification(
        path=str(path),
        rewritten=(raw.library or "an unknown program") if raw.rewritten else "",
        steps=len(log.steps),
        checked=found.step if found and found.step is not None else known,
        method=method,
        elsewhere=elsewhere,
        problems=(
            *([found] if found else []),
            *others,
            *missing,
            *_damage(raw, log),
            *file,
        ),
        notes=tuple(notes),
        seconds=time.perf_counter() - began,
    )


def _damage(raw: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield the damage of a log, the control steps it lacks and the digests that do not match."""
    for gap in step_gaps(log):
        yield Difference(gap.first, "k", f"missing: {gap}")
    if raw.altered:
        yield Difference(None, "content_digest", ALTERED)
    if log.damage:
        for text in (*log.damage.problems, *(f"lost: {lost}" for lost in log.damage.lost)):
            yield Difference(None, "damage", text)
    elif raw.host_altered:
        text = "the records of the host do not match the digest that the log states"
        yield Difference(None, "host_digest", text)


def _file(raw: RawLog, log: TrialLog, elsewhere: bool) -> Iterator[str]:
    """Yield what in the file of an undamaged log is not as tetractl writes it."""
    if not log.damage:
        here = provenance.versions()
        same = all(here.get(key) == log.facts.get(key) for key in DECIDES_BYTES)
        yield from file_differences(raw, same and not elsewhere)


def _host(raw: RawLog, log: TrialLog, stop: Command) -> Iterator[Difference]:
    """Yield what is wrong in how the host is described; nothing repeats what is said of it."""
    begin = log.start.start_unix_ns
    for topic, at_ns in ((channels.HOST, begin), (channels.HOST_END, begin + stop.sent_ns)):
        made = list[Entry]()
        with suppress(DecodeError):  # then fewer are made
            for message in raw.messages(topic):
                message.DiscardUnknownFields()
                made.append(Entry(topic, at_ns, at_ns, message.SerializeToString()))
        if len(made) != 1 or made != raw.by_topic[topic]:
            yield Difference(None, topic, "is not the one message that tetractl writes")
    used = provenance.plugins(packages(log.experiment))
    known = {"started", "pid", *provenance.host(), *provenance.VERSION_KEYS, *used}
    if others := log.facts.keys() - known:
        yield Difference(None, channels.HOST, f"states the unknown {min(others)!r}")


def differences(
    raw: RawLog, log: TrialLog, tolerance: Tolerance = SAME_BITS
) -> Iterator[Difference]:
    """Yield the differences between the records of a repeated trial and those in its log; nothing
    for a damaged log, whose trial cannot be repeated.
    """
    simulated, result, stop = log.start.plant.simulated, log.result, log.stop
    if log.damage or result is None:
        return
    if simulated != log.experiment.plant.simulated:
        yield Difference(None, "run.mode", "differs from the plant of the spec")
        return
    if channels.ENVIRONMENT not in raw.attachments:
        yield Difference(None, channels.ENVIRONMENT, "missing")
    if result.outcome is Outcome.ABORTED and not result.reason:
        yield Difference(None, "result.reason", "aborted without a reason")
    if stop is None:
        yield Difference(None, "stop", "missing: no stop is on /commands")
        return
    yield from _host(raw, log, stop)
    sink = Comparison(raw, tolerance)
    repetition = Repetition(log, result, sink)
    try:
        if simulated:
            simulate(log, stop, repetition)
        else:
            give_again(log, raw, stop, repetition, sink)
    except TooLongError:
        text = f"not compared: it would take over {2 * limits.seconds_limit():g} s"
        yield Difference(None, "records", f"{text}; {limits.FACTOR}=2 allows twice as much")
        return
    except (TetractlError, ValueError, OverflowError) as error:
        yield Difference(
            None, "plant", f"cannot be simulated again: {str(error).partition(chr(10))[0]}"
        )
        return
    if repetition.failure:
        yield Difference(None, "plant", f"cannot be simulated again: {repetition.failure}")
    yield from sink.differences()
    stated = result.solve_ns, result.deadline_misses
    if found := first_difference(repetition.timing, stated, name="result.timing"):
        yield Difference(None, *found)
    if not simulated:
        yield from lab_differences(log, result, stop)


def host_differences(log: TrialLog) -> tuple[str, ...]:
    """Return the differences between the log's host and this one that may change bits, one per
    line.
    """
    used = provenance.plugins(packages(log.experiment))
    here = provenance.host() | provenance.versions() | used
    there = log.facts
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
