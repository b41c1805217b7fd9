"""Results as the items of JSON objects, and as the rows of data tables."""

import math
from collections.abc import Sequence
from typing import Any

from tetractl.core.table.table import Table
from tetractl.core.table.table_files import flat
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.contrast import Contrast, GroupComparison
from tetractl.results.describe import Group, Scaled, flagged
from tetractl.results.estimate import Interval
from tetractl.results.mean_difference import Effect, MeanDifference, Ratio
from tetractl.results.open_batch import Batch, counts
from tetractl.results.statistic import statistics

_NOT_COMPARED = MeanDifference(math.nan, Interval.none("not compared"), math.nan, math.nan)


def as_items(found: GroupComparison) -> dict[str, Any]:
    """Return the object that `stats --format json` prints.

    For one group it has the items of `group_items`, for several `groups` and `comparisons`. Numbers
    are not rounded; unknown values are NaN.
    """
    if len(found.groups) == 1:
        return group_items(found.groups[0])
    return {
        "unit": found.unit,
        "groups": [{"name": group.name, **group_items(group)} for group in found.groups],
        "comparisons": [contrast_items(one) for one in found.contrasts],
    }


def group_items(group: Group) -> dict[str, Any]:
    """Return the items of one group; lengths are in `unit`, times in the unit with which their key
    ends.
    """
    names = [robot.name for robot in group.experiment.robots]
    batch, origin = group.batch, group.origin
    return {
        "experiment": group.experiment.name,
        "origin": origin.value,
        "kind": "simulated" if origin.simulated else origin.name.lower(),
        "disturbed": origin is not Origin.UNDISTURBED,
        "n_trials": len(batch.trials),
        "n_counted": group.counted,
        "unit": group.unit,
        "total_error": group.total.as_dict(),
        "robots": [
            {"name": name, **errors.as_dict()}
            for name, errors in zip(names, group.robots, strict=True)
        ],
        "body_radius": group.experiment.controller.body_radius or None,
        **group.items,
        "reference": _reference(group),
        "scaled": _scaled(group.scaled) if group.scaled else None,
        "damaged": [{"path": log.path, "problem": log.problem} for log in batch.lost],
        "trials": [_trial(trial) for trial in batch.trials],
        "n_attempts": group.n_attempts,
        "attempts": [
            *(_trial(trial) | {"counted": False} for trial in batch.attempts),
            *({"path": log.path, "problem": log.problem} for log in batch.lost_attempts),
        ],
        "flagged": [
            {"path": trial.path, "outcome": trial.outcome, "notes": list(trial.notes)}
            for trial in flagged(batch)
        ],
    }


def contrast_items(found: Contrast) -> dict[str, Any]:
    """Return the items of one comparison; differences are `one` minus `other`."""
    sides = {
        f"{side}_{key}": value
        for side, group in (("one", found.one), ("other", found.other))
        for key, value in (
            ("origin", group.origin.value),
            ("n", group.counted),
            ("mean", group.total.mean),
            ("std", group.total.std),
            ("tail", group.total.tail.as_dict()),
        )
    }
    return {
        "one": found.one.name,
        "other": found.other.name,
        "unit": found.one.unit,
        **sides,
        "comparable": found.alike,
        "pairs": found.pairs,
        "unpaired_reason": found.why_unpaired or None,
        **_difference(found.difference),
        "both": found.both.as_dict(),
        "p_holm": found.p_holm,
        "rank_p": found.rank_p,
        "rank_p_holm": found.rank_p_holm,
        "tests": found.tests,
        "standardised": _effect(found.standardised),
        "cliffs_delta": _effect(found.delta),
        "deviation_ratio": _effect(found.deviations)
        | {"p": found.deviations.p_value, "p_holm": found.deviation_p_holm},
        "detects_sd": found.detects,
        "verdict": found.verdict,
        "verdict_reason": found.reason,
        "differs": list(found.differs),
    }


def _difference(difference: MeanDifference) -> dict[str, Any]:
    return {
        "difference": difference.value,
        **difference.ci95.as_dict(),
        "p_value": difference.p_value,
        "degrees_of_freedom": difference.degrees,
    }


def _effect(effect: Effect | Ratio) -> dict[str, Any]:
    return {"value": effect.value, **effect.ci95.as_dict()}


def _reference(group: Group) -> dict[str, Any] | None:
    if (published := group.published) is None:
        return None
    reference = published.reference
    return {
        "source": reference.source,
        "n": reference.n,
        "mean": reference.mean,
        "std": reference.std,
        "comparable": published.difference is not None,
        **_difference(published.difference or _NOT_COMPARED),
    }


def _scaled(scaled: Scaled) -> dict[str, Any]:
    return {
        "name": scaled.scale.name,
        "unit": scaled.scale.unit,
        "mean": scaled.error,
        "ci95": scaled.ci95.ends,
        "body_lengths": scaled.body_lengths(scaled.error),
        "published_mean": scaled.published,
        "published_body_lengths": scaled.body_lengths(scaled.published),
    }


def _trial(trial: ResultSummary) -> dict[str, Any]:
    result = trial.result
    return {
        "path": trial.path,
        "seed": trial.seed,
        "trial": trial.trial,
        "total_error": result.total_error,
        "robot_errors": list(result.robot_errors),
        "steps": result.steps,
        "duration_s": result.duration_s,
        "origin": trial.origin.value,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "warnings": trial.warnings,
        "processor": trial.processor,
        **{key: item for one in statistics() for key, item in one.of_trial(trial).items()},
        "counted": counts(trial),
    }


def data_table(found: GroupComparison) -> Table:
    """Return the table of `stats --format csv`: for one group, a row per trial, earlier attempts
    last; for several groups, a row per comparison, with the same numbers as the JSON.
    """
    if len(found.groups) == 1:
        return trials_table(found.groups[0].batch)
    return Table.of_records("comparisons", [flat(contrast_items(one)) for one in found.contrasts])


def trials_table(batch: Batch) -> Table:
    """Return one row per trial, then one row per earlier attempt, with `attempt` True.

    The names of lengths end in their unit.
    """
    counted = [_row(trial) | {"attempt": False} for trial in batch.trials]
    attempts = [_row(one) | {"attempt": True, "counted": False} for one in batch.attempts]
    return Table.of_records("trials", [*counted, *attempts])


def _row(trial: ResultSummary) -> dict[str, Any]:
    """Return the row of one trial: its values by the names of the columns."""
    fields, unit = _trial(trial), trial.experiment.units.length
    total, errors = fields.pop("total_error"), fields.pop("robot_errors")
    names: Sequence[str] = [robot.name for robot in trial.experiment.robots]
    return {
        **fields,
        f"total_error_{unit}": total,
        **{f"error_{name}_{unit}": error for name, error in zip(names, errors, strict=True)},
    }
