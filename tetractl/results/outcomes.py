"""Statistics of a batch: how its trials ended, how near robots came to obstacles, to the arena's
edge and to one another, and solve times.

Distances are those of the robots' centres, on the true paths of a simulation and the measured ones
in a lab; percentiles of solve times are over all steps of all trials.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.commands import Verdict
from tetractl.core.plan import Outcome
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.statistic import Statistic
from tetractl.results.statistic_value import (
    Count,
    OutcomeCounts,
    Scalar,
    Share,
    StatisticValue,
    Unknown,
)
from tetractl.tools.table.table import digits, lengths

# ---- How trials ended ----


def _outcomes(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
    counts = Counter(trial.outcome for trial in trials)
    return [
        StatisticValue("outcomes", "outcomes", OutcomeCounts(counts)),
        StatisticValue("aborted", "", Count(counts[Outcome.ABORTED])),
        StatisticValue("interrupted", "", Count(counts[Outcome.INTERRUPTED])),
    ]


def _arrived(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
    if trials[0].experiment.controller.arrival_tolerance <= 0:
        return _unknown_share("arrived", "arrived", "no arrival_tolerance")
    arrived = sum(trial.outcome is Outcome.ARRIVED for trial in trials)
    return [StatisticValue("arrived", "arrived", Share(arrived, len(trials)), unusual=False)]


def _unknown_share(
    key: str, label: str, reason: str, unusual: bool = False
) -> list[StatisticValue]:
    """Return the values of a share that is not known: JSON has the keys of one that is."""
    return [
        StatisticValue(key, label, Unknown(reason), unusual),
        StatisticValue(f"{key}_ci95", "", Unknown()),
    ]


def _recovered(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
    recovered = sum(trial.recovered for trial in trials)
    count = Count(recovered)
    return [StatisticValue("recovered", "read from damaged logs", count, unusual=recovered > 0)]


OUTCOMES = Statistic(_outcomes)
ARRIVED = Statistic(_arrived)
RECOVERED = Statistic(_recovered, lambda trial: {"recovered": trial.recovered})

# ---- How near robots came ----

Distances = Callable[[Verdict], Sequence[float]]
"""Function that returns the least distance of each robot in a trial [length unit]; empty if the log
has no distances.
"""


def least(key: str, label: str, distances_in: Distances) -> Statistic:
    """Return a statistic: the least distance over all robots and trials.

    A trial whose log lacks the distance is left out; its cell in the table of trials is empty.
    """

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        nearest = min(distances_in(trial.result.verdict), default=float("inf"))
        return {key: nearest if nearest < float("inf") else None}

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        distances = [of_trial(trial)[key] for trial in trials]
        nearest = min((value for value in distances if value is not None), default=None)
        number = Unknown() if nearest is None else Scalar(nearest, lengths(nearest))
        unit = trials[0].experiment.units.length
        return [StatisticValue(key, f"{label} [{unit}]", number, unusual=False)]

    return Statistic(of_batch, of_trial)


CLEARANCE = least("clearance", "centre nearest to an obstacle", lambda verdict: verdict.clearance)
EDGE = least("edge", "centre nearest to the arena's edge", lambda verdict: verdict.edge)
APART = least("apart", "centres nearest to one another", lambda verdict: verdict.apart)

# ---- What must not happen ----

ENTERED = "entered an obstacle"
LEFT = "left the arena"
TOUCHED_EACH_OTHER = "touched one another"
SAFETY: dict[str, Callable[[Verdict, float], list[bool]]] = {
    ENTERED: Verdict.in_obstacle,
    LEFT: Verdict.over_edge,
    TOUCHED_EACH_OTHER: Verdict.touched,
}
"""What must not happen, with a function that returns which robots of a given radius did it."""


def unsafe(trial: ResultSummary) -> list[str]:
    """Return the labels in SAFETY of what any robot of a trial did."""
    radius = trial.experiment.controller.body_radius
    verdict = trial.result.verdict
    return [
        label for label, robots_that_did in SAFETY.items() if any(robots_that_did(verdict, radius))
    ]


def counted_by(experiment: Experiment) -> str:
    """Return text that states whether bodies or centres are counted."""
    radius = experiment.controller.body_radius
    return f"bodies of radius {radius:g} {experiment.units.length}" if radius else "centres"


def safety(
    label: str, body_key: str, centre_key: str | None = None, centre_column: str | None = None
) -> Statistic:
    """Return a statistic: the number of trials in which a robot did what `label` in SAFETY says.

    JSON has the count of bodies under `body_key`, null without a radius, and of centres under
    `centre_key`, which is called `centre_column` of a single trial. Tables show the count of bodies
    or, without a radius, that of centres. Of obstacles a reader always sees it, of the others if it
    happened.
    """
    did = SAFETY[label]

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        verdict = trial.result.verdict
        radius = trial.experiment.controller.body_radius
        columns: dict[str, Any] = {}
        if centre_column is not None:
            columns[centre_column] = any(did(verdict, 0.0))
        columns[body_key] = any(did(verdict, radius)) if radius else None
        return columns

    def share_of(trials: Sequence[ResultSummary], radius: float, counting: str) -> Share:
        unsafe_trials = sum(any(did(trial.result.verdict, radius)) for trial in trials)
        return Share(unsafe_trials, len(trials), counting)

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        radius = trials[0].experiment.controller.body_radius
        bodies = share_of(trials, radius, "bodies") if radius else None
        centres = share_of(trials, 0.0, "centres") if centre_key is not None else None
        happened = any(share.count for share in (bodies, centres) if share is not None)
        unusual = happened or label == ENTERED
        if bodies is not None:
            values = [StatisticValue(body_key, label, bodies, unusual)]
        elif centres is not None:
            values = _unknown_share(body_key, "", "no radius")
        else:
            values = _unknown_share(body_key, label, "no radius", unusual)
        if centre_key is not None and centres is not None:
            centre_label = label if bodies is None else ""  # tables show one of the two
            values.append(StatisticValue(centre_key, centre_label, centres, unusual))
        return values

    return Statistic(of_batch, of_trial)


OBSTACLE_VIOLATIONS = safety(
    ENTERED, "body_in_obstacle", centre_key="obstacle_violations", centre_column="entered_obstacle"
)
LEFT_ARENA = safety(LEFT, "body_over_edge", centre_key="left_arena", centre_column="outside_arena")
TOUCHED = safety(TOUCHED_EACH_OTHER, "bodies_touch")

# ---- Means of the numbers of a trial ----


def _way_points(trial: ResultSummary) -> dict[str, Any]:
    """Return, for each way-point, the sum of the robots' distances to it when it was passed, None
    if it was not.
    """
    way_points = len(trial.experiment.setup.legs) - 1
    passed = trial.result.passed[:way_points]
    distances = (*passed, *[None] * (way_points - len(passed)))
    return {f"way_point_{i}": distance for i, distance in enumerate(distances, 1)}


def _time_inside(trial: ResultSummary) -> dict[str, Any]:
    """Return the fraction of the hold's time that each robot was within `hold.radius` of its
    target; None if the hold was not completed.
    """
    if trial.experiment.hold is None:
        return {}
    names = trial.experiment.setup.names
    held = trial.result.outcome.complete and trial.result.inside
    shares = held or [None] * len(names)
    return {f"inside_{name}": share for name, share in zip(names, shares, strict=True)}


def _lost(trial: ResultSummary) -> dict[str, Any]:
    """Return how many robots were lost; empty if the spec ends a trial when a robot is lost."""
    return {} if trial.experiment.on_lost == "stop" else {"lost": sum(trial.result.lost)}


def mean_of_each(
    of_trial: Callable[[ResultSummary], dict[str, Any]], label: str, show: Callable[[float], str]
) -> Statistic:
    """Return a statistic with the mean over all trials of each column that `of_trial` returns."""

    def of_batch(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
        rows = [of_trial(trial) for trial in trials]
        values: list[StatisticValue] = []
        for key in rows[0]:
            numbers = [row[key] for row in rows if row[key] is not None]
            mean = float(np.mean(numbers)) if numbers else None
            number = Scalar(mean, show, n=len(numbers))
            values.append(StatisticValue(key, f"{label} ({key})", number))
        return values

    return Statistic(of_batch, of_trial)


WAY_POINTS = mean_of_each(_way_points, "mean distance at a way-point, all robots", digits)
LOST = mean_of_each(_lost, "mean number of robots", "{:.3g}".format)
TIME_INSIDE = mean_of_each(
    _time_inside, "mean share of the hold's time within the radius", "{:.3f}".format
)

# ---- Time for decisions ----

PERCENTILES = {"p50": 50, "p99": 99, "max": 100}
"""Percentiles of the solve time by their keys."""


def _solve_ms(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
    solve_ns = [ns for trial in trials for ns in trial.result.solve_ns]
    solve_ms = np.array(solve_ns, dtype=float) / MILLISECOND
    values: list[StatisticValue] = []
    for key, percentile in PERCENTILES.items():
        time_ms = float(np.percentile(solve_ms, percentile)) if solve_ns else None
        label = f"solve time {key} [ms]"
        number = Scalar(time_ms, digits)
        values.append(StatisticValue(key, label, number, unusual=False, within="solve_ms"))
    return values


def _deadline_misses(trials: Sequence[ResultSummary]) -> list[StatisticValue]:
    """Return how many deadlines were missed; only where time is real did they delay a command."""
    misses = sum(trial.result.deadline_misses for trial in trials)
    unusual = misses > 0 and trials[0].experiment.plant.real_time
    return [StatisticValue("deadline_misses", "deadline misses", Count(misses), unusual)]


SOLVE_MS = Statistic(_solve_ms)
DEADLINE_MISSES = Statistic(
    _deadline_misses, lambda trial: {"deadline_misses": trial.result.deadline_misses}
)
