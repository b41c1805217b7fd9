"""What a paper claims of a figure, what is asked of our trials, and the verdict.

A claim is an outcome that the paper states, never a number that the spec is given. Our trials give
an `OurNumber`, with n and its 95 % interval [low, high] (a point if all values are equal). What is
`Asked` of it gives the verdict:

    reached     the whole interval is within what is asked
    agrees      what is asked is the published number itself, and our interval holds it
    missed      the whole interval is outside, or does not hold the published number
    undecided   the interval holds the bound: more trials would decide
    not judged  the published number comes from an experiment: both are printed, and nothing else

A simulation is never tested against an experiment. Its disturbances are assumptions, so agreement
would show that they were chosen well, and a difference that they were chosen badly.

A share can be missed and reached, but only by enough trials: 0 of 20 does not show that fewer than
5 % of all trials would do the same, as its interval ends at 16 %.
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
"""Confidence of all intervals here."""
_ENDS = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
"""Probabilities below the ends of such an interval."""


class Fate(StrEnum):
    """What became of a claim."""

    REACHED = "reached"
    AGREES = "agrees"
    MISSED = "missed"
    UNDECIDED = "undecided"
    NOT_JUDGED = "not judged"


# ---- The numbers of our trials ----


class NumberKind(StrEnum):
    """What a number of ours is."""

    MEAN = "mean"
    DEVIATION = "standard deviation"
    SHARE = "share of trials in which a fact holds"


@dataclass(frozen=True, slots=True)
class OurNumber:
    """Our number over n trials.

    Attributes:
        kind: What kind of number it is.
        value: The number.
        n: Number of trials.
        low: Lower end of its 95 % interval.
        high: Upper end of that interval.
        means: If `value` is a difference, our mean and that of the other controller. None
            otherwise.
    """

    kind: NumberKind
    value: float
    n: int
    low: float
    high: float
    means: tuple[float, float] | None = None


def mean_of(values: Floats) -> OurNumber:
    """Return the mean of values (n,) with its interval (Student's t; `statistics.estimate`)."""
    summary = distributions(values[None])[0]
    interval = summary.ci95 if summary.ci95.known else Interval(summary.mean, summary.mean)
    return OurNumber(NumberKind.MEAN, summary.mean, summary.n, interval.low, interval.high)


def share_of(values: Floats) -> OurNumber:
    """Return the share of values (n,) that are above 0, with Wilson's interval."""
    n = len(values)
    count = int(np.sum(values > 0))
    interval = proportion_interval(count, n)
    return OurNumber(NumberKind.SHARE, count / n, n, interval.low, interval.high)


def deviation_of(values: Floats) -> OurNumber:
    """Return the standard deviation of values (n,), with a chi-square interval for normal values.

    It is NaN if there is only one value.
    """
    from scipy import stats  # slow to import

    n = len(values)
    std = float(np.std(values, ddof=1)) if n > 1 else math.nan
    low, high = (std * np.sqrt((n - 1) / stats.chi2.ppf(_ENDS[::-1], n - 1))).tolist()
    return OurNumber(NumberKind.DEVIATION, std, n, low, high)


# ---- What can be asked of them ----

Decide = Callable[[OurNumber], Fate]
"""Returns the verdict on the number of our trials."""


@dataclass(frozen=True, slots=True)
class Asked:
    """The question that a claim asks.

    Attributes:
        words: The question in words, for the table.
        number: Computes the number that is asked.
        decide: Decides the verdict.
    """

    words: str
    number: Callable[[Floats], OurNumber]
    decide: Decide


def at_most(bound: float) -> Asked:
    """The mean is to be at or below a bound."""
    return Asked("smaller is better", mean_of, _within(-math.inf, bound))


def at_least(bound: float) -> Asked:
    """The mean is to be at or above a bound."""
    return Asked("greater is better", mean_of, _within(bound, math.inf))


def rarely(fraction: float = 0.05) -> Asked:
    """A fact is to hold, the values to be above 0, in fewer than a share of the trials."""
    return Asked(f"in fewer than {100 * fraction:g} %", share_of, _within(-math.inf, fraction))


def same_number(published: float) -> Asked:
    """The mean is to be a published number, whose own uncertainty is unknown."""
    return Asked("agreement", mean_of, _holds(published))


def as_often(fraction: float) -> Asked:
    """A fact is to hold, the values to be above 0, in a stated share of the trials."""
    return Asked(f"agreement with {100 * fraction:g} %", share_of, _holds(fraction))


def not_judged(number: Callable[[Floats], OurNumber]) -> Asked:
    """Ask nothing, because the published number comes from an experiment.

    Args:
        number: Computes our number from the values (n,) of our trials, such as `mean_of`.
    """
    return Asked("nothing: an experiment", number, lambda ours: Fate.NOT_JUDGED)


def _within(low: float, high: float) -> Decide:
    """Return the verdict by the interval: within `low` to `high`, outside, or neither."""

    def decide(ours: OurNumber) -> Fate:
        if low <= ours.low and ours.high <= high:
            return Fate.REACHED
        return Fate.MISSED if ours.high < low or ours.low > high else Fate.UNDECIDED

    return decide


def _holds(published: float) -> Decide:
    """Return the verdict by whether our interval holds a published number."""
    return lambda ours: Fate.AGREES if ours.low <= published <= ours.high else Fate.MISSED


# ---- Claims ----


@dataclass(frozen=True, slots=True)
class Claim:
    """One row of a paper's table, before our trials are measured.

    Attributes:
        figure: The figure or table of the paper.
        published: The published value, as text.
        arm: The arm that is measured.
        measure: Turns a trial of the arm into a number in `unit`, or a fact into 1 or 0.
        asked: The question.
        unit: Unit of the number.
        minus: Another arm, whose measure is subtracted in pairs. None for none.
        expected: The verdict that the page states.
        why: Why the result differs from what is published.
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
class Row:
    """A claim, our number and the verdict."""

    claim: Claim
    ours: OurNumber
    verdict: Fate


def assess(claim: Claim, results: Mapping[str, Sequence[Any]]) -> Row:
    """Measure a claim's trials, which `results` holds by arm, and assess them."""
    values = _measured(claim, results[claim.arm])
    means = None
    if claim.minus is not None:
        subtracted = _measured(claim, results[claim.minus])
        pairs = min(len(values), len(subtracted))
        values = values[:pairs]
        subtracted = subtracted[:pairs]
        means = (float(values.mean()), float(subtracted.mean()))
        values = values - subtracted
    ours = claim.asked.number(values)
    return Row(claim, replace(ours, means=means), claim.asked.decide(ours))


def _measured(claim: Claim, trials: Sequence[Any]) -> Floats:
    """Return the measure (n,) of the trials of one arm."""
    values = np.array([claim.measure(trial) for trial in trials], dtype=float)
    assert np.isfinite(values).all(), f"{claim.figure}: a trial has no such number"
    return values
