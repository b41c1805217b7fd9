"""The output of `tetractl stats` for other programs, as JSON and as a CSV table.

Lengths are in the unit that is given, and times in the unit with which their key ends. Numbers are
not rounded. Unknown numbers are NaN or None, which JSON writes as null.
"""

from typing import Any

from tetractl.log.read.trial_log import Origin
from tetractl.statistics.describe import BatchComparison, BatchStatistics, Contrast
from tetractl.statistics.flagged import flagged
from tetractl.statistics.statistic import trial_items
from tetractl.statistics.trial_tables import trials_table
from tetractl.tools.table.table import Table
from tetractl.tools.table.table_files import flatten


def comparison_items(comparison: BatchComparison) -> dict[str, Any]:
    """Return the object that `stats --format json` prints.

    For one batch, it has the items of the batch. For several, it has `groups` and `comparisons`.
    """
    if len(comparison.groups) == 1:
        return batch_items(comparison.groups[0])
    return {
        "unit": comparison.unit,
        "groups": [{"name": group.name, **batch_items(group)} for group in comparison.groups],
        "comparisons": [contrast_items(contrast) for contrast in comparison.contrasts],
    }


def data_table(comparison: BatchComparison) -> Table:
    """Return the table of `stats --format csv`.

    For one batch, it has a row for each trial, earlier attempts last. For several batches, it has a
    row for each comparison, with the same numbers as the JSON.
    """
    if len(comparison.groups) == 1:
        return trials_table(comparison.groups[0].batch)
    rows = [flatten(contrast_items(contrast)) for contrast in comparison.contrasts]
    return Table.of_records("comparisons", rows)


def batch_items(group: BatchStatistics) -> dict[str, Any]:
    """Return the JSON items of a batch: errors, plant, statistics and trials.

    They also list earlier attempts, damaged logs and flagged trials. Unknown numbers are NaN or
    None.
    """
    batch = group.batch
    experiment = group.experiment
    robots = zip(experiment.setup.names, group.robots, strict=True)
    statistics: dict[str, Any] = {}
    for figure in group.figures:
        statistics |= figure.items
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
        **statistics,
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
    """Return the published result and the difference from it.

    The result is None if nothing was published.
    """
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


def contrast_items(contrast: Contrast) -> dict[str, Any]:
    """Return the JSON items of the comparison of two batches, `one` minus `other`."""
    return {
        "one": contrast.first.name,
        "other": contrast.second.name,
        "unit": contrast.first.unit,
        **_items_of_group("one", contrast.first),
        **_items_of_group("other", contrast.second),
        "comparable": contrast.same_origin,
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


def _items_of_group(prefix: str, group: BatchStatistics) -> dict[str, Any]:
    """Return the JSON items of one side of a comparison, keyed by names such as `one_mean`."""
    return {
        f"{prefix}_origin": group.origin.value,
        f"{prefix}_n": group.counted,
        f"{prefix}_mean": group.total.mean,
        f"{prefix}_std": group.total.std,
        f"{prefix}_tail": group.total.tail.as_dict(),
    }
