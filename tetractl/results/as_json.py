"""The JSON of batches, of their comparisons and of single trials, key by key.

Lengths are in the unit that is stated, times in the unit with which their key ends. Numbers are not
rounded; unknown ones are NaN or None, which JSON writes as null.
"""

from typing import Any

from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.results.contrast import BatchComparison, Contrast
from tetractl.results.describe import BatchStatistics, ScaledError
from tetractl.results.flagged import flagged
from tetractl.results.open_batch import counts
from tetractl.results.statistic import statistics
from tetractl.results.statistic_text import json_items


def comparison_items(comparison: BatchComparison) -> dict[str, Any]:
    """Return the object that `stats --format json` prints: of one batch its items, of several
    `groups` and `comparisons`.
    """
    if len(comparison.groups) == 1:
        return batch_items(comparison.groups[0])
    return {
        "unit": comparison.unit,
        "groups": [{"name": group.name, **batch_items(group)} for group in comparison.groups],
        "comparisons": [contrast_items(contrast) for contrast in comparison.contrasts],
    }


def batch_items(group: BatchStatistics) -> dict[str, Any]:
    """Return the items of a batch: errors, plant, statistics and trials."""
    batch = group.batch
    experiment = group.experiment
    robots = zip(experiment.setup.names, group.robots, strict=True)
    return {
        "experiment": experiment.name,
        "unit": group.unit,
        "total_error": group.total.as_dict(),
        "robots": [{"name": name, **errors.as_dict()} for name, errors in robots],
        "origin": group.origin.value,
        "kind": "simulated" if group.origin.simulated else group.origin.name.lower(),
        "disturbed": group.origin is not Origin.UNDISTURBED,
        "body_radius": experiment.controller.body_radius or None,
        "n_trials": len(batch.trials),
        "n_counted": group.counted,
        "reference": _reference(group),
        "scaled": group.scaled and _scaled(group.scaled),
        **json_items(group.values),
        "n_attempts": group.attempts,
        "damaged": batch.lost,
        "trials": [trial_items(trial) for trial in batch.trials],
        "attempts": [
            *(trial_items(trial) | {"counted": False} for trial in batch.attempts),
            *batch.lost_attempts,
        ],
        "flagged": flagged(batch),
    }


def _reference(group: BatchStatistics) -> dict[str, Any] | None:
    """Return the published result and the difference from it; None if nothing was published."""
    published = group.experiment.reference
    if published is None or group.from_published is None:
        return None
    return {
        "source": published.source,
        "n": published.n,
        "mean": published.mean,
        "std": published.std,
        "comparable": group.origin.comparable,
        **group.from_published.as_dict(),
    }


def _scaled(scaled: ScaledError) -> dict[str, Any]:
    return {
        "name": scaled.scale.name,
        "unit": scaled.scale.unit,
        "mean": scaled.mean,
        "ci95": scaled.ci95.ends,
        "body_lengths": scaled.body_lengths,
        "published_mean": scaled.published_mean,
        "published_body_lengths": scaled.published_body_lengths,
    }


def trial_items(trial: ResultSummary) -> dict[str, Any]:
    """Return the items of one trial, those of the registered statistics among them."""
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
        "processor": trial.processor,
    }
    for statistic in statistics():
        items |= statistic.of_trial(trial)
    items["counted"] = counts(trial)
    return items


def contrast_items(contrast: Contrast) -> dict[str, Any]:
    """Return the items of the comparison of two batches, `one` minus `other`."""
    return {
        "one": contrast.first.name,
        "other": contrast.second.name,
        "unit": contrast.first.unit,
        **_side("one", contrast.first),
        **_side("other", contrast.second),
        "comparable": contrast.alike,
        "pairs": contrast.pairs,
        "unpaired_reason": contrast.why_unpaired or None,
        **contrast.difference.as_dict(),
        "both": contrast.from_both_means.as_dict(),
        "p_holm": contrast.p_holm,
        "rank_p": contrast.rank_p,
        "rank_p_holm": contrast.rank_p_holm,
        "tests": contrast.tests,
        "detects_sd": contrast.detects,
        "verdict": contrast.verdict,
        "verdict_reason": contrast.reason,
        "differs": list(contrast.differs),
    }


def _side(side: str, group: BatchStatistics) -> dict[str, Any]:
    """Return the items of one side of a comparison, such as `one_mean`."""
    return {
        f"{side}_origin": group.origin.value,
        f"{side}_n": group.counted,
        f"{side}_mean": group.total.mean,
        f"{side}_std": group.total.std,
        f"{side}_tail": group.total.tail.as_dict(),
    }
