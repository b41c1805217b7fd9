"""Several arms as one JSON object, and as CSV with one row for every two of them."""

import csv
import io
from typing import Any

from tetractl.core.text import cell
from tetractl.stats.arms import Arms, Contrast, NotCompared
from tetractl.stats.estimate import finite
from tetractl.stats.export import as_difference, as_json


def arms_json(arms: Arms) -> dict[str, Any]:
    """Return `arms`, each as the JSON of one batch with its `name`, and `comparisons`.

    Numbers are not rounded; differences are of `one` minus `other`, in `unit`.
    """
    return {
        "unit": arms.unit,
        "arms": [{"name": arm.name, **as_json(arm.summary)} for arm in arms.arms],
        "comparisons": [_comparison(one) for one in arms.contrasts],
    }


def _comparison(found: Contrast | NotCompared) -> dict[str, Any]:
    names = {"one": found.one.name, "other": found.other.name}
    if isinstance(found, NotCompared):
        return {**names, "comparable": False, "reason": found.reason}
    return {
        **names,
        "comparable": True,
        "n": [found.one.summary.counted, found.other.summary.counted],
        "pairs": found.pairs,
        "unpaired_reason": found.why_unpaired or None,
        **as_difference(found.difference),
        "both": found.both.as_dict(),
        "test": found.test,
        "test_p": finite(found.p_value),
        "test_p_holm": finite(found.p_holm),
        "standardised": _effect(found.standardised),
        "cliffs_delta": _effect(found.delta),
        "deviation_ratio": _effect(found.deviations)
        | {"p": finite(found.deviations.p_value), "p_holm": finite(found.deviation_p_holm)},
        "detects_sd": finite(found.detects),
        "verdict": found.verdict,
        "verdict_reason": found.reason,
        "differs": list(found.differs),
    }


def _effect(effect: Any) -> dict[str, Any]:
    return {"value": finite(effect.value), **effect.ci95.as_dict()}


def arms_csv(arms: Arms) -> str:
    """Return one row for every two arms: the numbers of the JSON, both arms' n, mean and deviation.

    Lengths have their unit in the name. The rows of the trials are those of each batch by itself.
    """
    rows = [_row(one, arms.unit) for one in arms.contrasts]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: cell(v) if isinstance(v, str) else v for k, v in row.items()})
    return text.getvalue()


def _row(found: Contrast | NotCompared, unit: str) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for side, arm in (("one", found.one), ("other", found.other)):
        total = arm.summary.total
        row |= {
            side: arm.name,
            f"{side}_steered": str(arm.summary.origin),
            f"{side}_n": total.n,
            f"{side}_mean_{unit}": finite(total.mean),
            f"{side}_std_{unit}": finite(total.std),
        }
    if isinstance(found, NotCompared):
        return row | {"comparable": False}
    difference, ratio = found.difference, found.deviations
    return row | {
        "comparable": True,
        "pairs": found.pairs,
        f"difference_{unit}": finite(difference.value),
        **_ends(f"difference_{{}}_{unit}", difference.ci95),
        "t_p": finite(difference.p_value),
        "test": found.test,
        "test_p": finite(found.p_value),
        "test_p_holm": finite(found.p_holm),
        "standardised": finite(found.standardised.value),
        **_ends("standardised_{}", found.standardised.ci95),
        "cliffs_delta": finite(found.delta.value),
        **_ends("cliffs_delta_{}", found.delta.ci95),
        "deviation_ratio": finite(ratio.value),
        **_ends("deviation_ratio_{}", ratio.ci95),
        "deviation_p": finite(ratio.p_value),
        "deviation_p_holm": finite(found.deviation_p_holm),
        "detects_sd": finite(found.detects),
        "verdict": found.verdict,
    }


def _ends(name: str, interval: Any) -> dict[str, float | None]:
    return {name.format("low"): finite(interval.low), name.format("high"): finite(interval.high)}
