"""How tightly robots were held: the disc round its target in which each is for 95 % of a hold.

Its diameter is twice the 0.95-quantile of the distances to the target, by true poses where they are
known, without the first SETTLING_S. It is read from the log: a trial without one has none.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.core.table.table import lengths
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import ResultSummary, TrialLog
from tetractl.results.estimate import distributions
from tetractl.results.statistic import Statistic, Value

SHARE, SETTLING_S = 0.95, 5.0
"""Share of the time, and time of a hold that is not counted [s]."""


def discs(log: TrialLog) -> Floats:
    """Return the diameter (N,) of each robot's disc [length unit]; NaN if no frame counts."""
    setup = log.start.setup
    held = [s.observation.sampled_ns for s in log.steps if s.plan.leg == len(setup.legs)]
    poses = log.mocap if log.truth is None else log.truth
    since = held[0] + SETTLING_S * SECOND if held else np.inf
    gaps = setup.distances(poses[log.mocap_ns >= since, :, :2])
    return 2 * np.nanquantile(gaps, SHARE, axis=0) if len(gaps) else np.full(gaps.shape[1], np.nan)


@lru_cache(maxsize=1024)
def _of_log(log: Path, digest: str | None) -> Sequence[float]:
    """Return `discs` of the log with a content digest: a table of trials and its means need it."""
    return tuple(discs(read_trial(log)).tolist())


def _of_trial(trial: ResultSummary) -> dict[str, Any]:
    """Return the diameter of each robot's disc; None without a whole log or a complete hold."""
    hold, log = trial.experiment.hold, Path(trial.log)
    if hold is None or hold.time <= SETTLING_S:
        return {}
    names = trial.experiment.setup.names
    known = trial.outcome.complete and not trial.brief
    found = _of_log(log, trial.digest) if known else [None] * len(names)
    return {f"disc_{name}": one for name, one in zip(names, found, strict=True)}


def _of_batch(trials: Sequence[ResultSummary]) -> Value:
    """Return the mean of each robot's diameter over the trials, with its 95 % interval."""
    columns = [_of_trial(trial) for trial in trials]
    unit, items, rows = trials[0].experiment.units.length, dict[str, Any](), list[tuple[str, str]]()
    for key in columns[0]:
        known = [one[key] for one in columns if one[key] is not None]
        (found,) = distributions(np.array([known], dtype=float))
        show = lengths(found.mean)
        text = f"{show(found.mean)} (n {found.n}, 95 % interval {found.ci95.text(show)})"
        rows.append((f"diameter of the disc of 95 % of the hold ({key}), mean [{unit}]", text))
        items[key] = found.as_dict()
    return Value(items, tuple(rows))


DISC = Statistic(_of_batch, _of_trial)
