"""Verify a log: check it against itself, simulate it again, and compute every decision again."""

import time
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tetractl.experiment.registry_fields import packages
from tetractl.log import provenance
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.audit import audit
from tetractl.replay.derived import derived_differences
from tetractl.replay.difference import Difference
from tetractl.replay.film_check import FilmCheck
from tetractl.replay.recompute import TOLERANCE, first_steps, recompute
from tetractl.replay.resimulate import resimulate

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
"""Facts that must agree on two hosts to give the same bits."""


class Method(StrEnum):
    """How the decisions of a log are checked; see `recompute`."""

    RECOMPUTED = "re-computed, bit-identical"
    REEVALUATED = f"costs of the logged plans re-evaluated, to {TOLERANCE:g}"


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying one log.

    `method` is REEVALUATED only if `elsewhere` names differences between the host that wrote the
    log and this one. `checked` counts the steps whose decision came out as logged.
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
        """Whether nothing was found wrong."""
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
    """Return the differences between the log's host and this one that change bits, one line
    each."""
    used = provenance.plugins(packages(log.experiment))
    here = provenance.host() | provenance.versions() | used
    there = log.host | log.provenance
    return tuple(
        _difference(key, there.get(key), here.get(key))
        for key in (*DECIDES_BITS, *used)
        if here.get(key) != there.get(key)
    )


def _difference(key: str, there: str | None, here: str | None) -> str:
    """Return how a fact of two hosts differs; of lists of words, only the words that differ."""
    if there is not None and here is not None and key in provenance.LISTS:
        ours, theirs = set(here.split()), set(there.split())
        only = (" ".join(sorted(words)) or "no more" for words in (theirs - ours, ours - theirs))
        return "{}: {} there, {} here".format(key, *only)
    return f"{key}: {there or 'unknown'} there, {here or 'unknown'} here"
