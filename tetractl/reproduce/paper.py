"""A paper to reproduce: the trials it needs, and its figures, each next to ours with a verdict.

A figure is an outcome that the paper states, never a number that the spec is given. It is reached
if the 95 % interval of ours lies on the right side of the published number, or holds it where ours
is to agree. It is out of reach only by a bound that no controller can break.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tetractl.core.table.table import Table, lengths
from tetractl.log.read.trial_log import TrialLog
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
class Paper:
    """A paper: its source, the trials by name, and the figures made of their logs."""

    source: str
    arms: Mapping[str, Runs]
    figures: Callable[[Mapping[str, Sequence[TrialLog]]], Iterable[Figure]]


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


def table(name: str, paper: Paper, figures: Sequence[Figure]) -> Table:
    """Return the table of a paper's figures."""
    header = ("figure", "published", "ours", "n", "95 % interval", "verdict", "why")
    rows = [
        (f.what, f.published, f.ours, str(f.n), f.interval, f.verdict.value, f.why) for f in figures
    ]
    return Table.of_texts(f"{name}: {paper.source}", header, rows)
