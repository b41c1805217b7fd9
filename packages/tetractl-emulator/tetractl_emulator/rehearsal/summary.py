"""Summarises many randomised test runs: how often faults occurred, and how soon they were seen."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tetractl.tools.table.table import pluralize
from tetractl_emulator.rehearsal.truth import Truth, Violation, time_s

DayRow = Mapping[str, Any]
"""The summary of a test run, by the names in FIELDS."""
FIELDS = frozenset({"day", "digest", "seconds", "ended", "reason", "met", "violations"})


def row_of(day: int, truth: Truth, violations: Sequence[Violation], observed_s: float) -> DayRow:
    """Summarise one test run as a record.

    Args:
        day: Index of the test run.
        truth: What truly happened.
        violations: The violated invariants.
        observed_s: Processor time of the checks [s].

    Returns:
        The values, by the names in FIELDS.
    """
    result = truth.trial.result if truth.trial is not None else None
    ended = "killed" if truth.day.exit_code < 0 else "refused"
    if truth.first_s("run") < np.inf and truth.day.exit_code >= 0:
        ended = str(result.outcome) if result is not None else "aborted"
    return {
        "day": day,
        "digest": truth.day.digest,
        "seconds": round(truth.day.seconds + observed_s, 3),
        "ended": ended,
        "reason": truth.reason,
        "met": [[fault.kind, _noticed_s(truth, fault.span.began_s)] for fault in truth.faults],
        "violations": [[v.name, round(v.at_s, 3), v.finding] for v in violations],
    }


def _noticed_s(truth: Truth, began_s: float) -> float | None:
    """Return the time from the beginning of a fault to the guard's next abort or hold [s].

    It is None if the guard did neither.
    """
    for event in truth.events("guard"):
        at_s = time_s(event)
        if at_s >= began_s and event["state"] in ("hold", "abort"):
            return round(at_s - began_s, 4)
    return None


def table(rows: Sequence[DayRow]) -> str:
    """Create a Markdown table of the faults and how quickly the guard noticed them.

    For each fault, it contains the number of test runs with this fault, and, for those with no
    other fault, how often and when the guard noticed it.
    """
    days = Counter(name for row in rows for name, _ in row["met"])
    alone = [row["met"][0] for row in rows if len(row["met"]) == 1]
    lines = [
        "| fault | met | alone | noticed | median [s] | p99 [s] | worst [s] |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, count in days.most_common():
        noticed = [noticed_s for met, noticed_s in alone if met == name]
        times_s = [noticed_s for noticed_s in noticed if noticed_s is not None]
        quantiles = [f"{np.quantile(times_s, q):.3f}" if times_s else "" for q in (0.5, 0.99, 1.0)]
        cells = [name, count, len(noticed), len(times_s), *quantiles]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def reasons(rows: Sequence[DayRow]) -> str:
    """List the ten most frequent reasons for which test runs were refused or aborted, one per line.

    Reasons that differ only in their numbers are counted together.
    """
    why = Counter(re.sub(r"\d+(\.\d+)?", "…", row["reason"]) for row in rows if row["reason"])
    return "\n".join(f"{n} {pluralize('day', n)}: {reason}" for reason, n in why.most_common(10))


def summary(rows: Sequence[DayRow]) -> str:
    """Describe how the test runs ended, and their mean processor time [s]. 0 for no test run."""
    count = max(len(rows), 1)
    ended = Counter(row["ended"] for row in rows)
    shares = "".join(f"{n} {how} ({n / count:.0%}); " for how, n in ended.most_common())
    mean_s = sum(row["seconds"] for row in rows) / count
    return f"{shares}{mean_s:.2f} s of processor time a day"
