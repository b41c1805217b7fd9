"""Statistics for other programs: one JSON object, and CSV with one row a trial."""

import csv
import io
import math
from typing import Any

from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.estimate import SEED, Difference, Distribution, Interval
from tetractl.stats.summary import Comparison, Scaled, Summary
from tetractl.stats.trials import counts


def as_json(summary: Summary, comparison: Comparison | None = None) -> dict[str, Any]:
    """Return the object that `stats --format json` and `run --json` print; unknown is None.

    Numbers are not rounded. Lengths are in `unit`, times in the unit of their key.
    """
    names = [robot.name for robot in summary.experiment.robots]
    found: dict[str, Any] = {
        "experiment": summary.experiment.name,
        "n_trials": len(summary.trials),
        "n_counted": summary.counted,
        "unit": summary.unit,
        "total_error": _distribution(summary.total),
        "robots": [
            {"name": name, **_distribution(errors)}
            for name, errors in zip(names, summary.robots, strict=True)
        ],
        "obstacle_violations": summary.obstacle_violations,
        "obstacle_violations_ci95": _ends(summary.violations_ci95),
        "arrived": summary.arrived,
        "arrived_ci95": _ends(summary.arrived_ci95),
        "aborted": summary.aborted,
        "interrupted": summary.interrupted,
        "recovered": sum(trial.recovered for trial in summary.trials),
        "solve_ms": {
            "p50": _number(summary.solve_ms.p50),
            "p99": _number(summary.solve_ms.p99),
            "max": _number(summary.solve_ms.max),
        },
        "deadline_misses": summary.deadline_misses,
        "reference": _reference(summary),
        "scaled": _scaled(summary.scaled) if summary.scaled else None,
        "bootstrap_seed": SEED,
        "damaged": [{"path": log.path, "problem": log.problem} for log in summary.damaged],
        "trials": [_trial(trial) for trial in summary.trials],
    }
    if comparison:
        found["against"] = as_json(comparison.theirs)
        found["comparison"] = _comparison(comparison)
    return found


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _ends(interval: Interval) -> list[float] | None:
    return [interval.low, interval.high] if interval.known else None


def _interval(interval: Interval) -> dict[str, Any]:
    return {
        "ci95": _ends(interval),
        "ci95_method": interval.method,
        "ci95_reason": interval.reason,
    }


def _distribution(values: Distribution) -> dict[str, Any]:
    return {
        "n": values.n,
        "mean": _number(values.mean),
        "std": _number(values.std),
        "median": _number(values.median),
        "min": _number(values.min),
        "max": _number(values.max),
        **_interval(values.ci95),
    }


def _difference(difference: Difference) -> dict[str, Any]:
    return {
        "difference": _number(difference.value),
        **_interval(difference.ci95),
        "p_value": _number(difference.p_value),
        "degrees_of_freedom": _number(difference.degrees),
    }


def _reference(summary: Summary) -> dict[str, Any] | None:
    if (published := summary.published) is None:
        return None
    reference = published.reference
    return {
        "source": reference.source,
        "n": reference.n,
        "mean": reference.mean,
        "std": reference.std,
        **_difference(published.comparison),
    }


def _scaled(scaled: Scaled) -> dict[str, Any]:
    return {
        "name": scaled.scale.name,
        "unit": scaled.scale.unit,
        "mean": _number(scaled.error),
        "ci95": _ends(scaled.ci95),
        "body_lengths": _number(scaled.body_lengths(scaled.error)),
        "published_mean": _number(scaled.published),
        "published_body_lengths": _number(scaled.body_lengths(scaled.published)),
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "n": [comparison.ours.counted, comparison.theirs.counted],
        **_difference(comparison.welch),
        "bootstrap": _interval(comparison.bootstrap),
        "cliffs_delta": {
            "value": _number(comparison.effect.value),
            **_interval(comparison.effect.ci95),
        },
        "verdict": comparison.verdict,
        "verdict_reason": comparison.reason,
        "differs": list(comparison.differs),
    }


def _trial(trial: ResultSummary) -> dict[str, Any]:
    result = trial.result
    return {
        "path": trial.path,
        "seed": trial.seed,
        "trial": trial.trial,
        "total_error": _number(result.total_error),
        "robot_errors": [_number(error) for error in result.robot_errors],
        "steps": result.steps,
        "duration_s": _number(result.duration_s),
        "outcome": result.outcome.value,
        "reason": result.reason,
        "entered_obstacle": result.entered_obstacle,
        "deadline_misses": result.deadline_misses,
        "recovered": trial.recovered,
        "counted": counts(trial),
    }


def as_csv(summary: Summary, comparison: Comparison | None = None) -> str:
    """Return one row a trial, lengths with their unit in the column's name.

    With a comparison the other batch's rows follow, and the column `batch` tells them apart.
    """
    rows = [row(trial, summary.unit) for trial in summary.trials]
    if comparison:
        rows = [{"batch": "ours", **row} for row in rows]
        theirs = comparison.theirs
        rows += [{"batch": "against", **row(trial, theirs.unit)} for trial in theirs.trials]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def row(trial: ResultSummary, unit: str) -> dict[str, Any]:
    """Return a trial as one row of a table, lengths with their unit in the key."""
    fields = _trial(trial)
    total, errors = fields.pop("total_error"), fields.pop("robot_errors")
    names = [robot.name for robot in trial.experiment.robots]
    each = dict(zip(names, errors, strict=True))
    return {
        **fields,
        f"total_error_{unit}": total,
        **{f"error_{name}_{unit}": error for name, error in each.items()},
    }
