"""The times of solving of a batch: percentiles over every step of every trial, and misses."""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import MILLISECOND
from tetractl.core.table.numbers import NONE, digits
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.statistic import Statistic, Value

PERCENTILES = {"p50": 50, "p99": 99, "max": 100}


def _solve_ms(trials: Sequence[ResultSummary]) -> Value:
    solve_ns = [ns for trial in trials for ns in trial.result.solve_ns]
    found: dict[str, float | None] = dict.fromkeys(PERCENTILES)
    if solve_ns:
        solve_ms = np.array(solve_ns, dtype=float) / MILLISECOND
        values = np.percentile(solve_ms, list(PERCENTILES.values())).tolist()
        found = dict(zip(PERCENTILES, values, strict=True))
    rows = [
        (f"solve time {name} [ms]", NONE if value is None else digits(value))
        for name, value in found.items()
    ]
    return Value({"solve_ms": found}, tuple(rows))


def _deadline_misses(trials: Sequence[ResultSummary]) -> Value:
    misses = sum(trial.result.deadline_misses for trial in trials)
    return Value({"deadline_misses": misses}, (("deadline misses", str(misses)),))


SOLVE_MS = Statistic(_solve_ms)
DEADLINE_MISSES = Statistic(
    _deadline_misses, lambda trial: {"deadline_misses": trial.result.deadline_misses}
)
