"""Statistics as one JSON object, and as CSV with one row for each trial."""

import csv
import io
import math
from collections.abc import Sequence
from typing import Any

from tetractl.core.text import cell
from tetractl.log.read.trial_log import ResultSummary
from tetractl.stats.comparison import Comparison
from tetractl.stats.difference import MeanDifference
from tetractl.stats.estimate import Interval, finite
from tetractl.stats.kinds import statistics
from tetractl.stats.notable import to_look_at
from tetractl.stats.summary import Scaled, Summary
from tetractl.stats.trials import counts, split_attempts

_NOT_COMPARED = MeanDifference(math.nan, Interval.none("not compared"), math.nan, math.nan)


def as_json(summary: Summary, comparison: Comparison | None = None) -> dict[str, Any]:
    """Return the object that `stats --format json` and `run --json` print; None for unknown values.

    Numbers are not rounded. Lengths are in `unit`, times in the unit of their key. `origin` says
    what was steered, in the words of `Origin`.
    """
    names = [robot.name for robot in summary.experiment.robots]
    found: dict[str, Any] = {
        "experiment": summary.experiment.name,
        "origin": summary.origin.value,
        "n_trials": len(summary.trials),
        "n_counted": summary.counted,
        "unit": summary.unit,
        "total_error": summary.total.as_dict(),
        "robots": [
            {"name": name, **errors.as_dict()}
            for name, errors in zip(names, summary.robots, strict=True)
        ],
        **summary.items,
        "reference": _reference(summary),
        "scaled": _scaled(summary.scaled) if summary.scaled else None,
        "damaged": [{"path": log.path, "problem": log.problem} for log in summary.damaged],
        "trials": [_trial(trial) for trial in summary.trials],
        "n_attempts": summary.n_attempts,
        "attempts": [
            *(_trial(trial) | {"counted": False} for trial in summary.attempts),
            *({"path": log.path, "problem": log.problem} for log in summary.lost_attempts),
        ],
        "to_look_at": [
            {"path": trial.path, "outcome": trial.outcome, "notes": list(trial.notes)}
            for trial in to_look_at(summary)
        ],
    }
    if comparison:
        found["against"] = as_json(comparison.theirs)
        found["comparison"] = _comparison(comparison)
    return found


def as_difference(difference: MeanDifference) -> dict[str, Any]:
    """Return the items of JSON that describe a difference of means."""
    return {
        "difference": finite(difference.value),
        **difference.ci95.as_dict(),
        "p_value": finite(difference.p_value),
        "degrees_of_freedom": finite(difference.degrees),
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
        "comparable": published.comparison is not None,
        **as_difference(published.comparison or _NOT_COMPARED),
    }


def _scaled(scaled: Scaled) -> dict[str, Any]:
    return {
        "name": scaled.scale.name,
        "unit": scaled.scale.unit,
        "mean": finite(scaled.error),
        "ci95": scaled.ci95.ends,
        "body_lengths": finite(scaled.body_lengths(scaled.error)),
        "published_mean": finite(scaled.published),
        "published_body_lengths": finite(scaled.body_lengths(scaled.published)),
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "n": [comparison.ours.counted, comparison.theirs.counted],
        **as_difference(comparison.welch),
        "both": comparison.both.as_dict(),
        "paired": {
            "n": comparison.paired.n,
            "reason": comparison.paired.reason or None,
            **as_difference(comparison.paired.difference or _NOT_COMPARED),
        },
        "cliffs_delta": {
            "value": finite(comparison.effect.value),
            **comparison.effect.ci95.as_dict(),
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
        "total_error": finite(result.total_error),
        "robot_errors": [finite(error) for error in result.robot_errors],
        "steps": result.steps,
        "duration_s": finite(result.duration_s),
        "origin": trial.origin.value,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "warnings": trial.warnings,
        **_statistics(trial),
        "counted": counts(trial),
    }


def _statistics(trial: ResultSummary) -> dict[str, Any]:
    """Return the columns that the statistics give a trial."""
    return {key: item for one in statistics() for key, item in one.of_trial(trial).items()}


def as_csv(summary: Summary, comparison: Comparison | None = None) -> str:
    """Return one row for each trial, as `rows` gives them.

    With a comparison the rows of the other batch follow; the column `batch` names the batch.
    """
    table = rows([*summary.trials, *summary.attempts])
    if comparison:
        theirs = comparison.theirs
        table = [{"batch": "ours", **row} for row in table]
        others = rows([*theirs.trials, *theirs.attempts])
        table += [{"batch": "against", **row} for row in others]
    columns = list(dict.fromkeys(column for row in table for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in table:
        writer.writerow({k: cell(v) if isinstance(v, str) else v for k, v in row.items()})
    return text.getvalue()


def rows(trials: Sequence[ResultSummary]) -> list[dict[str, Any]]:
    """Return one row for each trial, then those of earlier attempts with `attempt` True.

    Lengths have their unit in the key.
    """
    counted, attempts = split_attempts(trials)
    return [
        *(_row(trial) | {"attempt": False} for trial in counted),
        *(_row(trial) | {"attempt": True, "counted": False} for trial in attempts),
    ]


def _row(trial: ResultSummary) -> dict[str, Any]:
    fields, unit = _trial(trial), trial.experiment.units.length
    total, errors = fields.pop("total_error"), fields.pop("robot_errors")
    names = [robot.name for robot in trial.experiment.robots]
    each = dict(zip(names, errors, strict=True))
    return {
        **fields,
        f"total_error_{unit}": total,
        **{f"error_{name}_{unit}": error for name, error in each.items()},
    }
