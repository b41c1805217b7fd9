"""Statistics of a batch, shown in tables and JSON; their values for single trials are columns of
the CSV table of trials.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tetractl.core.registries import STATISTICS
from tetractl.core.trial import Result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.estimate import distributions
from tetractl.results.open_batch import counts
from tetractl.results.statistic_value import AboveBound, Count, Mean, Share, StatisticValue


def _no_columns(trial: ResultSummary) -> dict[str, Any]:
    return {}


@dataclass(frozen=True, slots=True)
class Statistic:
    """How to compute a statistic: `of_batch` returns its values for one or more trials of one
    experiment; `of_trial` returns the columns of one trial in CSV, which are also its items in
    JSON.
    """

    of_batch: Callable[[Sequence[ResultSummary]], Sequence[StatisticValue]]
    of_trial: Callable[[ResultSummary], dict[str, Any]] = _no_columns


def number(key: str, label: str, number_in: Callable[[Result], float]) -> Statistic:
    """Return a statistic: the mean and its 95 % interval, over complete trials, of a number per
    trial.

    A trial without a finite number is left out of the mean; its cell in the table of trials is
    empty.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        numbers = [number_in(trial.result) for trial in trials if counts(trial)]
        finite = [value for value in numbers if math.isfinite(value)]
        (distribution,) = distributions(np.array([finite]))
        mean = StatisticValue(key, f"{label}, mean", Mean(distribution))
        tail = distribution.tail
        if not tail.above:
            return [mean]
        return [mean, StatisticValue("", f"  {tail.label}", AboveBound(tail))]

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        value = number_in(trial.result)
        return {key: value if math.isfinite(value) else None}

    return Statistic(of_batch, of_trial)


def count(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Return a statistic: the number of trials for which the condition `holds` is true."""

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        holding = sum(map(holds, trials))
        return [StatisticValue(key, label, Count(holding))]

    return Statistic(of_batch)


def share(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Return a statistic: the number of trials for which the condition `holds` is true, with
    Wilson's 95 % interval of their fraction.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        holding = sum(map(holds, trials))
        return [StatisticValue(key, label, Share(holding, len(trials)))]

    return Statistic(of_batch)


def statistics() -> list[Statistic]:
    """Return every usable statistic, the built-in ones first."""
    return list(STATISTICS.usable().values())
