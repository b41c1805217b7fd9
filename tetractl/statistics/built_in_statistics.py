"""The built-in statistics of a batch.

They describe how the trials of a batch ended; how near robots came to obstacles, to the arena's
edge and to each other; which events occurred that should never happen; how close robots stayed to
their targets; and how long the controller took to plan.

Distances are between the robots' centres, on the true paths of a simulation and the measured paths
in a lab. Percentiles of solve times are over all steps of all trials.

To add a statistic, write it here. Add a line to STATISTICS of `core/registries.py`, at the
statistic's place in the tables, and a row to docs/reference/statistics.md. Tables, JSON, CSV and
the report then contain it. Most statistics are one line, made from a number in each trial's
`Result` of `core/trial.py`:

    WORST = number("worst", "error of the worst robot", lambda result: max(result.robot_errors))

`number`, `count` and `fraction` are in `statistic`. In this module, `total` creates a count of
events that should never happen, `minimum` a minimum distance, and `mean_of_each` the means of
columns. The table without `--full` has only the statistics that are `unusual`. A value that a
`Result` lacks can become a field of it. Only values that few specs need are read from whole logs,
as in `discs`, because that takes 100 times as long.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.motion_estimate import LAG_ERROR_S
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.core.trial import Verdict
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import ResultSummary, TrialLog
from tetractl.statistics.estimate import distributions
from tetractl.statistics.flagged import (
    ENTERED_OBSTACLE,
    LEFT_ARENA,
    SAFETY,
    TOUCHED_EACH_OTHER,
    TrialTurn,
    compare_turns,
    turn_columns,
)
from tetractl.statistics.statistic import Figure, Statistic, mean_figure, share_figure
from tetractl.tools.table.table import (
    UNKNOWN_TEXT,
    create_length_format,
    format_digits,
    join_listed,
)

# ---- How trials ended ----

MEANINGS: Mapping[Outcome, str] = {
    Outcome.ARRIVED: "every robot is within the arrival tolerance of its target",
    Outcome.SEQUENCE_COMPLETED: "every signal was sent",
    Outcome.NO_BETTER_PLAN: "stopped where driving on would gain too little",
    Outcome.STEPS_MAX: "the largest number of control steps was reached",
    Outcome.TIME_LIMIT: "the trial's time was over",
    Outcome.INTERRUPTED: "Ctrl-C, `tetractl lab stop` or another signal ended the trial",
    Outcome.ABORTED: "a fault or an error ended the trial",
}
"""Explanation of each outcome, for readers of tables and reports."""
REASONS_MAX = 3
"""Maximum number of different reasons for aborts that a table names."""


def _outcome_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    count_by_outcome = Counter(trial.outcome for trial in trials)
    most_common = count_by_outcome.most_common()
    items = {
        "outcomes": {outcome.value: count_by_outcome[outcome] for outcome in Outcome},
        "aborted": count_by_outcome[Outcome.ABORTED],
        "interrupted": count_by_outcome[Outcome.INTERRUPTED],
    }
    meanings = {**MEANINGS, Outcome.ABORTED: _abort_reasons(trials)}
    text = "; ".join(f"{n} {outcome.value} ({meanings[outcome]})" for outcome, n in most_common)
    brief = ", ".join(f"{n} {outcome.value}" for outcome, n in most_common)
    return [Figure("outcomes", text, items, brief=brief)]


def _abort_reasons(trials: Sequence[ResultSummary]) -> str:
    """Describe why trials were aborted, the most frequent reason first.

    If there are several reasons, each has its number of trials.
    """
    aborted = [trial for trial in trials if trial.outcome is Outcome.ABORTED]
    count_by_reason = Counter(trial.result.reason or MEANINGS[Outcome.ABORTED] for trial in aborted)
    if len(count_by_reason) == 1:
        return next(iter(count_by_reason))
    most_frequent = [f"{n} x {reason}" for reason, n in count_by_reason.most_common(REASONS_MAX)]
    other_count = len(aborted) - sum(n for _, n in count_by_reason.most_common(REASONS_MAX))
    return "; ".join(
        [*most_frequent, f"{other_count} x other reasons"] if other_count else most_frequent
    )


def _arrived_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    if trials[0].experiment.controller.arrival_tolerance <= 0:
        return [_unknown_fraction("arrived", "arrived", "no arrival_tolerance")]
    arrived = sum(trial.outcome is Outcome.ARRIVED for trial in trials)
    return [share_figure("arrived", "arrived", arrived, len(trials), unusual=False)]


def _unknown_fraction(key: str, label: str, reason: str, unusual: bool = False) -> Figure:
    """Create the figure of a fraction that is not known, for the given reason.

    Its JSON has the same keys as the figure of a known fraction, with the value None.
    """
    items = {key: None, f"{key}_ci95": None}
    return Figure(label, f"{UNKNOWN_TEXT} ({reason})", items, unusual)


def total(
    key: str,
    label: str,
    number_in: Callable[[ResultSummary], int],
    matters: Callable[[ResultSummary], bool] = lambda trial: True,
) -> Statistic:
    """Create a statistic that counts events that should never happen.

    Every table shows the count if it is not 0 and matters for these trials.

    Args:
        key: Key of the statistic in JSON and CSV.
        label: Label of the statistic in tables.
        number_in: Returns the number of events in a trial.
        matters: Decides whether the events matter, from the first of the trials.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        number = sum(map(number_in, trials))
        return [Figure(label, str(number), {key: number}, number > 0 and matters(trials[0]))]

    return Statistic(of_batch, lambda trial: {key: number_in(trial)})


OUTCOMES = Statistic(_outcome_figures)
ARRIVED = Statistic(_arrived_figures)
RECOVERED = total("recovered", "read from damaged logs", lambda trial: trial.recovered)

# ---- How near robots came ----

Distances = Callable[[Verdict], Sequence[float]]
"""A function that returns the minimum distance of each robot in a trial [length unit].

The result is empty if the log has no distances.
"""


def minimum(key: str, label: str, distances_in: Distances) -> Statistic:
    """Create a statistic: the minimum distance over all robots and trials.

    A trial whose log lacks the distance is left out. Its cell in the table of trials is empty.

    Args:
        key: Key of the statistic.
        label: Its label in tables.
        distances_in: Returns the distances of a trial.
    """

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        nearest = min(distances_in(trial.result.verdict), default=float("inf"))
        return {key: nearest if nearest < float("inf") else None}

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        distances = [of_trial(trial)[key] for trial in trials]
        nearest = min((value for value in distances if value is not None), default=None)
        text = UNKNOWN_TEXT if nearest is None else create_length_format(nearest)(nearest)
        unit = trials[0].experiment.units.length
        return [Figure(f"{label} [{unit}]", text, {key: nearest}, unusual=False)]

    return Statistic(of_batch, of_trial)


CLEARANCE = minimum("clearance", "centre nearest to an obstacle", lambda verdict: verdict.clearance)
EDGE = minimum("edge", "centre nearest to the arena's edge", lambda verdict: verdict.edge)
APART = minimum("apart", "centres nearest to one another", lambda verdict: verdict.apart)
LENGTHS = ("clearance", "edge", "apart")
"""The columns of a trial that are lengths: in CSV their names end in the unit."""

# ---- What must not happen ----


def safety(
    label: str, body_key: str, centre_key: str | None = None, centre_column: str | None = None
) -> Statistic:
    """Create a statistic that counts the trials in which a robot did something unsafe.

    SAFETY lists the labels of unsafe events. Tables show the count for bodies or, if the radius of
    the robots is not known, the count for centres. The line about obstacles is always shown, the
    others only if the event happened.

    Args:
        label: The label.
        body_key: Key for the count of bodies in JSON, null without a radius.
        centre_key: Key for the count of centres. None if there is no such count.
        centre_column: Name of that count for a single trial.
    """
    was_unsafe = SAFETY[label]

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        verdict = trial.result.verdict
        radius = trial.experiment.controller.body_radius
        columns: dict[str, Any] = {}
        if centre_column is not None:
            columns[centre_column] = any(was_unsafe(verdict, 0.0))
        columns[body_key] = any(was_unsafe(verdict, radius)) if radius else None
        return columns

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        trial_count = len(trials)
        radius = trials[0].experiment.controller.body_radius
        verdicts = [trial.result.verdict for trial in trials]
        bodies = sum(any(was_unsafe(verdict, radius)) for verdict in verdicts) if radius else 0
        centres = (
            0 if centre_key is None else sum(any(was_unsafe(verdict, 0.0)) for verdict in verdicts)
        )
        unusual = bodies > 0 or centres > 0 or label == ENTERED_OBSTACLE
        centre_label = "" if radius else label  # tables show one of the two
        if radius:
            figures = [share_figure(body_key, label, bodies, trial_count, "bodies", unusual)]
        else:
            body_label = label if centre_key is None else ""
            figures = [_unknown_fraction(body_key, body_label, "no radius", unusual)]
        if centre_key is not None:
            figures.append(
                share_figure(centre_key, centre_label, centres, trial_count, "centres", unusual)
            )
        return figures

    return Statistic(of_batch, of_trial)


OBSTACLE_VIOLATIONS = safety(
    ENTERED_OBSTACLE,
    "body_in_obstacle",
    centre_key="obstacle_violations",
    centre_column="entered_obstacle",
)
LEFT_ARENA = safety(
    LEFT_ARENA, "body_over_edge", centre_key="left_arena", centre_column="outside_arena"
)
TOUCHED = safety(TOUCHED_EACH_OTHER, "bodies_touch")

# ---- Means of the numbers of a trial ----


def _way_point_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return columns with the sum of the robots' distances to each way-point when it was passed.

    The value is None for a way-point that was not passed.
    """
    way_points = len(trial.experiment.setup.legs) - 1
    passed_distances = trial.result.passed[:way_points]
    distances = (*passed_distances, *[None] * (way_points - len(passed_distances)))
    return {f"way_point_{i}": distance for i, distance in enumerate(distances, 1)}


def _time_inside_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return columns with the fraction of the hold's time for which each robot was near its target.

    Near means within `hold.radius`. The value is None if the hold was not completed.
    """
    if trial.experiment.hold is None:
        return {}
    names = trial.experiment.setup.names
    fractions = trial.result.outcome.complete and trial.result.inside
    fractions_or_none = fractions or [None] * len(names)
    return {
        f"inside_{name}": fraction for name, fraction in zip(names, fractions_or_none, strict=True)
    }


def _lost_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return the number of lost robots as the column {"lost": number}.

    There is no column if the spec lets a lost robot stop the trial.
    """
    return {} if trial.experiment.on_lost == "stop" else {"lost": sum(trial.result.lost)}


def mean_of_each(
    of_trial: Callable[[ResultSummary], dict[str, Any]],
    label: str,
    format_mean: Callable[[float], str],
) -> Statistic:
    """Create a statistic that computes the mean of each of several columns over all trials.

    Args:
        of_trial: Returns the columns of a trial.
        label: Label in tables.
        format_mean: Formats a mean.
    """

    def of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
        rows = [of_trial(trial) for trial in trials]
        figures: list[Figure] = []
        for key in rows[0]:
            numbers = [row[key] for row in rows if row[key] is not None]
            mean = float(np.mean(numbers)) if numbers else None
            text = UNKNOWN_TEXT if mean is None else f"{format_mean(mean)} (n {len(numbers)})"
            figures.append(Figure(f"{label} ({key})", text, {key: mean}))
        return figures

    return Statistic(of_batch, of_trial)


WAY_POINTS = mean_of_each(
    _way_point_columns, "mean distance at a way-point, all robots", format_digits
)
LOST = mean_of_each(_lost_columns, "mean number of robots", "{:.3g}".format)
TIME_INSIDE = mean_of_each(
    _time_inside_columns, "mean share of the hold's time within the radius", "{:.3f}".format
)

# ---- How tightly robots were held ----

DISC_FRACTION = 0.95
"""Fraction of the counted time of a hold for which a robot is in its disc."""
SETTLING_S = 5.0
"""Time at the beginning of a hold that is not counted [s]."""


def discs(log: TrialLog) -> Floats:
    """Compute the diameter of the disc in which each robot stayed during a hold, shape (N,).

    The robot is inside the disc around its target for 95 % of the hold, without the first
    SETTLING_S. The diameter is twice the 0.95-quantile of its distances to the target [length
    unit]. True poses are used if they are known. The result is NaN if no frame counts.
    """
    setup = log.start.setup
    hold_times_ns = [
        step.observation.sampled_ns for step in log.steps if step.plan.leg == len(setup.legs)
    ]
    counts_from_ns = hold_times_ns[0] + SETTLING_S * SECOND if hold_times_ns else np.inf
    poses = log.mocap if log.truth is None else log.truth
    distances = setup.distances(poses[log.mocap_ns >= counts_from_ns, :, :2])
    if not len(distances):
        return np.full(distances.shape[1], np.nan)
    return 2 * np.nanquantile(distances, DISC_FRACTION, axis=0)


@lru_cache(maxsize=1024)
def _cached_discs(log: Path, digest: str | None) -> Sequence[float]:
    """Return `discs` of the log with a content digest, from a cache if it was computed before.

    Both the table of trials and the means need it.
    """
    trial = read_trial(log)
    return tuple(discs(trial).tolist())


def _disc_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return the diameter of the disc in which each robot stayed, as {disc_NAME: diameter}.

    Diameters are in the spec's length unit, or None if the trial is incomplete. The result is empty
    if the spec has no hold, or if the hold is not longer than SETTLING_S.
    """
    hold = trial.experiment.hold
    if hold is None or hold.time <= SETTLING_S:
        return {}
    names = trial.experiment.setup.names
    diameters: Sequence[float | None] = [None] * len(names)
    if trial.outcome.complete:
        diameters = _cached_discs(Path(trial.log), trial.digest)
    return {f"disc_{name}": diameter for name, diameter in zip(names, diameters, strict=True)}


def _disc_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    """Return the mean diameter of each robot's disc over the trials, with its 95 % interval.

    Trials without a diameter do not count. The list is empty if the spec has no hold.
    """
    rows = [_disc_columns(trial) for trial in trials]
    unit = trials[0].experiment.units.length
    figures: list[Figure] = []
    for key in rows[0]:
        diameters = [row[key] for row in rows if row[key] is not None]
        (distribution,) = distributions(np.array([diameters], dtype=float))
        label = f"diameter of the disc of 95 % of the hold ({key}), mean [{unit}]"
        figures.append(mean_figure(key, label, distribution, states_n=True))
    return figures


DISC = Statistic(_disc_figures, _disc_columns)

# ---- Time for decisions ----

PERCENTILES = {"p50": 50, "p99": 99, "max": 100}
"""Percentiles of the solve time by their keys."""


def _solve_time_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    """Return percentiles of the solve times while robots drove, and the longest other solve time.

    The first plan, and plans for stationary robots, may take as long as they need.
    """
    solve_ns = [ns for trial in trials for ns in trial.result.driving_ns]
    solve_ms = np.array(solve_ns, dtype=float) / MILLISECOND
    figures: list[Figure] = []
    times_ms: dict[str, float | None] = {}  # by the keys in PERCENTILES
    for key, percentile in PERCENTILES.items():
        time_ms = float(np.percentile(solve_ms, percentile)) if solve_ns else None
        times_ms[key] = time_ms
        text = UNKNOWN_TEXT if time_ms is None else format_digits(time_ms)
        figures.append(Figure(f"solve time while driving, {key} [ms]", text, unusual=False))
    longest = max((ns for trial in trials for ns in trial.result.solve_ns), default=None)
    longest_ms = None if longest is None else longest / MILLISECOND
    text = UNKNOWN_TEXT if longest_ms is None else format_digits(longest_ms)
    figures.append(Figure("solve time of all plans, max [ms]", text, unusual=False))
    return [*figures, Figure("", "", {"solve_ms": times_ms, "solve_all_max_ms": longest_ms})]


SOLVE_MS = Statistic(_solve_time_figures)
DEADLINE_MISSES = total(
    "deadline_misses",
    "deadline misses",
    lambda trial: trial.result.deadline_misses,
    matters=lambda trial: trial.experiment.plant.real_time,  # elsewhere they delayed no command
)

# ---- The lag of the wheels ----


def _lag_columns(trial: ResultSummary) -> dict[str, Any]:
    """Return the lag of the wheels that the controller estimated [s], as {"wheel_lag_s": lag}.

    The lag is None if the controller does not estimate it. The result is empty for robots without
    wheels.
    """
    on_wheels = trial.experiment.setup.on_wheels
    return {"wheel_lag_s": trial.result.wheel_lag_s} if on_wheels else {}


def _lag_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    """Return the mean lag of the wheels that the controller estimated.

    It is marked as unusual if it differs from the lag in the spec.
    """
    lags_s = [trial.result.wheel_lag_s for trial in trials if trial.result.wheel_lag_s is not None]
    if not lags_s:
        return [Figure("", "", {"wheel_lag_s": None})]
    (distribution,) = distributions(np.array([lags_s]))
    interval = ""
    if distribution.ci95.known:
        interval = f", 95 % interval {distribution.ci95.text('{:.3f}'.format)}"
    stated_s = trials[0].experiment.setup.lag_s
    text = (
        f"{distribution.mean:.3f} measured (n = {len(lags_s)}{interval}), {stated_s:.3f} in the "
        "spec"
    )
    is_wrong = abs(distribution.mean - stated_s) > LAG_ERROR_S
    return [Figure("lag of the wheels [s]", text, {"wheel_lag_s": distribution.mean}, is_wrong)]


WHEEL_LAG = Statistic(_lag_figures, _lag_columns)

# ---- Robots that turn by themselves ----


def _turn_figures(trials: Sequence[ResultSummary]) -> list[Figure]:
    """Count the trials with a robot that turned differently than in its other trials, as a figure.

    If the rates of too few trials are known, the figure is not shown, and its JSON value is None.
    """
    label = "less certain"
    key = "less_certain"
    turns = list(compare_turns(trials))
    if not turns:
        return [Figure("", "", {key: None})]
    unusual = [turn for turn in turns if turn.unusual]
    unusual_trials = len({turn.log for turn in unusual})
    return [
        Figure(label, _describe_turns(turns, unusual), {key: unusual_trials}, unusual=bool(unusual))
    ]


def _describe_turns(turns: Sequence[TrialTurn], unusual: Sequence[TrialTurn]) -> str:
    """Describe how many of the compared trials are unusual, and in which robots by how much.

    If none is unusual, the deviation that would be seen in every trial is stated. `turns` must not
    be empty.
    """
    trials = len({turn.log for turn in turns})
    unusual_trials = len({turn.log for turn in unusual})
    text = f"{unusual_trials} of {trials} trials"
    if not unusual:
        largest = max(turn.limit_rad_s for turn in turns)
        return f"{text} (a change of a turning rate by over {largest:.2f} rad/s would be noticed)"
    descriptions = [
        f"{turn.robot} in {Path(turn.log).stem}, {turn.difference_rad_s:+.2f} rad/s"
        for turn in unusual
    ]
    return f"{text}, because wheels changed or poses are false: {join_listed(descriptions, '; ')}"


TURN = Statistic(_turn_figures, turn_columns)
