"""The classes and functions from which the statistics of a batch of trials are made.

A statistic computes figures of a batch and values of each trial. A `Figure` is a line in a table of
the batch (`tables`), and some items in its JSON (`as_json`). The values of a trial are columns of
the CSV table, and items in JSON. `share_figure` and `mean_figure` create figures that have an
interval.

`number`, `count` and `fraction` make the usual statistics from a function of one trial:

    WORST = number("worst", "error of the worst robot", lambda result: max(result.robot_errors))
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tetractl.core.registries import STATISTICS
from tetractl.core.trial import Result
from tetractl.log.read.trial_log import ResultSummary
from tetractl.statistics.estimate import Distribution, distributions, percent, proportion_interval
from tetractl.statistics.open_batch import is_counted
from tetractl.tools.table.table import create_length_format


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of a batch, such as a mean: a line in tables, and items in JSON.

    Attributes:
        label: The label in tables. Empty for a figure that is only in JSON.
        text: The text in tables.
        items: The items in JSON.
        unusual: Whether a reader must see the figure, for example the number of damaged logs. Other
            figures are shown only with `--full`.
        brief: The text in a table of several batches. None to use `text`, empty to leave out the
            figure there.
    """

    label: str
    text: str
    items: Mapping[str, Any] = field(default_factory=dict)
    unusual: bool = True
    brief: str | None = None


def share_figure(
    key: str, label: str, holding: int, trials: int, counting: str = "", unusual: bool = True
) -> Figure:
    """Create a figure: in how many trials a condition holds, with Wilson's interval.

    Args:
        key: Key of the statistic in JSON and CSV.
        label: Label of the statistic in tables.
        holding: Number of trials for which the condition holds.
        trials: Number of trials.
        counting: What the condition refers to, such as "bodies", if that can differ.
        unusual: Whether the figure is unusual; see `Figure`.
    """
    ci95 = proportion_interval(holding, trials)
    count_text = f"{holding} of {trials}"
    text = f"{count_text}{percent(ci95)}"
    items = {key: holding, f"{key}_ci95": ci95.bounds}
    if not counting:
        return Figure(label, text, items, unusual)
    return Figure(
        label, f"{text}, counting {counting}", items, unusual, f"{count_text} ({counting})"
    )


def mean_figure(key: str, label: str, values: Distribution, states_n: bool = False) -> Figure:
    """Create a figure that is a mean with its confidence interval.

    Args:
        key: Key of the statistic.
        label: Its label in tables.
        values: The distribution.
        states_n: Whether the text states the number of trials.
    """
    format_mean = create_length_format(values.mean)
    n_text = f"n {values.n}, " if states_n else ""
    text = f"{format_mean(values.mean)} ({n_text}95 % interval {values.ci95.text(format_mean)})"
    return Figure(label, text, {key: values.as_dict()})


@dataclass(frozen=True, slots=True)
class Statistic:
    """A statistic of a batch: functions that compute its figures and its values for each trial.

    Attributes:
        of_batch: Returns its figures for one or more trials of one experiment.
        of_trial: Returns the columns of one trial in CSV, which are also its items in JSON.
    """

    of_batch: Callable[[Sequence[ResultSummary]], Sequence[Figure]]
    of_trial: Callable[[ResultSummary], dict[str, Any]] = lambda trial: {}


def number(key: str, label: str, number_in: Callable[[Result], float]) -> Statistic:
    """Create a statistic: the mean of a number in each complete trial, with its 95 % interval.

    A trial without a finite number is left out of the mean, and its cell in the table of trials is
    empty. The statistic also has a line in the short table, because `stats` reads results, not the
    steps of the trials.

    Args:
        key: Key of the statistic.
        label: Its label in tables.
        number_in: Returns the number of a trial.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        numbers = [number_in(trial.result) for trial in trials if is_counted(trial)]
        finite = [value for value in numbers if math.isfinite(value)]
        (distribution,) = distributions(np.array([finite]))
        mean = mean_figure(key, f"{label}, mean", distribution)
        tail = distribution.tail
        if not tail.above:
            return [mean]
        return [mean, Figure(f"  {tail.label}", tail.text())]

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        value = number_in(trial.result)
        return {key: value if math.isfinite(value) else None}

    return Statistic(of_batch, of_trial)


def count(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Create a statistic: the number of trials for which a condition holds.

    Args:
        key: Key of the statistic.
        label: Its label in tables.
        holds: The condition.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        holding_count = sum(map(holds, trials))
        return [Figure(label, str(holding_count), {key: holding_count})]

    return Statistic(of_batch)


def fraction(key: str, label: str, holds: Callable[[ResultSummary], bool]) -> Statistic:
    """Create a statistic: the fraction of trials for which a condition holds.

    It has the number of these trials, and Wilson's 95 % interval of the fraction.

    Args:
        key: Key of the statistic.
        label: Its label in tables.
        holds: The condition.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        holding_count = sum(map(holds, trials))
        return [share_figure(key, label, holding_count, len(trials))]

    return Statistic(of_batch)


def statistics() -> list[Statistic]:
    """Return every statistic that can be used, the built-in ones first.

    Statistics of packages that cannot be loaded are left out.
    """
    return list(STATISTICS.load_usable().values())


def trial_items(trial: ResultSummary) -> dict[str, Any]:
    """Return the JSON items of one trial, including the items of every statistic.

    An item of a statistic replaces an earlier one with the same key.
    """
    result = trial.result
    items = {
        "log": trial.log,
        "trial": trial.trial,
        "seed": trial.seed,
        "total_error": result.total_error,
        "robot_errors": list(result.robot_errors),
        "steps": result.steps,
        "duration_s": result.duration_s,
        "origin": trial.origin.value,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "warnings": trial.warnings,
    }
    for statistic in statistics():
        items |= statistic.of_trial(trial)
    items["counted"] = is_counted(trial)
    return items
