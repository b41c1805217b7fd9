"""What many days of a rehearsal come to: how often each fault was met, noticed, in what time."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tetractl_emulator.rehearsal.invariants import Violation
from tetractl_emulator.rehearsal.schedule import KINDS, FaultRow
from tetractl_emulator.rehearsal.truth import Truth

DayRow = Mapping[str, Any]
"""What is kept of a day: a line of `days.jsonl`."""


def row_of(day: int, truth: Truth, found: Sequence[Violation]) -> DayRow:
    """Return what is kept of a day: what was met, how it ended, and the broken invariants."""
    result = getattr(truth.log, "result", None)
    ended = "killed" if truth.day.exit < 0 else "refused"
    if truth.first("run") < np.inf and truth.day.exit >= 0:
        ended = str(result.outcome) if result is not None else "aborted"
    return {
        "day": day,
        "digest": truth.day.digest,
        "seconds": round(truth.day.seconds, 3),
        "ended": ended,
        "reason": truth.reason,
        "met": [[f["kind"], _noticed_s(truth, began)] for began, _, f in truth.faults],
        "violations": [[v.name, round(v.at_s, 3), v.found, v.predicted] for v in found],
    }


def _noticed_s(truth: Truth, began_s: float) -> float | None:
    """Return the time from a fault to the guard's abort or hold [s]; None if there was neither."""
    for event in truth.of("guard"):
        at_s = event["t_ns"] / 1e9
        if at_s >= began_s and event["state"] in ("hold", "abort"):
            return round(at_s - began_s, 4)
    return None


def broken(row: DayRow) -> list[list[Any]]:
    """Return the violations of a day that no derivation predicts."""
    return [violation for violation in row["violations"] if not violation[3]]


def tables(rows: Sequence[DayRow], kinds: Sequence[FaultRow] = KINDS) -> tuple[str, str]:
    """Return the faults met, as a table in Markdown, and a paragraph on the days."""
    times, met = defaultdict[str, list[float]](list), Counter[str]()
    for row in rows:
        for kind, noticed in row["met"]:
            met[kind] += 1
            if noticed is not None and len(row["met"]) == 1:
                times[kind].append(noticed)
    alone = Counter(row["met"][0][0] for row in rows if len(row["met"]) == 1)
    lines = [
        "| fault | met | alone | noticed | median [s] | p99 [s] | worst [s] |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for kind in kinds:
        took = times[kind.name]
        shown = [f"{np.quantile(took, q):.3f}" if took else "" for q in (0.5, 0.99, 1.0)]
        cells = [kind.name, met[kind.name], alone[kind.name], len(took), *shown]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    ended = Counter(row["ended"] for row in rows)
    shares = ", ".join(f"{count} {how}" for how, count in ended.most_common())
    predicted = Counter(v[3] for row in rows for v in row["violations"][:1] if v[3])
    classes = "".join(f"; {n} of the class '{name}', as derived" for name, n in predicted.items())
    return "\n".join(lines), f"days: {shares}{classes}"
