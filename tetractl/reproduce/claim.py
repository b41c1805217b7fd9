"""What a paper claims of a figure, what is asked of our trials, and the verdict.

A claim is an outcome that the paper states, never a number that the spec is given. Our trials give
an `OurNumber`, with n and its 95 % interval [low, high] (a point if all values are equal). The
verdict follows from the interval by one rule for every kind of claim:

    reached    the whole interval is on the side that is asked
    agrees     what is asked is the published number itself, and chance explains the difference
    missed     the whole interval is on the other side, or chance does not explain the difference
    undecided  the interval holds the bound: more trials would decide
    out of reach   not reached, and a bound that no controller can break says why

So a share can be missed and reached, but only by enough trials: 0 of 20 does not show that fewer
than 5 % of all trials would do the same, as its interval ends at 16 %.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from scipy import stats

from tetractl.core.poses import Floats
from tetractl.results.estimate import Interval, distributions, proportion_interval

CONFIDENCE = 0.95
"""Of all intervals and tests here."""
_ENDS = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
"""Probabilities below the ends of such an interval."""


class Fate(StrEnum):
    """What became of a claim."""

    REACHED = "reached"
    AGREES = "agrees"
    MISSED = "missed"
    UNDECIDED = "undecided"
    OUT = "out of reach"


class NumberKind(StrEnum):
    """What a number of ours is."""

    MEAN = "mean"
    DEVIATION = "standard deviation"
    SHARE = "share of trials in which a fact holds"
    RUNS = "share of runs as large as the published one"


@dataclass(frozen=True, slots=True)
class OurNumber:
    """Our number over n trials, with the ends of its 95 % interval; of RUNS, the interval is the
    middle 95 % of the runs. `means` are ours and the other controller's mean, where `value` is a
    difference."""

    kind: NumberKind
    value: float
    n: int
    low: float
    high: float
    means: tuple[float, float] | None = None


class Requirement(Protocol):
    """What is asked of the values (n,) of our trials."""

    @property
    def words(self) -> str:
        """What is asked, for the table."""
        ...

    def number(self, values: Floats) -> OurNumber:
        """Return the number that is compared, and its interval."""
        ...

    def verdict(self, values: Floats) -> Fate:
        """Return the verdict on the values."""
        ...


def mean_of(values: Floats) -> OurNumber:
    """Return the mean of values (n,) with its interval (Student's t; `results.estimate`)."""
    summary = distributions(values[None])[0]
    interval = summary.ci95 if summary.ci95.known else Interval(summary.mean, summary.mean)
    return OurNumber(NumberKind.MEAN, summary.mean, summary.n, interval.low, interval.high)


def share_of(values: Floats) -> OurNumber:
    """Return the share of values (n,), 1 or 0, that are 1, with Wilson's interval."""
    n = len(values)
    count = int(np.sum(values > 0))
    interval = proportion_interval(count, n)
    return OurNumber(NumberKind.SHARE, count / n, n, interval.low, interval.high)


@dataclass(frozen=True, slots=True)
class AtMost:
    """The mean is to be at or below a bound."""

    bound: float
    words = "smaller is better"

    def number(self, values: Floats) -> OurNumber:
        """Return the mean."""
        return mean_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Compare the interval of the mean with the bound."""
        mean = mean_of(values)
        if mean.high <= self.bound:
            return Fate.REACHED
        return Fate.MISSED if mean.low > self.bound else Fate.UNDECIDED


@dataclass(frozen=True, slots=True)
class AtLeast:
    """The mean is to be at or above a bound."""

    bound: float
    words = "greater is better"

    def number(self, values: Floats) -> OurNumber:
        """Return the mean."""
        return mean_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Compare the interval of the mean with the bound."""
        mean = mean_of(values)
        if mean.low >= self.bound:
            return Fate.REACHED
        return Fate.MISSED if mean.high < self.bound else Fate.UNDECIDED


@dataclass(frozen=True, slots=True)
class SameNumber:
    """The mean is to be a published number, whose own uncertainty is unknown: our interval holds
    it."""

    published: float
    words = "agreement"

    def number(self, values: Floats) -> OurNumber:
        """Return the mean."""
        return mean_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Compare the interval of the mean with the published number."""
        mean = mean_of(values)
        return Fate.AGREES if mean.low <= self.published <= mean.high else Fate.MISSED


@dataclass(frozen=True, slots=True)
class SameMean:
    """The mean is to be that of n published values with a standard deviation: Welch's t finds no
    difference (p > 0.05)."""

    mean: float
    std: float
    n: int
    words = "agreement"

    def number(self, values: Floats) -> OurNumber:
        """Return the mean."""
        return mean_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Test the difference of the means."""
        test = stats.ttest_ind_from_stats(
            float(np.mean(values)),
            _deviation(values),
            len(values),
            self.mean,
            self.std,
            self.n,
            equal_var=False,
        )
        return Fate.AGREES if test.pvalue > 1 - CONFIDENCE else Fate.MISSED


@dataclass(frozen=True, slots=True)
class SameDeviation:
    """The standard deviation is to be that of n published values: the F test finds no difference
    (p > 0.05). Its interval is the chi-square interval of normal values."""

    std: float
    n: int
    words = "agreement"

    def number(self, values: Floats) -> OurNumber:
        """Return the standard deviation."""
        std = _deviation(values)
        low, high = chi_square_interval(std, len(values))
        return OurNumber(NumberKind.DEVIATION, std, len(values), low, high)

    def verdict(self, values: Floats) -> Fate:
        """Test the ratio of the variances."""
        std = _deviation(values)
        ratio = (std / self.std) ** 2
        low, high = stats.f.ppf(_ENDS, len(values) - 1, self.n - 1)
        return Fate.AGREES if low <= ratio <= high else Fate.MISSED


@dataclass(frozen=True, slots=True)
class OneRun:
    """One published run is to be among the middle 95 % of ours, which are its interval here."""

    value: float
    words = "agreement"

    def number(self, values: Floats) -> OurNumber:
        """Return the share of our runs that are as large, between the ends of the middle 95 %."""
        low, high = np.quantile(values, _ENDS).tolist()
        share = float(np.mean(values >= self.value))
        return OurNumber(NumberKind.RUNS, share, len(values), low, high)

    def verdict(self, values: Floats) -> Fate:
        """Compare the published run with the middle of ours."""
        runs = self.number(values)
        return Fate.AGREES if runs.low <= self.value <= runs.high else Fate.MISSED


@dataclass(frozen=True, slots=True)
class Rarely:
    """A fact is to hold in fewer than `share` of the trials; the values are 1 where it holds, else
    0. Its interval is Wilson's."""

    share: float = 0.05

    @property
    def words(self) -> str:
        """What is asked."""
        return f"in fewer than {100 * self.share:g} %"

    def number(self, values: Floats) -> OurNumber:
        """Return the share of trials in which the fact holds."""
        return share_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Compare the interval of the share with what is allowed."""
        ours = share_of(values)
        if ours.high <= self.share:
            return Fate.REACHED
        return Fate.MISSED if ours.low > self.share else Fate.UNDECIDED


@dataclass(frozen=True, slots=True)
class AsOften:
    """A fact is to hold in a stated share of trials: Wilson's interval of ours holds that share."""

    share: float

    @property
    def words(self) -> str:
        """What is asked."""
        return f"agreement with {100 * self.share:g} %"

    def number(self, values: Floats) -> OurNumber:
        """Return the share of trials in which the fact holds."""
        return share_of(values)

    def verdict(self, values: Floats) -> Fate:
        """Compare the interval of the share with the stated one."""
        ours = share_of(values)
        return Fate.AGREES if ours.low <= self.share <= ours.high else Fate.MISSED


def _deviation(values: Floats) -> float:
    """Return the standard deviation of values, NaN of a single one."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def chi_square_interval(std: float, n: int) -> tuple[float, float]:
    """Return the 95 % interval of the standard deviation of n normal values."""
    quantiles = stats.chi2.ppf(_ENDS[::-1], n - 1)
    low, high = std * np.sqrt((n - 1) / quantiles)
    return float(low), float(high)


@dataclass(frozen=True, slots=True)
class Claim:
    """One row of a paper's table, before our trials are measured.

    `measure` turns a trial of the arm `arm` into a number, or a fact into 1 or 0, in `unit`. With
    `minus`, the same is measured of that arm, and the paired differences are assessed. `expected`
    is the verdict that the page states, and `why` its reason, if it is not reached.
    """

    figure: str
    published: str
    arm: str
    measure: Callable[[Any], float]
    asked: Requirement
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
    verdict = claim.asked.verdict(values)
    if claim.expected is Fate.OUT and verdict is not Fate.REACHED:
        verdict = Fate.OUT
    return Row(claim, replace(claim.asked.number(values), means=means), verdict)


def _measured(claim: Claim, trials: Sequence[Any]) -> Floats:
    """Return the measure (n,) of the trials of one arm."""
    values = np.array([claim.measure(trial) for trial in trials], dtype=float)
    assert np.isfinite(values).all(), f"{claim.figure}: a trial has no such number"
    return values
