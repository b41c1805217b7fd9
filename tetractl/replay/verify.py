"""Verify a log: check it against itself, and compute every decision again."""

import time
from dataclasses import dataclass
from pathlib import Path

from tetractl.experiment.kinds import packages
from tetractl.log import provenance
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.audit import audit
from tetractl.replay.recompute import TOLERANCE, Difference, first_steps, recompute

DECIDES_BITS = ("cpu", "cpu_target", "code", "python", "numpy", "numba", "llvmlite")
"""Host facts that must agree before the same bits can be asked for."""

RECOMPUTED = "re-computed, bit-identical"
REEVALUATED = f"costs of the logged plans re-evaluated, to {TOLERANCE:g}"


@dataclass(frozen=True, slots=True)
class Verification:
    """What came of verifying one log.

    `method` is RECOMPUTED or REEVALUATED: which of the two the decisions were put to, the second
    only where `elsewhere` says what differs between the host that wrote the log and this one.
    """

    path: str
    steps: int
    checked: int  # steps whose decision was computed again and came out as logged
    method: str
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
    log = read_trial(path)
    findings = audit(log)
    elsewhere = differing_facts(log)
    method, found = RECOMPUTED, recompute(log, again=True)
    if found and elsewhere:
        method, found = REEVALUATED, recompute(log, again=False)
    known = len(first_steps(log))
    checked = found.step if found and found.step is not None else known
    return Verification(
        path=str(path),
        steps=len(log.steps),
        checked=checked,
        method=method,
        elsewhere=elsewhere,
        problems=(*((found,) if found else ()), *findings.problems),
        notes=tuple(findings.notes),
        seconds=time.perf_counter() - began,
    )


def differing_facts(log: TrialLog) -> tuple[str, ...]:
    """Return what decides bits and differs between the log's host and this one."""
    used = provenance.plugins(packages(log.experiment))
    here = provenance.host() | provenance.versions() | used
    there = log.host | log.provenance
    return tuple(
        f"{key}: {there.get(key, 'unknown')} there, {here.get(key, 'unknown')} here"
        for key in (*DECIDES_BITS, *used)
        if here.get(key) != there.get(key)
    )
