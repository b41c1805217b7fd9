"""Verifies a log: computes its decisions again, and runs its simulation again.

Each decision is computed again from the logged frames (`recompute`). What else is compared is the
list COMPARISONS. Most apply to every log. Of the others `_Case.kind` says which applies:

    kind of log         what its result is compared with
    INCOMPLETE          nothing: it is damaged, has no result, or another plant than its spec
    LAB                 what follows from its frames and commands (`lab_result`); its commands,
                        run and messages are checked, too (`lab_commands`, `run_and_messages`)
    RUN_AGAIN           the log of the simulation run again, record by record (`run_again`), where
                        the host and the code are those that wrote the log
    NOT_RUN_AGAIN       the errors that follow from its final poses

If another machine or version wrote the log, costs must agree within a tolerance.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, StrEnum
from functools import cached_property
from pathlib import Path

from tetractl.core.plan import Outcome
from tetractl.core.trial import Result
from tetractl.experiment.registry_fields import packages
from tetractl.log import provenance
from tetractl.log.read.raw_log import ALTERED, RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog, frame_gaps, step_gaps
from tetractl.replay import run_again
from tetractl.replay.comparison import Difference
from tetractl.replay.lab_commands import command_differences
from tetractl.replay.lab_result import error_differences, lab_differences
from tetractl.replay.recompute import TOLERANCE, Recomputed, recompute
from tetractl.replay.run_and_messages import (
    frame_differences,
    message_differences,
    run_differences,
)

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


class _Kind(Enum):
    """What a log's result can be compared with; see the module."""

    INCOMPLETE = "incomplete"
    LAB = "lab"
    RUN_AGAIN = "run again"
    NOT_RUN_AGAIN = "not run again"


@dataclass(frozen=True)
class _Case:
    """A log that is verified, and the differences between its host and this one."""

    raw: RawLog
    log: TrialLog
    elsewhere: tuple[str, ...]

    @property
    def plant_agrees(self) -> bool:
        """Whether the plant of the run is a simulation if that of the spec is one."""
        return self.log.start.plant.simulated == self.log.experiment.plant.simulated

    @cached_property
    def why_not_again(self) -> str:
        """Why the trial cannot be run again here, "" if it can."""
        return run_again.why_not_again(self.log, self.elsewhere)

    @cached_property
    def kind(self) -> _Kind:
        """What the result can be compared with."""
        if not self.plant_agrees or self.log.damage is not None or self.log.result is None:
            return _Kind.INCOMPLETE
        if not self.log.start.plant.simulated:
            return _Kind.LAB
        return _Kind.NOT_RUN_AGAIN if self.why_not_again else _Kind.RUN_AGAIN

    @property
    def result(self) -> Result:
        """The result of a log that is not INCOMPLETE."""
        assert self.log.result is not None, "`kind` says that there is a result"
        return self.log.result

    @cached_property
    def lost_frames(self) -> list[str]:
        """Texts on the camera frames that are missing."""
        return [f"missing: {gap}" for gap in frame_gaps(self.log)]

    @property
    def may_lose_frames(self) -> bool:
        """Whether missing frames may be those that the camera lost."""
        return self.log.experiment.plant.loses_frames and self.log.damage is None


def verify(path: Path) -> Verification:
    """Verify one log; raises LogError as `read_trial` does. A brief log is only run again."""
    began_s = time.perf_counter()
    raw = scan(path)
    log = trial_of(raw)
    case = _Case(raw, log, host_differences(log))
    method, decisions = _decisions(case)
    problems = [] if decisions.difference is None else [decisions.difference]
    for compare in COMPARISONS:
        problems += compare(case)
    rewritten = ""
    if raw.rewritten:
        rewritten = raw.library or "an unknown program"
    return Verification(
        log=str(path),
        rewritten=rewritten,
        steps=len(log.steps),
        checked=decisions.agreeing,
        method=method,
        elsewhere=case.elsewhere,
        problems=tuple(problems),
        notes=tuple(_notes(case)),
        seconds=time.perf_counter() - began_s,
    )


def _decisions(case: _Case) -> tuple[Method, Recomputed]:
    """Return how decisions are checked, and how far they agree.

    Searches are repeated on another host too: if none differs, that is the stricter check; else the
    hosts may be the cause, and the logged searches are evaluated.
    """
    if case.raw.brief:
        return Method.RECOMPUTED, Recomputed(0, None)
    decisions = recompute(case.log, search_again=True)
    if decisions.difference is None or not case.elsewhere:
        return Method.RECOMPUTED, decisions
    return Method.REEVALUATED, recompute(case.log, search_again=False)


def _notes(case: _Case) -> Iterator[str]:
    """Yield what a reader must know of a log that is not wrong for it."""
    if case.may_lose_frames:
        yield from case.lost_frames
    if case.raw.reordered:
        yield "the content digest is of another order of the messages: not compared"
    if case.kind is _Kind.NOT_RUN_AGAIN:
        yield f"the trial is not run again: {case.why_not_again}"


# ---- What is compared, apart from decisions ----


def _plant(case: _Case) -> Iterator[Difference]:
    """The plant of the run is that of the spec."""
    if not case.plant_agrees:
        yield Difference(None, "run.mode", "differs from the plant of the spec")


def _end(case: _Case) -> Iterator[Difference]:
    """A whole log has a stop, and a reason if the trial was aborted."""
    if case.kind is _Kind.INCOMPLETE or case.raw.brief:
        return
    if case.log.stop is None:
        yield Difference(None, "stop", "missing: no stop is on /commands")
    if case.result.outcome is Outcome.ABORTED and not case.result.reason:
        yield Difference(None, "result.reason", "aborted without a reason")


def _lab(case: _Case) -> Iterator[Difference]:
    """The result of a lab follows from its frames and commands."""
    if case.kind is _Kind.LAB:
        yield from lab_differences(case.log, case.result)
        yield from command_differences(case.log, case.result)
        yield from frame_differences(case.raw, case.log)


def _stated(case: _Case) -> Iterator[Difference]:
    """Run and messages of a log that is not run again follow from spec and records."""
    if case.kind in (_Kind.LAB, _Kind.NOT_RUN_AGAIN):
        yield from run_differences(case.raw, case.log)
        if not case.raw.brief:
            yield from message_differences(case.raw, case.log, case.result)


def _errors(case: _Case) -> Iterator[Difference]:
    """The errors of a simulation that is not run again follow from its final poses."""
    if case.kind is _Kind.NOT_RUN_AGAIN and not case.raw.brief:
        yield from error_differences(case.log, case.result)


def _repetition(case: _Case) -> Iterator[Difference]:
    """A simulation that is run again here gives the same records."""
    if case.kind is _Kind.RUN_AGAIN:
        yield from run_again.differences(case.raw, case.log)


def _frames(case: _Case) -> Iterator[Difference]:
    """No camera frame is missing, unless the camera may have lost it."""
    if not case.may_lose_frames:
        for text in case.lost_frames:
            yield Difference(None, "frames", text)


def _steps(case: _Case) -> Iterator[Difference]:
    """No control step is missing."""
    for gap in step_gaps(case.log):
        yield Difference(gap.first, "k", f"missing: {gap}")


def _content(case: _Case) -> Iterator[Difference]:
    """The records of the trial match the digest that the log states."""
    if case.raw.altered:
        yield Difference(None, "content_digest", ALTERED)


def _damage(case: _Case) -> Iterator[Difference]:
    """The log is not damaged."""
    damage = case.log.damage
    if damage is not None:
        for text in (*damage.problems, *(f"lost: {lost}" for lost in damage.lost)):
            yield Difference(None, "damage", text)


def _host(case: _Case) -> Iterator[Difference]:
    """The records of the host match their digest; those of a damaged log may be lost."""
    if case.log.damage is None and case.raw.host_altered:
        text = "the records of the host do not match the digest that the log states"
        yield Difference(None, "host_digest", text)


COMPARISONS: tuple[Callable[[_Case], Iterator[Difference]], ...] = (
    _plant,
    _end,
    _lab,
    _stated,
    _errors,
    _repetition,
    _frames,
    _steps,
    _content,
    _damage,
    _host,
)
"""What is compared, in the order in which problems are listed."""


def host_differences(log: TrialLog) -> tuple[str, ...]:
    """Return the differences between the log's host and this one that may change bits, one per
    line.
    """
    used = provenance.plugins(packages(log.experiment))
    these_facts = provenance.host() | provenance.versions() | used
    return tuple(
        _difference(key, log.facts.get(key), these_facts.get(key))
        for key in (*DECIDES_BITS, *used)
        if these_facts.get(key) != log.facts.get(key)
    )


def _difference(key: str, logged: str | None, present: str | None) -> str:
    """Return a text on the fact `key`, which differs between the log's host and this one; of a
    list, only the words that differ.
    """
    if logged is not None and present is not None and key in provenance.LISTS:
        logged_words = set(logged.split())
        present_words = set(present.split())
        logged = " ".join(sorted(logged_words - present_words)) or "no more"
        present = " ".join(sorted(present_words - logged_words)) or "no more"
    return f"{key}: {logged or 'unknown'} on the log's host, {present or 'unknown'} on this one"
