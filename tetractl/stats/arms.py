"""Any number of batches beside each other, the arms of a study: every two of them compared."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from tetractl.core.errors import UsageError
from tetractl.stats.comparison import ENOUGH, paired_differences, verdict_of
from tetractl.stats.difference import (
    Effect,
    MeanDifference,
    cliffs_delta,
    from_both_intervals,
    paired_t,
    welch,
)
from tetractl.stats.effects import (
    Ratio,
    detectable,
    detectable_between,
    deviation_ratio,
    standardised,
)
from tetractl.stats.estimate import CONFIDENCE, Interval
from tetractl.stats.ranks import holm, rank_sum, signed_rank
from tetractl.stats.summary import Summary
from tetractl.stats.trials import differences

SIGNED_RANK, RANK_SUM = "signed rank", "rank sum"


@dataclass(frozen=True, slots=True)
class Arm:
    """A batch and what it is called."""

    name: str
    summary: Summary


@dataclass(frozen=True, slots=True)
class Contrast:
    """The total errors of two arms; differences are those of `one` minus those of `other`.

    With `pairs`, the trials in the same world, `difference` and `standardised` are of the pairs and
    `test` is Wilcoxon's signed-rank test; else `difference` is Welch's, `both` the interval from
    those of the two means, and `test` the rank-sum test. `why_unpaired` is "" with pairs. `p_holm`
    and `deviation_p_holm` are corrected for all contrasts of their table. `detects` is the
    difference, in standard deviations (of the differences, or of the values), that so many trials
    show in 80 % of all studies. `verdict` and `reason` are as those of a `Comparison`; a verdict
    needs `p_holm` below 0.05 besides.
    """

    one: Arm
    other: Arm
    pairs: int
    why_unpaired: str
    difference: MeanDifference
    both: Interval
    test: str
    p_value: float
    p_holm: float
    standardised: Effect
    delta: Effect
    deviations: Ratio
    deviation_p_holm: float
    detects: float
    verdict: str | None
    reason: str | None
    differs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NotCompared:
    """Two arms that are not alike: nothing is tested."""

    one: Arm
    other: Arm
    reason: str


@dataclass(frozen=True, slots=True)
class Arms:
    """All arms, and every two of them in the order given."""

    arms: tuple[Arm, ...]
    contrasts: tuple[Contrast | NotCompared, ...]

    @property
    def unit(self) -> str:
        """The length unit of every error."""
        return self.arms[0].summary.unit


def compare_arms(arms: Sequence[Arm]) -> Arms:
    """Compare every two arms; UsageError where they do not share the unit of length.

    Two arms of which one is, say, an undisturbed simulation and the other a lab, are not compared.
    """
    first = arms[0]
    for arm in arms:
        if arm.summary.unit != first.summary.unit:
            units = f"{arm.name} has errors in {arm.summary.unit}, {first.name} in"
            raise UsageError(f"{units} {first.summary.unit}", "compare those of one unit")
    every = list(combinations(arms, 2))
    alike = [_comparable(one, other) for one, other in every]
    tests = alike.count(True)
    found = [
        _contrast(one, other, tests)
        if same
        else NotCompared(one, other, f"{one.summary.origin} and {other.summary.origin}")
        for (one, other), same in zip(every, alike, strict=True)
    ]
    return Arms(tuple(arms), tuple(_corrected(found)))


def _comparable(one: Arm, other: Arm) -> bool:
    return one.summary.origin is other.summary.origin


def _contrast(one: Arm, other: Arm, tests: int) -> Contrast:
    """Compare two arms; p-values are not corrected yet."""
    ours, theirs = one.summary, other.summary
    a, b = ours.total, theirs.total
    paired, why = paired_differences(ours, theirs)
    if len(paired):
        difference, test, p_value = paired_t(paired), SIGNED_RANK, signed_rank(paired)
        detects = detectable(len(paired), tests)
    else:
        difference = welch(a.n, a.mean, a.std, b.n, b.mean, b.std)
        test, p_value = RANK_SUM, rank_sum(ours.totals, theirs.totals)
        detects = detectable_between(a.n, b.n, tests)
    return Contrast(
        one,
        other,
        len(paired),
        why,
        difference,
        from_both_intervals(a, b),
        test,
        p_value,
        math.nan,
        standardised(paired),
        cliffs_delta(ours.totals, theirs.totals),
        deviation_ratio(ours.totals, theirs.totals),
        math.nan,
        detects,
        None,
        None,
        tuple(differences(ours.experiment, theirs.experiment)),
    )


def _corrected(found: Sequence[Contrast | NotCompared]) -> list[Contrast | NotCompared]:
    """Correct the p-values for their number, and give the verdicts."""
    tested = [one for one in found if isinstance(one, Contrast)]
    p_values = iter(holm([one.p_value for one in tested]))
    deviations = iter(holm([one.deviations.p_value for one in tested]))
    return [
        _judged(replace(one, p_holm=next(p_values), deviation_p_holm=next(deviations)))
        if isinstance(one, Contrast)
        else one
        for one in found
    ]


def _judged(found: Contrast) -> Contrast:
    if found.pairs:
        n, intervals = found.pairs, (found.difference.ci95,)
        too_few = f"a verdict needs {ENOUGH} pairs"
    else:
        n = min(found.one.summary.counted, found.other.summary.counted)
        intervals = (found.difference.ci95, found.both)
        too_few = None
    verdict, reason = verdict_of(n, *intervals)
    if n < ENOUGH and too_few:
        reason = too_few
    if verdict in ("lower", "higher") and not found.p_holm < 1 - CONFIDENCE:
        verdict = "undecided"
    return replace(found, verdict=verdict, reason=reason)
