"""A paper to reproduce: the trials it needs, and its figures, each next to ours with a verdict.

A figure is an outcome that the paper states, never a number that the spec is given. Each row says
what it asks: it is reached if the 95 % interval of ours lies on the right side of the published
number, and agrees if ours and the published one do not differ more than chance explains. It is out
of reach only by a bound that no controller can break.
"""

import json
import signal
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from tetractl.core.children import WorkerPool, fresh_context
from tetractl.core.files import save_whole
from tetractl.core.table.table import Table, lengths
from tetractl.results.estimate import Interval, distributions, proportion_interval


class Fate(StrEnum):
    """What became of a published figure."""

    REACHED = "reached"
    AGREES = "agrees"
    MISSED = "missed"
    OUT = "out of reach"


@dataclass(frozen=True, slots=True)
class Requirement:
    """What is asked of ours: in words, whether its interval meets that, and the verdict if so."""

    text: str
    met: Callable[[Interval], bool]
    fate: Fate = Fate.REACHED


def at_most(bound: float) -> Requirement:
    """Return that the whole interval is at or below a bound."""
    return Requirement("smaller is better", lambda ci: ci.high <= bound)


def at_least(bound: float) -> Requirement:
    """Return that the whole interval is at or above a bound."""
    return Requirement("greater is better", lambda ci: ci.low >= bound)


def near(value: float) -> Requirement:
    """Return that the interval holds a published value whose own uncertainty is unknown."""
    return Requirement("agreement", lambda ci: ci.low <= value <= ci.high, Fate.AGREES)


@dataclass(frozen=True, slots=True)
class Figure:
    """A published figure, and ours over n trials with its 95 % interval; `page` is the verdict that
    docs/explanation/reproduce.md states, and `why` the reason, or the proof, if it is not reached.
    """

    what: str
    published: str
    asked: str
    ours: str
    n: int
    interval: str
    verdict: Fate
    page: Fate
    why: str = ""


@dataclass(frozen=True, slots=True)
class Runs:
    """Trials of a shipped example with values replaced."""

    example: str
    sets: tuple[str, ...] = ()
    trials: int = 20
    then: Callable[[Mapping[str, Sequence[Any]]], tuple[str, ...]] = lambda logs: ()
    """Further values, which depend on the logs of the arms before."""


@dataclass(frozen=True, slots=True)
class Work:
    """What is computed n times and is no trial of a spec: `once`
    returns what is found with a root seed and a number from 0 on."""

    once: Callable[[int, int], dict[str, Any]]
    trials: int = 20

    def results(self, folder: Path, seed: int, count: int, jobs: int) -> list[dict[str, Any]]:
        """Compute what the folder lacks, `jobs` at a time; return all, which it holds as JSON."""
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / f"{seed}-{number:03d}.json" for number in range(count)]
        lacking = [number for number, file in enumerate(files) if not file.exists()]
        once = partial(_keep, self.once, folder, seed)
        if min(jobs, len(lacking)) < 2:
            for number in lacking:
                once(number)
        else:
            pool = WorkerPool(fresh_context(), jobs, "printed in a worker", _tell, _leave_to_parent)
            with pool:
                for ended in as_completed([pool.submit(once, number) for number in lacking]):
                    ended.result()
        return [json.loads(file.read_text()) for file in files]


def _keep(once: Callable[[int, int], dict[str, Any]], folder: Path, seed: int, number: int) -> None:
    save_whole(folder / f"{seed}-{number:03d}.json", json.dumps(once(seed, number)).encode())


def _tell(line: str) -> None:
    print(line, file=sys.stderr)


def _leave_to_parent() -> None:
    """Ignore Ctrl-C in a worker: the parent ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper: its source, the trials by name, the figures made of their logs and of the results of
    `work`, by name too."""

    source: str
    arms: Mapping[str, Runs]
    figures: Callable[[Mapping[str, Sequence[Any]]], Iterable[Figure]]
    work: Mapping[str, Work] = field(default_factory=dict)


def mean(
    what: str,
    published: str,
    values: Sequence[float],
    asked: Requirement,
    page: Fate = Fate.REACHED,
    why: str = "",
    unit: str = "",
) -> Figure:
    """Return a figure whose own is a mean over trials. Its interval, or with equal values the
    point, is to be as `asked`; if not, and the page says so, it is out of reach."""
    (found,) = distributions(np.array([values], dtype=float))
    show = lengths(found.mean)
    ends = found.ci95 if found.ci95.known else Interval(found.mean, found.mean)
    text = f"{show(ends.low)} to {show(ends.high)}" if found.ci95.known else "none"
    ours = f"{show(found.mean)} {unit}".strip()
    verdict = _verdict(asked.met(ends), page, asked.fate)
    return Figure(what, published, asked.text, ours, found.n, text, verdict, page, why)


@dataclass(frozen=True, slots=True)
class Repeated:
    """A published mean and standard deviation of n repetitions."""

    mean: float
    std: float
    n: int

    def of_mean(
        self, what: str, values: Sequence[float], page: Fate, why: str = "", unit: str = ""
    ) -> Figure:
        """Return the figure of the mean: it agrees if Welch's t finds no difference (p > 0.05)."""
        half = float(stats.t.ppf(0.975, self.n - 1)) * self.std / np.sqrt(self.n)
        ours = float(np.mean(values)), float(np.std(values, ddof=1)), len(values)
        p = stats.ttest_ind_from_stats(*ours, self.mean, self.std, self.n, equal_var=False).pvalue
        published = f"{self.mean:g} +- {half:.1f} {unit} (n {self.n})"
        same = Requirement("agreement", lambda _: bool(p > 0.05), Fate.AGREES)
        return mean(what, published, values, same, page, why, unit)

    def of_deviation(
        self, what: str, values: Sequence[float], page: Fate, why: str = "", unit: str = ""
    ) -> Figure:
        """Return the figure of the standard deviation: it agrees if the F test finds no difference
        (p > 0.05). Both have the chi-square interval of normal values."""
        n, found = len(values), float(np.std(values, ddof=1))
        low, high = chi_square_interval(found, n)
        ends = stats.f.ppf([0.025, 0.975], n - 1, self.n - 1)
        same = bool(ends[0] <= (found / self.std) ** 2 <= ends[1])
        show = lengths(found)
        ours, text = f"{show(found)} {unit}".strip(), f"{show(low)} to {show(high)}"
        least, most = chi_square_interval(self.std, self.n)
        published = f"{self.std:g} {unit} (n {self.n}: {least:.0f} to {most:.0f})"
        verdict = _verdict(same, page, Fate.AGREES)
        return Figure(what, published, "agreement", ours, n, text, verdict, page, why)


def chi_square_interval(deviation: float, n: int) -> tuple[float, float]:
    """Return the 95 % interval of the standard deviation of n normal values."""
    low, high = deviation * np.sqrt((n - 1) / stats.chi2.ppf([0.975, 0.025], n - 1))
    return float(low), float(high)


def single(
    what: str, published: float, values: Sequence[float], page: Fate, why: str = "", unit: str = ""
) -> Figure:
    """Return a figure of one published run: it agrees if it lies among the middle 95 % of ours."""
    n, above = len(values), int(np.sum(np.array(values) >= published))
    low, high = np.percentile(values, [2.5, 97.5])
    show = lengths(float(high))
    verdict = _verdict(bool(low <= published <= high), page, Fate.AGREES)
    ours, text = f"{above} of {n} runs larger", f"runs: {show(low)} to {show(high)} {unit}"
    shown = f"{published:g} {unit} (one run)"
    return Figure(what, shown, "agreement", ours, n, text, verdict, page, why)


def share(
    what: str,
    published: str,
    held: Sequence[bool],
    most: float,
    page: Fate = Fate.REACHED,
    why: str = "",
) -> Figure:
    """Return a figure whose own is the share of trials in which something held: at most `most`."""
    count, n = sum(held), len(held)
    ends = proportion_interval(count, n)
    text = f"{100 * ends.low:.0f} to {100 * ends.high:.0f} %"
    verdict = _verdict(count / n <= most, page)
    asked = f"at most {100 * most:g} %" if most else "in no trial"
    return Figure(what, published, asked, f"{count} of {n}", n, text, verdict, page, why)


def _verdict(met: bool, page: Fate, fate: Fate = Fate.REACHED) -> Fate:
    if met:
        return fate
    return Fate.OUT if page is Fate.OUT else Fate.MISSED


def figure_table(name: str, source: str, figures: Sequence[Figure]) -> Table:
    """Return the table of a paper's figures."""
    header = ("figure", "published", "asked", "ours", "n", "95 % interval", "verdict", "why")
    rows = [
        (f.what, f.published, f.asked, f.ours, str(f.n), f.interval, f.verdict, f.why)
        for f in figures
    ]
    return Table.of_texts(f"{name}: {source}", header, rows)
