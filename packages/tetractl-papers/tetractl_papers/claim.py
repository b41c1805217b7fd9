"""Claims of a paper, the criterion for each claim, and the verdict from our own trials.

A claim is a result that the paper reports, never a value that we enter into a spec. Our trials give
an `OurNumber`: a value, the number n of trials, and a 95 % interval [low, high], which is a point
if all values are equal. The criterion (`Asked`) turns this number into a verdict:

    reached     the whole interval satisfies the criterion
    agrees      the criterion is the published number itself, and our interval contains it
    missed      the whole interval violates the criterion, or does not contain that number
    undecided   the bound is within the interval: more trials would decide
    not judged  the published number comes from an experiment: both numbers are only printed

A simulation is never tested against an experiment. Its disturbances are assumptions, so agreement
would only show that they were chosen well, and a difference that they were chosen badly.

A fraction of trials needs enough trials to be judged: 0 of 20 does not show that fewer than 5 % of
all trials would do the same, because its interval ends at 16 %.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.statistics.estimate import Interval, distributions, proportion_interval

CONFIDENCE = 0.95
"""Confidence level of all intervals in this module."""
_END_PROBABILITIES = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
"""Probabilities below the lower and the upper end of an interval with this confidence level."""


class Fate(StrEnum):
    """The verdict on a claim of a paper, from a comparison with our own trials."""

    REACHED = "reached"
    AGREES = "agrees"
    MISSED = "missed"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"


# ---- The numbers of our trials ----


class NumberKind(StrEnum):
    """The kind of a number that is computed from trials."""

    MEAN = "mean"
    DEVIATION = "standard deviation"
    SHARE = "share of trials in which a fact holds"


@dataclass(frozen=True, slots=True)
class OurNumber:
    """A number computed from our trials, with its interval.

    Attributes:
        kind: What kind of number it is.
        value: The number. NaN if it is undefined.
        n: Number of trials.
        low: Lower end of its 95 % interval.
        high: Upper end of its 95 % interval.
        means: If `value` is a difference, the mean of the claim's arm and the mean of the arm that
            is subtracted. None otherwise.
    """

    kind: NumberKind
    value: float
    n: int
    low: float
    high: float
    means: tuple[float, float] | None = None


def mean_of(values: Floats) -> OurNumber:
    """Compute the mean of values (n,) with its 95 % interval by Student's t distribution.

    If the interval is unknown, for example for a single value, both its ends are the mean.
    """
    summary = distributions(values[None])[0]
    interval = summary.ci95 if summary.ci95.known else Interval(summary.mean, summary.mean)
    return OurNumber(NumberKind.MEAN, summary.mean, summary.n, interval.low, interval.high)


def share_of(values: Floats) -> OurNumber:
    """Compute the fraction of values (n,) that are above 0, with Wilson's 95 % interval."""
    trials = len(values)
    count = int(np.sum(values > 0))
    interval = proportion_interval(count, trials)
    return OurNumber(NumberKind.SHARE, count / trials, trials, interval.low, interval.high)


def deviation_of(values: Floats) -> OurNumber:
    """Compute the standard deviation of values (n,), with its chi-square 95 % interval.

    The interval assumes normal values. The result is NaN if there is only one value.
    """
    from scipy import stats  # slow to import

    n = len(values)
    std = float(np.std(values, ddof=1)) if n > 1 else math.nan
    lower, upper = (
        std * np.sqrt((n - 1) / stats.chi2.ppf(_END_PROBABILITIES[::-1], n - 1))
    ).tolist()
    return OurNumber(NumberKind.DEVIATION, std, n, lower, upper)


# ---- Criteria for these numbers ----

Decide = Callable[[OurNumber], Fate]
"""Function that returns the verdict on the number of our trials."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A criterion of a claim for a number from our trials.

    Attributes:
        words: The criterion in words, for the table.
        number: Computes the number from the values (n,) of our trials.
        decide: Returns the verdict on this number.
    """

    words: str
    number: Callable[[Floats], OurNumber]
    decide: Decide


def at_most(bound: float) -> Asked:
    """Create the criterion that the mean of our trials is at or below a bound."""
    return Asked("smaller is better", mean_of, _interval_within(-math.inf, bound))


def at_least(bound: float) -> Asked:
    """Create the criterion that the mean of our trials is at or above a bound."""
    return Asked("greater is better", mean_of, _interval_within(bound, math.inf))


def rarely(fraction: float = 0.05) -> Asked:
    """Create the criterion that values are above 0 in at most a fraction of our trials (0 to 1)."""
    return Asked(
        f"in fewer than {100 * fraction:g} %", share_of, _interval_within(-math.inf, fraction)
    )


def same_number(published: float) -> Asked:
    """Create the criterion that the 95 % interval of our trials' mean contains a published number.

    The uncertainty of the published number is unknown, and is not considered.
    """
    return Asked("agreement", mean_of, _interval_contains(published))


def as_often(fraction: float) -> Asked:
    """Create the criterion that values are above 0 in a published fraction of our trials (0 to 1).

    The 95 % interval of our fraction must contain the published fraction.
    """
    return Asked(f"agreement with {100 * fraction:g} %", share_of, _interval_contains(fraction))


def not_judged(number: Callable[[Floats], OurNumber]) -> Asked:
    """Create the criterion of a claim that is not judged, because it comes from an experiment.

    Args:
        number: Computes our number from the values (n,) of our trials, such as `mean_of`.
    """
    return Asked("nothing: an experiment", number, lambda ours: Fate.NOT_JUDGED)


def _interval_within(lower: float, upper: float) -> Decide:
    """Create a function that checks whether the interval of our number is within two bounds.

    Its verdict is REACHED if the interval is within [lower, upper], MISSED if it is outside, and
    UNDECIDED if it contains one of the bounds.
    """

    def decide(our_number: OurNumber) -> Fate:
        if lower <= our_number.low and our_number.high <= upper:
            return Fate.REACHED
        return Fate.MISSED if our_number.high < lower or our_number.low > upper else Fate.UNDECIDED

    return decide


def _interval_contains(published: float) -> Decide:
    """Create a function that checks whether the interval of our number contains a published number.

    Its verdict is AGREES if the interval contains that number, otherwise MISSED. The ends belong to
    the interval.
    """
    return lambda ours: Fate.AGREES if ours.low <= published <= ours.high else Fate.MISSED


# ---- Claims ----


@dataclass(frozen=True, slots=True)
class Claim:
    """A result that a paper reports, and how to check it with our trials.

    An *arm* is a named group of trials with the same conditions.

    Attributes:
        figure: The claim in words, with its place in the paper.
        published: The published number, as text.
        arm: Name of the arm whose trials are measured.
        measure: Computes a number from one trial, in `unit`. A bool counts as 1 or 0.
        asked: The criterion.
        unit: Unit of the number. Empty if it has none.
        minus: Name of a second arm. The paired differences between the trials of both arms are then
            judged. None if only one arm is measured.
        expected: The verdict that the package's README states.
        why: Explanation of a difference from the published number.
    """

    figure: str
    published: str
    arm: str
    measure: Callable[[Any], float]
    asked: Asked
    unit: str = ""
    minus: str | None = None
    expected: Fate = Fate.REACHED
    why: str = ""


@dataclass(frozen=True, slots=True)
class AssessedClaim:
    """A claim of a paper with the number from our trials and the verdict.

    Attributes:
        claim: The claim.
        ours: The number from our trials, with its interval.
        verdict: The verdict on the claim.
    """

    claim: Claim
    ours: OurNumber
    verdict: Fate


def assess(claim: Claim, results: Mapping[str, Sequence[Any]]) -> AssessedClaim:
    """Judge a claim of a paper by the trials that belong to it.

    Args:
        claim: The claim.
        results: The trials of each arm, by the arm's name. If the claim compares two arms, their
            trials are paired in order.
    """
    values = _measure_each(claim, results[claim.arm])
    means = None
    if claim.minus is not None:
        subtracted = _measure_each(claim, results[claim.minus])
        n_pairs = min(len(values), len(subtracted))
        values = values[:n_pairs]
        subtracted = subtracted[:n_pairs]
        means = (float(values.mean()), float(subtracted.mean()))
        values = values - subtracted
    our_number = claim.asked.number(values)
    return AssessedClaim(claim, replace(our_number, means=means), claim.asked.decide(our_number))


def _measure_each(claim: Claim, trials: Sequence[Any]) -> Floats:
    """Compute the measure of a claim for each of its trials, shape (n,), in the same order.

    Raises:
        AssertionError: If a measure is NaN or infinite.
    """
    values = np.array([claim.measure(trial) for trial in trials], dtype=float)
    assert np.isfinite(values).all(), f"{claim.figure}: the trials have no such number"
    return values
