"""A paper to reproduce: the trials it needs, and its figures, each next to ours with a verdict.

A figure is an outcome that the paper states, never a number that the spec is given. It is reached
if the 95 % interval of ours lies on the right side of the published number, or holds it where ours
is to agree. It is out of reach only by a bound that no controller can break.
"""

import json
import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from tetractl.core.files import save_whole
from tetractl.core.table.table import Table, lengths
from tetractl.results.estimate import Interval, distributions, proportion_interval


class Fate(StrEnum):
    """What became of a published figure."""

    REACHED = "reached"
    MISSED = "missed"
    OUT = "out of reach"


@dataclass(frozen=True, slots=True)
class Figure:
    """A published figure, and ours over n trials with its 95 % interval; `page` is the verdict that
    docs/explanation/reproduce.md states, and `why` the reason, or the proof, if it is not reached.
    """

    what: str
    published: str
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
            with get_context("spawn").Pool(jobs, _leave_to_parent) as pool:
                for _ in pool.imap_unordered(once, lacking):
                    pass
        return [json.loads(file.read_text()) for file in files]


def _keep(once: Callable[[int, int], dict[str, Any]], folder: Path, seed: int, number: int) -> None:
    save_whole(folder / f"{seed}-{number:03d}.json", json.dumps(once(seed, number)).encode())


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
    reached: Callable[[Interval], bool],
    page: Fate = Fate.REACHED,
    why: str = "",
    unit: str = "",
) -> Figure:
    """Return a figure whose own is a mean over trials. It is `reached` as the mean's interval says
    or, with equal values, as a point; if not, and the page says so, it is out of reach."""
    (found,) = distributions(np.array([values], dtype=float))
    show = lengths(found.mean)
    ends = found.ci95 if found.ci95.known else Interval(found.mean, found.mean)
    text = f"{show(ends.low)} to {show(ends.high)}" if found.ci95.known else "none"
    ours = f"{show(found.mean)} {unit}".strip()
    return Figure(what, published, ours, found.n, text, _verdict(reached(ends), page), page, why)


def deviation(
    what: str, published: float, values: Sequence[float], page: Fate, why: str = "", unit: str = ""
) -> Figure:
    """Return a figure whose own is the standard deviation over trials, with the chi-square interval
    of normal values; it is reached if that holds the published one."""
    n, found = len(values), float(np.std(values, ddof=1))
    low, high = found * np.sqrt((n - 1) / chi2.ppf([0.975, 0.025], n - 1))
    show = lengths(found)
    ours, text = f"{show(found)} {unit}".strip(), f"{show(low)} to {show(high)}"
    verdict = _verdict(bool(low <= published <= high), page)
    return Figure(what, f"{published:g} {unit}".strip(), ours, n, text, verdict, page, why)


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
    return Figure(what, published, f"{count} of {n}", n, text, verdict, page, why)


def _verdict(reached: bool, page: Fate) -> Fate:
    if reached:
        return Fate.REACHED
    return Fate.OUT if page is Fate.OUT else Fate.MISSED


def figure_table(name: str, source: str, figures: Sequence[Figure]) -> Table:
    """Return the table of a paper's figures."""
    header = ("figure", "published", "ours", "n", "95 % interval", "verdict", "why")
    rows = [(f.what, f.published, f.ours, str(f.n), f.interval, f.verdict, f.why) for f in figures]
    return Table.of_texts(f"{name}: {source}", header, rows)
