"""Summarises many randomised test runs: how often faults occurred, and how soon they were seen."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tetractl.tools.table.table import pluralize
from tetractl_emulator.rehearsal.truth import Truth, Violation, time_s

DaySummary = Mapping[str, Any]
"""The summary of a test run: a mapping with the keys SUMMARY_FIELDS."""
SUMMARY_FIELDS = frozenset({"day", "digest", "seconds", "ended", "reason", "met", "violations"})


def summarize_day(
    day: int, truth: Truth, violations: Sequence[Violation], checks_s: float
) -> DaySummary:
    """Summarise one test run as a record.

    Args:
        day: Index of the test run.
        truth: What truly happened in the test run.
        violations: The violations of invariants in the test run.
        checks_s: Processor time of the checks [s].

    Returns:
        A mapping with the keys SUMMARY_FIELDS:

        - "day": the index of the test run
        - "digest": the digest of the test run's events
        - "seconds": processor time of the test run and its checks [s]
        - "ended": "killed", "refused", or the outcome of the trial
        - "reason": why the trial was aborted or the run was refused; empty if neither happened
        - "met": for each visible fault, its variant and the time until the guard noticed it [s]
        - "violations": for each violation, the invariant, the time [s] and the finding
    """
    result = truth.trial.result if truth.trial is not None else None
    ending = "killed" if truth.day.exit_code < 0 else "refused"
    if truth.first_event_s("run") < np.inf and truth.day.exit_code >= 0:
        ending = str(result.outcome) if result is not None else "aborted"
    return {
        "day": day,
        "digest": truth.day.digest,
        "seconds": round(truth.day.seconds + checks_s, 3),
        "ended": ending,
        "reason": truth.reason,
        "met": [
            [fault.variant, _notice_time_s(truth, fault.span.began_s)] for fault in truth.faults
        ],
        "violations": [[v.name, round(v.at_s, 3), v.finding] for v in violations],
    }


def _notice_time_s(truth: Truth, began_s: float) -> float | None:
    """Compute the time from the beginning of a fault to the guard's next abort or hold [s].

    The result is None if the guard did neither after the beginning.
    """
    for event in truth.events("guard"):
        at_s = time_s(event)
        if at_s >= began_s and event["state"] in ("hold", "abort"):
            return round(at_s - began_s, 4)
    return None


def fault_table(rows: Sequence[DaySummary]) -> str:
    """Create a Markdown table of the faults, with the times until the guard noticed them.

    Each row of the table contains the number of test runs with a fault, and the number of test runs
    with only this fault. For the latter test runs, it also contains how often and when the guard
    noticed the fault.
    """
    n_days_by_fault = Counter(name for row in rows for name, _ in row["met"])
    single_faults = [row["met"][0] for row in rows if len(row["met"]) == 1]
    lines = [
        "| fault | met | alone | noticed | median [s] | p99 [s] | worst [s] |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, count in n_days_by_fault.most_common():
        notice_times = [noticed_s for met, noticed_s in single_faults if met == name]
        noticed_s_values = [noticed_s for noticed_s in notice_times if noticed_s is not None]
        quantiles = [
            f"{np.quantile(noticed_s_values, quantile):.3f}" if noticed_s_values else ""
            for quantile in (0.5, 0.99, 1.0)
        ]
        cells = [name, count, len(notice_times), len(noticed_s_values), *quantiles]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def frequent_reasons(rows: Sequence[DaySummary]) -> str:
    """List the ten most frequent reasons for refused or aborted test runs, one per line.

    Reasons that differ only in their numbers are counted together.
    """
    count_by_reason = Counter(
        re.sub(r"\d+(\.\d+)?", "…", row["reason"]) for row in rows if row["reason"]
    )
    return "\n".join(
        f"{n} {pluralize('day', n)}: {reason}" for reason, n in count_by_reason.most_common(10)
    )


def describe_endings(rows: Sequence[DaySummary]) -> str:
    """Describe in one line how the test runs ended, and their mean processor time [s].

    The mean is 0 if there are no test runs.
    """
    n_days = max(len(rows), 1)
    count_by_ending = Counter(row["ended"] for row in rows)
    shares = "".join(
        f"{n} {ending} ({n / n_days:.0%}); " for ending, n in count_by_ending.most_common()
    )
    mean_s = sum(row["seconds"] for row in rows) / n_days
    return f"{shares}{mean_s:.2f} s of processor time a day"
