"""Verifies a log: computes its decisions again, and runs its simulation again.

Each decision is computed again from the logged frames (`recompute`). The simulation of the host and
the code that run here is run again, and the two logs are compared record by record (`run_again`).
Of a lab's log, what tables use is computed again from its frames and commands (`lab_result`). If
another machine or version wrote the log, costs must agree within a tolerance.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tetractl.core.plan import Outcome
from tetractl.experiment.registry_fields import packages
from tetractl.log import provenance
from tetractl.log.read.raw_log import ALTERED, RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog, frame_gaps, step_gaps
from tetractl.replay import run_again
from tetractl.replay.comparison import Difference
from tetractl.replay.lab_result import error_differences, lab_differences
from tetractl.replay.recompute import TOLERANCE, first_steps, recompute

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

    `rewritten` is the program that wrote the file again from a log of tetractl, "" if none did.
    `method` is REEVALUATED only if `elsewhere` names differences between the host that wrote the
    log and this one. `checked` is the number of steps whose repeated decision agrees with the log.
    """

    log: str
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
    """Verify one log; raises LogError as `read_trial` does. A brief log is only run again."""
    began = time.perf_counter()
    raw = scan(path)
    log = trial_of(raw)
    elsewhere = host_differences(log)
    method, found = Method.RECOMPUTED, None if raw.brief else recompute(log, search_again=True)
    if found and elsewhere:
        method, found = Method.REEVALUATED, recompute(log, search_again=False)
    lost = [f"missing: {gap}" for gap in frame_gaps(log)]
    notes = lost if log.experiment.plant.loses_frames and not log.damage else []
    missing = [Difference(None, "frames", text) for text in lost if not notes]
    if raw.reordered:
        notes = [*notes, "the content digest is of another order of the messages: not compared"]
    why_not = run_again.why_not_again(log, elsewhere)
    others = list[Difference]()
    if log.start.plant.simulated != log.experiment.plant.simulated:
        others = [Difference(None, "run.mode", "differs from the plant of the spec")]
    elif log.damage is None and log.result is not None:
        others = [*(_stop(log) if not raw.brief else ())]
        if not log.start.plant.simulated:
            others += lab_differences(log, log.result)
        elif why_not:
            notes = [*notes, f"the trial is not run again: {why_not}"]
            others += [] if raw.brief else error_differences(log, log.result)
        else:
            others += run_again.differences(raw, log)
    return Verification(
        log=str(path),
        rewritten=(raw.library or "an unknown program") if raw.rewritten else "",
        steps=len(log.steps),
        checked=found.step if found and found.step is not None else len(first_steps(log)),
        method=method,
        elsewhere=elsewhere,
        problems=(*([found] if found else []), *others, *missing, *_damage(raw, log)),
        notes=tuple(notes),
        seconds=time.perf_counter() - began,
    )


def _stop(log: TrialLog) -> Iterator[Difference]:
    """Yield what an undamaged log lacks of the end of a trial."""
    if log.stop is None:
        yield Difference(None, "stop", "missing: no stop is on /commands")
    if log.result and log.result.outcome is Outcome.ABORTED and not log.result.reason:
        yield Difference(None, "result.reason", "aborted without a reason")


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
