"""How the total errors of two batches compare."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.difference import (
    Effect,
    MeanDifference,
    cliffs_delta,
    from_both_intervals,
    paired_t,
    welch,
)
from tetractl.stats.estimate import Interval
from tetractl.stats.summary import Summary
from tetractl.stats.trials import counts, differences

ENOUGH = 8
"""Fewest trials on each side, or pairs, for a verdict."""
_NOT_THE_WORLD = {"controller", "name", "description", "trials", "reference", "scale", "lab"}


@dataclass(frozen=True, slots=True)
class Paired:
    """The pairs of trials in the same world, and their mean difference; None without pairs.

    `reason` says why there are no pairs, "" where there are.
    """

    n: int
    difference: MeanDifference | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two batches of total errors: `ours` against `theirs`, differences being ours minus theirs.

    `both` is the interval of the difference from the intervals of the two means. `verdict` is
    "lower", "higher" or "undecided" as the interval of the pairs says or, with fewer than ENOUGH
    pairs, Welch's and `both` together; None, with the reason, where the trials are too few to tell.
    """

    ours: Summary
    theirs: Summary
    differs: tuple[str, ...]
    welch: MeanDifference
    both: Interval
    paired: Paired
    effect: Effect
    verdict: str | None
    reason: str | None


def compare(ours: Summary, theirs: Summary) -> Comparison:
    """Compare the total errors of two batches; they must share the unit of length."""
    if ours.unit != theirs.unit:
        raise UsageError(f"cannot compare errors in {ours.unit} with errors in {theirs.unit}")
    a, b = ours.total, theirs.total
    difference = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
    both = from_both_intervals(a, b)
    paired = _paired(ours, theirs)
    intervals = (difference.ci95, both)
    if paired.n >= ENOUGH and paired.difference and paired.difference.ci95.known:
        intervals = (paired.difference.ci95,)
    verdict, reason = verdict_of(min(a.n, b.n), *intervals)
    return Comparison(
        ours,
        theirs,
        tuple(differences(ours.experiment, theirs.experiment)),
        difference,
        both,
        paired,
        cliffs_delta(ours.totals, theirs.totals),
        verdict,
        reason,
    )


def _paired(ours: Summary, theirs: Summary) -> Paired:
    """Return the comparison of trials in the same world."""
    differences, reason = paired_differences(ours, theirs)
    if reason:
        return Paired(0, None, reason)
    return Paired(len(differences), paired_t(differences))


def paired_differences(ours: Summary, theirs: Summary) -> tuple[Floats, str]:
    """Return ours minus theirs of trials of the same seed and number, where their worlds match.

    Where there are no pairs the text says why; it is "" where there are. The world of a trial is
    all of the spec but the controller; from it and the seed a simulation draws its disturbances.
    """
    if not (ours.origin.simulated and theirs.origin.simulated):
        return np.zeros(0), "no two trials in a lab are alike"
    one, two = (
        batch.experiment.model_dump(mode="json", exclude=_NOT_THE_WORLD) for batch in (ours, theirs)
    )
    if one != two:
        return np.zeros(0), "the batches differ in more than the controller"
    others = _by_world(theirs.trials)
    pairs = [
        error - others[world] for world, error in _by_world(ours.trials).items() if world in others
    ]
    if not pairs:
        return np.zeros(0), "the batches have no seed and trial in common"
    return np.array(pairs), ""


def _by_world(trials: Sequence[ResultSummary]) -> dict[tuple[int, int], float]:
    """Return the total errors of the trials that count by seed and number."""
    return {
        (trial.seed, trial.trial): trial.result.total_error for trial in trials if counts(trial)
    }


def verdict_of(n: int, *intervals: Interval) -> tuple[str | None, str | None]:
    """Return "lower", "higher" or "undecided" as all intervals of a difference say; None, with the
    reason, where fewer than ENOUGH values on a side, or pairs, cannot tell."""
    if n < ENOUGH:
        return None, f"a verdict needs {ENOUGH} complete trials on each side"
    if not all(interval.known for interval in intervals):
        return None, "no interval of the difference"
    if all(interval.high < 0 for interval in intervals):
        return "lower", None
    if all(interval.low > 0 for interval in intervals):
        return "higher", None
    return "undecided", None
