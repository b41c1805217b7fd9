"""How near the true path of a batch's robots came to trouble, measured from their centres."""

from collections.abc import Callable, Sequence
from typing import Any

from tetractl.core.commands import Verdict
from tetractl.core.table.numbers import NONE, lengths
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.statistic import Statistic, Value, share

Distances = Callable[[Verdict], Sequence[float]]
"""The least distance of each robot in a trial [length unit]; empty where the log has none."""


def least(key: str, label: str, of: Distances) -> Statistic:
    """Return the least of a distance over all robots and trials, as a statistic.

    A trial whose log has no such distance is left out; its column is empty.
    """

    def of_trial(trial: ResultSummary) -> dict[str, Any]:
        found = min(of(trial.result.verdict), default=float("inf"))
        return {key: found if found < float("inf") else None}

    def of_batch(trials: Sequence[ResultSummary]) -> Value:
        known = [value for trial in trials if (value := of_trial(trial)[key]) is not None]
        unit = trials[0].experiment.units.length
        nearest = min(known, default=None)
        text = NONE if nearest is None else lengths(nearest)(nearest)
        return Value({key: nearest}, ((f"{label} [{unit}]", text),))

    return Statistic(of_batch, of_trial)


_LEFT = share("left_arena", "left the arena", lambda trial: trial.result.left_arena)
LEFT_ARENA = Statistic(_LEFT.of_batch, lambda trial: {"outside_arena": trial.result.left_arena})
CLEARANCE = least("clearance", "nearest to an obstacle", lambda verdict: verdict.clearance)
EDGE = least("edge", "nearest to the arena's edge", lambda verdict: verdict.edge)
APART = least("apart", "nearest to one another", lambda verdict: verdict.apart)
