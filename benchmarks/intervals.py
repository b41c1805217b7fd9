"""Measures how often the 95 % intervals of `tetractl stats` contain the true value.

    python benchmarks/intervals.py                a few minutes
    python benchmarks/intervals.py --sets 500

The script samples many sets of n errors from distributions with known means, and prints the figures
of docs/reference/statistics.md as Markdown, in percent. It counts how many intervals contain a
single mean, with Student's t and with the BCa bootstrap, and how many contain the difference of two
means. It also counts how many rank tests find a difference where there is none. The seed is fixed.
"""

import argparse
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from tetractl.core.poses import Floats
from tetractl.statistics.estimate import Interval, distributions
from tetractl.statistics.mean_difference import (
    from_both_intervals,
    paired_t,
    rank_sum,
    signed_rank,
    welch,
)

SIZES = (8, 20)
SPREAD = 0.35  # deviation of the normal errors around 1: none is negative in practice
BCA_SETS = 500
RESAMPLES = 999
ALARM = 0.05  # p below which a test finds a difference


@dataclass(frozen=True)
class Errors:
    """A distribution of errors with a known mean."""

    name: str
    draw: Callable[[np.random.Generator, tuple[int, ...]], Floats]
    mean: float


ERRORS = (
    Errors(
        "normal, deviation 35 %",
        lambda rng, shape: np.abs(rng.normal(1, SPREAD, shape)),
        1.0,
    ),
    *(
        Errors(
            f"lognormal, sigma {sigma:g}",
            lambda rng, shape, sigma=sigma: rng.lognormal(0, sigma, shape),
            float(scipy.stats.lognorm(sigma).mean()),
        )
        for sigma in (0.5, 1)
    ),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=4000, help="sets of n errors for each figure")
    sets = parser.parse_args().sets
    print("| errors | n | `log-t` | Student's t | BCa |")
    print("|---|---|---|---|---|")
    for errors in ERRORS:
        for n in SIZES:
            print(f"| {errors.name} | {n} | {_one_mean(errors, n, sets)} |", flush=True)
    print("\n| errors | n | Welch, alike | Welch, 1 to 4 | both, alike | both, 1 to 4 | paired t |")
    print("|---|---|---|---|---|---|---|")
    for errors in ERRORS:
        for n in SIZES:
            print(f"| {errors.name} | {n} | {_two_means(errors, n, sets)} |", flush=True)
    print("\n| errors | n | signed rank, none | rank sum, none | rank sum, equal means |")
    print("|---|---|---|---|---|")
    for errors in ERRORS:
        for n in SIZES:
            print(f"| {errors.name} | {n} | {_false_alarms(errors, n, sets)} |", flush=True)
    print(f"\n{sets} sets for each figure, {min(sets, BCA_SETS)} for BCa.")


def _one_mean(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often intervals contain a mean."""
    rows = errors.draw(np.random.default_rng([n, 1]), (sets, n))
    ours = [distribution.ci95 for distribution in distributions(rows)]
    half = scipy.stats.t.ppf(0.975, n - 1) * rows.std(axis=1, ddof=1) / np.sqrt(n)
    middle = rows.mean(axis=1)
    student = [Interval(m - h, m + h) for m, h in zip(middle, half, strict=True)]
    methods = ours, student, _bca(rows[:BCA_SETS])
    return " | ".join(_percent(_share(intervals, errors.mean)) for intervals in methods)


def _bca(rows: Floats) -> list[Interval]:
    """Compute BCa bootstrap intervals, each with its own seed."""
    bca_intervals = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)
        for seed, row in enumerate(rows):
            ends = scipy.stats.bootstrap(
                [row], np.mean, n_resamples=RESAMPLES, method="BCa", rng=np.random.default_rng(seed)
            ).confidence_interval
            low = float(ends.low)
            bca_intervals.append(Interval(low, float(ends.high)))
    return bca_intervals


def _two_means(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often intervals contain the difference of two means.

    Errors are equally large on both sides, or four times as large on one side. In pairs, both
    trials share half of their error.
    """
    rng = np.random.default_rng([n, 2])
    ours, theirs, common = (errors.draw(rng, (sets, n)) for _ in range(3))
    cells = []
    for interval in (_welch, from_both_intervals):
        for factor in (1, 4):
            pairs = zip(distributions(ours), distributions(factor * theirs), strict=True)
            intervals_found = [interval(first, second) for first, second in pairs]
            cells.append(_percent(_share(intervals_found, errors.mean * (1 - factor))))
    differences = (ours + common) / 2 - 4 * (theirs + common) / 2
    intervals_found = [paired_t(difference).ci95 for difference in differences]
    cells.append(_percent(_share(intervals_found, -3 * errors.mean)))
    return " | ".join(cells)


def _false_alarms(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often rank tests give a false alarm.

    The tests compare two equal batches, paired and unpaired, and two batches with the same mean, of
    which one varies four times as much.
    """
    rng = np.random.default_rng([n, 3])
    ours, theirs = (errors.draw(rng, (sets, n)) for _ in range(2))
    wide = 4 * (theirs - errors.mean) + errors.mean
    alarms = [
        np.mean([signed_rank(our) < ALARM for our in ours - theirs]),
        np.mean([rank_sum(*two) < ALARM for two in zip(ours, theirs, strict=True)]),
        np.mean([rank_sum(*two) < ALARM for two in zip(ours, wide, strict=True)]),
    ]
    return " | ".join(_percent(float(alarm)) for alarm in alarms)


def _welch(first, second) -> Interval:
    return welch(first.n, first.mean, first.std, second.n, second.mean, second.std).ci95


def _share(intervals: Iterable[Interval], true: float) -> float:
    return float(
        np.mean([interval_of.low <= true <= interval_of.high for interval_of in intervals])
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


if __name__ == "__main__":
    main()
