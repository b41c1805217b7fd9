"""What many days of a rehearsal come to: how often each fault was met, noticed, in what time."""

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tetractl.tools.table.table import plural
from tetractl_emulator.rehearsal.schedule import KINDS, FaultRow
from tetractl_emulator.rehearsal.truth import Truth, time_s
from tetractl_emulator.rehearsal.violation import Violation

DayRow = Mapping[str, Any]
"""What is kept of a day, by the names in FIELDS."""
FIELDS = frozenset({"day", "digest", "seconds", "ended", "reason", "met", "violations"})
NIGHT_S = 8 * 3600.0


@dataclass(slots=True)
class Met:
    """On how many `days` a fault was met, on how many `alone`, and of these the times after which
    the guard noticed it [s].
    """

    days: int = 0
    alone: int = 0
    times_s: list[float] = field(default_factory=list)


def row_of(day: int, truth: Truth, violations: Sequence[Violation], observed_s: float) -> DayRow:
    """Return what is kept of a day: what was met, how it ended, and the broken invariants; and the
    processor time, of which the observer took a part [s].
    """
    result = truth.trial.result if truth.trial is not None else None
    ended = "killed" if truth.day.exit < 0 else "refused"
    if truth.first_s("run") < np.inf and truth.day.exit >= 0:
        ended = str(result.outcome) if result is not None else "aborted"
    return {
        "day": day,
        "digest": truth.day.digest,
        "seconds": round(truth.day.seconds + observed_s, 3),
        "ended": ended,
        "reason": truth.reason,
        "met": [[fault.kind, _noticed_s(truth, fault.span.began_s)] for fault in truth.faults],
        "violations": [[v.name, round(v.at_s, 3), v.finding, v.predicted] for v in violations],
    }


def _noticed_s(truth: Truth, began_s: float) -> float | None:
    """Return the time from a fault to the guard's abort or hold [s]; None if there was neither."""
    for event in truth.events("guard"):
        at_s = time_s(event)
        if at_s >= began_s and event["state"] in ("hold", "abort"):
            return round(at_s - began_s, 4)
    return None


def broken(row: DayRow) -> list[list[Any]]:
    """Return the violations of a day that no derivation predicts."""
    return [violation for violation in row["violations"] if not violation[3]]


def met_by_kind(rows: Sequence[DayRow]) -> dict[str, Met]:
    """Return how each fault was met on days, by its name."""
    met = defaultdict[str, Met](Met)
    for row in rows:
        for kind, noticed_s in row["met"]:
            met[kind].days += 1
            if len(row["met"]) == 1:
                met[kind].alone += 1
                met[kind].times_s += [] if noticed_s is None else [noticed_s]
    return dict(met)


def table(rows: Sequence[DayRow], kinds: Sequence[FaultRow] = KINDS) -> str:
    """Return the faults met, as a table in Markdown."""
    met = met_by_kind(rows)
    lines = [
        "| fault | met | alone | noticed | median [s] | p99 [s] | worst [s] |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for kind in kinds:
        fault = met.get(kind.name, Met())
        times_s = fault.times_s
        quantiles = [f"{np.quantile(times_s, q):.3f}" if times_s else "" for q in (0.5, 0.99, 1.0)]
        cells = [kind.name, fault.days, fault.alone, len(times_s), *quantiles]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def reasons(rows: Sequence[DayRow]) -> str:
    """Return for what reasons days were refused or aborted, the most frequent ones first."""
    why = Counter(re.sub(r"\d+(\.\d+)?", "…", row["reason"]) for row in rows if row["reason"])
    return "\n".join(f"{n} {plural('day', n)}: {reason}" for reason, n in why.most_common(10))


def summary(rows: Sequence[DayRow]) -> str:
    """Return how the days ended, of which classes violations are, and what a day took."""
    count = max(len(rows), 1)
    ended = Counter(row["ended"] for row in rows)
    shares = ", ".join(f"{n} {how} ({n / count:.0%})" for how, n in ended.most_common())
    predicted = Counter(v[3] for row in rows for v in row["violations"][:1] if v[3])
    classes = [f"{n} days of the class '{name}', as derived" for name, n in predicted.items()]
    small = [row["shrunk"] for row in rows if "shrunk" in row]
    if small:
        classes.append(f"{len(small)} shrunk, in the median to {np.median(small):g} faults")
    mean_s = sum(row["seconds"] for row in rows) / count
    a_night = f": {NIGHT_S / mean_s:.0f} days in 8 hours on one core" if mean_s else ""
    parts = [shares, *classes, f"{mean_s:.2f} s of processor time a day{a_night}"]
    return "; ".join(filter(None, parts))
