"""Statistics of a batch, shown in tables and JSON; their values for single trials are columns of
the CSV table of trials.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from tetractl.core.registries import STATISTICS
from tetractl.core.table.table import lengths
from tetractl.core.trial import Result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.estimate import distributions, percent, proportion_interval
from tetractl.results.open_batch import counts


@dataclass(frozen=True, slots=True)
class Value:
    """The value of a statistic: by key for JSON (`items`), and as rows of label and text for a
    table. The rows of a `usual` value, such as no damaged log, are shown with `--full` only.
    Without it, `brief` stands for the text of a row next to those of other batches; if it is "",
    the row is left out.
    """

    items: dict[str, Any]
    rows: tuple[tuple[str, str], ...]
    usual: bool = False
    brief: str | None = None

    @classmethod
    def row(cls, label: str, text: str, usual: bool = False, /, **items: Any) -> Self:
        """Return a value with one row."""
        return cls(items, ((label, text),), usual)


@dataclass(frozen=True, slots=True)
class Statistic:
    """How to compute a statistic: `of_batch` returns its value for one or more trials of one
    experiment; `of_trial` returns the columns of one trial in CSV, which are also its items in
    JSON.
    """

    of_batch: Callable[[Sequence[ResultSummary]], Value]
    of_trial: Callable[[ResultSummary], dict[str, Any]] = lambda trial: {}


def number(key: str, label: str, of: Callable[[Result], float]) -> Statistic:
    """Return a statistic: the mean and its 95 % interval, over complete trials, of a number per
    trial.

    A trial without a finite number is left out of the mean; its cell in the table of trials is
    empty.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        values = [of(trial.result) for trial in trials if counts(trial)]
        (found,) = distributions(np.array([[value for value in values if math.isfinite(value)]]))
        show = lengths(found.mean)
        text = f"{show(found.mean)} (95 % interval {found.ci95.text(show)})"
        rows = [(f"{label}, mean", text)]
        if found.tail.above:
            rows.append((f"  {found.tail.label}", found.tail.text()))
        return Value({key: found.as_dict()}, tuple(rows))

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        value = of(trial.result)
        return {key: value if math.isfinite(value) else None}

    return Statistic(of_batch, of_trial)


def count(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Return a statistic: the number of trials for which the condition `holds` is true."""

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        found = sum(map(holds, trials))
        return Value.row(label, str(found), **{key: found})

    return Statistic(of_batch)


def fraction(key: str, holds: Sequence[bool]) -> tuple[dict[str, Any], str]:
    """Return how many values are true, with Wilson's 95 % interval of their fraction: as items of
    JSON, and as text.
    """
    found, interval = sum(holds), proportion_interval(sum(holds), len(holds))
    items = {key: found, f"{key}_ci95": interval.ends}
    return items, f"{found} of {len(holds)}{percent(interval)}"


def share(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Return a statistic: the number of trials for which the condition `holds` is true, with
    Wilson's 95 % interval of their fraction.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        items, text = fraction(key, [holds(trial) for trial in trials])
        return Value.row(label, text, **items)

    return Statistic(of_batch)


def statistics() -> list[Statistic]:
    """Return every usable statistic, the built-in ones first."""
    return list(STATISTICS.usable().values())
