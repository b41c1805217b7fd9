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
NORMAL_DEVIATION = 0.35  # deviation of the normal errors around 1: none is negative in practice
BCA_SETS = 500
RESAMPLES = 999
P_ALARM = 0.05  # p below which a test finds a difference


@dataclass(frozen=True)
class Errors:
    """A distribution of errors with a known mean."""

    name: str
    draw: Callable[[np.random.Generator, tuple[int, ...]], Floats]
    mean: float


ERRORS = (
    Errors(
        "normal, deviation 35 %",
        lambda rng, shape: np.abs(rng.normal(1, NORMAL_DEVIATION, shape)),
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
            print(f"| {errors.name} | {n} | {_coverage_of_one_mean(errors, n, sets)} |", flush=True)
    print("\n| errors | n | Welch, alike | Welch, 1 to 4 | both, alike | both, 1 to 4 | paired t |")
    print("|---|---|---|---|---|---|---|")
    for errors in ERRORS:
        for n in SIZES:
            print(
                f"| {errors.name} | {n} | {_coverage_of_differences(errors, n, sets)} |", flush=True
            )
    print("\n| errors | n | signed rank, none | rank sum, none | rank sum, equal means |")
    print("|---|---|---|---|---|")
    for errors in ERRORS:
        for n in SIZES:
            print(f"| {errors.name} | {n} | {_count_false_alarms(errors, n, sets)} |", flush=True)
    print(f"\n{sets} sets for each figure, {min(sets, BCA_SETS)} for BCa.")


def _coverage_of_one_mean(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often intervals contain a mean."""
    rows = errors.draw(np.random.default_rng([n, 1]), (sets, n))
    own_intervals = [distribution.ci95 for distribution in distributions(rows)]
    half_widths = scipy.stats.t.ppf(0.975, n - 1) * rows.std(axis=1, ddof=1) / np.sqrt(n)
    means = rows.mean(axis=1)
    student = [
        Interval(mean - half_width, mean + half_width)
        for mean, half_width in zip(means, half_widths, strict=True)
    ]
    methods = own_intervals, student, _bca_intervals(rows[:BCA_SETS])
    return " | ".join(_format_percent(_coverage(intervals, errors.mean)) for intervals in methods)


def _bca_intervals(rows: Floats) -> list[Interval]:
    """Compute BCa bootstrap intervals, each with its own seed."""
    bca_intervals = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)
        for seed, row in enumerate(rows):
            ends = scipy.stats.bootstrap(
                [row], np.mean, n_resamples=RESAMPLES, method="BCa", rng=np.random.default_rng(seed)
            ).confidence_interval
            low_end = float(ends.low)
            bca_intervals.append(Interval(low_end, float(ends.high)))
    return bca_intervals


def _coverage_of_differences(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often intervals contain the difference of two means.

    Errors are equally large on both sides, or four times as large on one side. In pairs, both
    trials share half of their error.
    """
    rng = np.random.default_rng([n, 2])
    ours, theirs, shared = (errors.draw(rng, (sets, n)) for _ in range(3))
    cells = []
    for interval in (_welch_interval, from_both_intervals):
        for factor in (1, 4):
            pairs = zip(distributions(ours), distributions(factor * theirs), strict=True)
            intervals_found = [interval(first, second) for first, second in pairs]
            cells.append(_format_percent(_coverage(intervals_found, errors.mean * (1 - factor))))
    differences = (ours + shared) / 2 - 4 * (theirs + shared) / 2
    intervals_found = [paired_t(difference).ci95 for difference in differences]
    cells.append(_format_percent(_coverage(intervals_found, -3 * errors.mean)))
    return " | ".join(cells)


def _count_false_alarms(errors: Errors, n: int, sets: int) -> str:
    """Return the cells of one row: how often rank tests give a false alarm.

    The tests compare two equal batches, paired and unpaired, and two batches with the same mean, of
    which one varies four times as much.
    """
    rng = np.random.default_rng([n, 3])
    ours, theirs = (errors.draw(rng, (sets, n)) for _ in range(2))
    wider = 4 * (theirs - errors.mean) + errors.mean
    alarms = [
        np.mean([signed_rank(our) < P_ALARM for our in ours - theirs]),
        np.mean([rank_sum(*two) < P_ALARM for two in zip(ours, theirs, strict=True)]),
        np.mean([rank_sum(*two) < P_ALARM for two in zip(ours, wider, strict=True)]),
    ]
    return " | ".join(_format_percent(float(alarm)) for alarm in alarms)


def _welch_interval(first, second) -> Interval:
    return welch(first.n, first.mean, first.std, second.n, second.mean, second.std).ci95


def _coverage(intervals: Iterable[Interval], true_value: float) -> float:
    return float(
        np.mean([interval_of.low <= true_value <= interval_of.high for interval_of in intervals])
    )


def _format_percent(share: float) -> str:
    return f"{100 * share:.1f}"


if __name__ == "__main__":
    main()
