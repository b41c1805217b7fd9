"""How the trials of a batch ended: counts and shares of trials."""

from collections import Counter
from collections.abc import Sequence

from tetractl.core.plan import Outcome
from tetractl.core.table.numbers import NONE
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.statistic import Statistic, Value, count, share

_ARRIVED = share("arrived", "arrived", lambda trial: trial.outcome is Outcome.ARRIVED)
_ENTERED = share(
    "obstacle_violations", "entered an obstacle", lambda trial: trial.result.entered_obstacle
)


def _arrived(trials: Sequence[ResultSummary]) -> Value:
    if trials[0].experiment.controller.arrival_tolerance > 0:
        return _ARRIVED.of_batch(trials)
    unknown = {"arrived": None, "arrived_ci95": None}
    return Value(unknown, (("arrived, 95 % interval", f"{NONE} (no arrival_tolerance)"),))


def _outcomes(trials: Sequence[ResultSummary]) -> Value:
    found = Counter(trial.outcome for trial in trials)
    text = ", ".join(f"{n} {outcome.value}" for outcome, n in found.most_common())
    items = {outcome.value: found[outcome] for outcome in Outcome}
    return Value({"outcomes": items}, (("outcomes", text),))


OUTCOMES = Statistic(_outcomes)
ARRIVED = Statistic(_arrived)
OBSTACLE_VIOLATIONS = Statistic(
    _ENTERED.of_batch, lambda trial: {"entered_obstacle": trial.result.entered_obstacle}
)
ABORTED = count("aborted", "aborted", lambda trial: trial.outcome is Outcome.ABORTED)
INTERRUPTED = count(
    "interrupted", "interrupted", lambda trial: trial.outcome is Outcome.INTERRUPTED
)
RECOVERED = Statistic(
    count("recovered", "read from damaged logs", lambda trial: trial.recovered).of_batch,
    lambda trial: {"recovered": trial.recovered},
)
