"""Statistics of a batch: how its trials ended, how near robots came to obstacles, to the arena's
edge and to one another, and solve times.

Distances are those of the robots' centres, on the true paths of a simulation and the measured ones
in a lab; percentiles of solve times are over all steps of all trials.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.commands import Verdict
from tetractl.core.plan import Outcome
from tetractl.core.table.table import NONE, digits, lengths
from tetractl.experiment.experiment import Experiment
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.statistic import Statistic, Value, fraction, share

_ARRIVED = share("arrived", "arrived", lambda trial: trial.outcome is Outcome.ARRIVED)


def _arrived(trials: Sequence[ResultSummary]) -> Value:
    if trials[0].experiment.controller.arrival_tolerance > 0:
        return replace(_ARRIVED.of_batch(trials), usual=True)
    text = f"{NONE} (no arrival_tolerance)"
    return Value.row("arrived", text, True, arrived=None, arrived_ci95=None)


def _outcomes(trials: Sequence[ResultSummary]) -> Value:
    found = Counter(trial.outcome for trial in trials)
    text = "; ".join(f"{n} {one.value} ({one.meaning})" for one, n in found.most_common())
    ended = {one.value: found[one] for one in (Outcome.ABORTED, Outcome.INTERRUPTED)}
    brief = ", ".join(f"{n} {one.value}" for one, n in found.most_common())
    items = {"outcomes": {one.value: found[one] for one in Outcome}, **ended}
    return Value(items, (("outcomes", text),), brief=brief)


def _recovered(trials: Sequence[ResultSummary]) -> Value:
    found = sum(trial.recovered for trial in trials)
    return Value.row("read from damaged logs", str(found), not found, recovered=found)


OUTCOMES = Statistic(_outcomes)
ARRIVED = Statistic(_arrived)
RECOVERED = Statistic(_recovered, lambda trial: {"recovered": trial.recovered})


Distances = Callable[[Verdict], Sequence[float]]
"""Function that returns the least distance of each robot in a trial [length unit]; empty if the log
has no distances.
"""


def least(key: str, label: str, of: Distances) -> Statistic:
    """Return a statistic: the least distance over all robots and trials.

    A trial whose log lacks the distance is left out; its cell in the table of trials is empty.
    """

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        found = min(of(trial.result.verdict), default=float("inf"))
        return {key: found if found < float("inf") else None}

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        known = [value for trial in trials if (value := of_trial(trial)[key]) is not None]
        unit = trials[0].experiment.units.length
        nearest = min(known, default=None)
        text = NONE if nearest is None else lengths(nearest)(nearest)
        return Value.row(f"{label} [{unit}]", text, True, **{key: nearest})

    return Statistic(of_batch, of_trial)


CLEARANCE = least("clearance", "centre nearest to an obstacle", lambda verdict: verdict.clearance)
EDGE = least("edge", "centre nearest to the arena's edge", lambda verdict: verdict.edge)
APART = least("apart", "centres nearest to one another", lambda verdict: verdict.apart)


SAFETY: dict[str, Callable[[Verdict, float], list[bool]]] = {
    "entered an obstacle": Verdict.in_obstacle,
    "left the arena": Verdict.over_edge,
    "touched one another": Verdict.touched,
}
"""What must not happen, with a function that returns which robots of a given radius did it."""


def unsafe(trial: ResultSummary) -> list[str]:
    """Return the labels in SAFETY of what any robot of a trial did."""
    verdict, radius = trial.result.verdict, trial.experiment.controller.body_radius
    return [label for label, of in SAFETY.items() if any(of(verdict, radius))]


def counted_by(experiment: Experiment) -> str:
    """Return text that states whether bodies or centres are counted."""
    radius = experiment.controller.body_radius
    return f"bodies of radius {radius:g} {experiment.units.length}" if radius else "centres"


def safety(label: str, body: str, centre: tuple[str, str] | None = None) -> Statistic:
    """Return a statistic: the number of trials in which a robot did what `label` in SAFETY says.

    `body` is the key of the count of bodies, which is None without a radius, and `centre` the keys
    of a batch and of a trial of the count of centres.
    """
    of = SAFETY[label]

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        verdict, radius = trial.result.verdict, trial.experiment.controller.body_radius
        found = {centre[1]: any(of(verdict, 0.0))} if centre else {}
        return found | {body: any(of(verdict, radius)) if radius else None}

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        columns = [of_trial(trial) for trial in trials]
        counted = counted_by(trials[0].experiment).partition(" ")[0]
        items, text = {body: None, f"{body}_ci95": None}, f"{NONE} (no radius)"
        usual, brief = label != "entered an obstacle", None
        for key, column in ([centre] if centre else []) + [(body, body)]:
            if columns[0][column] is not None:
                found, share = fraction(key, [one[column] for one in columns])
                items, text = items | found, f"{share}, counting {counted}"
                brief = f"{found[key]} of {len(trials)} ({counted})"
                usual &= not found[key]
        return Value(items, ((label, text),), usual, brief)

    return Statistic(of_batch, of_trial)


OBSTACLE_VIOLATIONS = safety(
    "entered an obstacle", "body_in_obstacle", ("obstacle_violations", "entered_obstacle")
)
LEFT_ARENA = safety("left the arena", "body_over_edge", ("left_arena", "outside_arena"))
TOUCHED = safety("touched one another", "bodies_touch")


def _way_points(trial: ResultSummary) -> dict[str, Any]:
    """Return, for each way-point, the sum of the robots' distances to it when it was passed, None
    if it was not.
    """
    wanted = len(trial.experiment.setup.legs) - 1
    known = (*trial.result.passed, *[None] * wanted)[:wanted]
    return {f"way_point_{i}": error for i, error in enumerate(known, 1)}


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
    of: Callable[[ResultSummary], dict[str, Any]], label: str, show: Callable[[float], str]
) -> Statistic:
    """Return a statistic with the mean over all trials of each column that `of` returns, one row
    per column.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        columns = [of(trial) for trial in trials]
        known = {key: [c[key] for c in columns if c[key] is not None] for key in columns[0]}
        means = {key: float(np.mean(found)) if found else None for key, found in known.items()}
        rows = [
            (f"{label} ({key})", NONE if mean is None else f"{show(mean)} (n {len(known[key])})")
            for key, mean in means.items()
        ]
        return Value(means, tuple(rows))

    return Statistic(of_batch, of)


WAY_POINTS = mean_of_each(_way_points, "mean distance at a way-point, all robots", digits)
LOST = mean_of_each(_lost, "mean number of robots", "{:.3g}".format)
TIME_INSIDE = mean_of_each(
    _time_inside, "mean share of the hold's time within the radius", "{:.3f}".format
)

PERCENTILES = {"p50": 50, "p99": 99, "max": 100}


def _solve_ms(trials: Sequence[ResultSummary]) -> Value:
    solve_ns = [ns for trial in trials for ns in trial.result.solve_ns]
    found: dict[str, float | None] = dict.fromkeys(PERCENTILES)
    if solve_ns:
        solve_ms = np.array(solve_ns, dtype=float) / MILLISECOND
        values = np.percentile(solve_ms, list(PERCENTILES.values())).tolist()
        found = dict(zip(PERCENTILES, values, strict=True))
    rows = [
        (f"solve time {name} [ms]", NONE if value is None else digits(value))
        for name, value in found.items()
    ]
    return Value({"solve_ms": found}, tuple(rows), usual=True)


def _deadline_misses(trials: Sequence[ResultSummary]) -> Value:
    misses = sum(trial.result.deadline_misses for trial in trials)
    usual = not (misses and trials[0].experiment.plant.real_time)  # else they delayed no command
    return Value.row("deadline misses", str(misses), usual, deadline_misses=misses)


SOLVE_MS = Statistic(_solve_ms)
DEADLINE_MISSES = Statistic(
    _deadline_misses, lambda trial: {"deadline_misses": trial.result.deadline_misses}
)
