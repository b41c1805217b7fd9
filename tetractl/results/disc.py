"""A statistic of holds: how tightly each robot was held at its target, as the diameter of a disc.

A robot is in the disc round its target for 95 % of the hold. The diameter is twice the
0.95-quantile of the distances to the target, by true poses where they are known, without the first
SETTLING_S. It is read from the log: a trial without one has none.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import ResultSummary, TrialLog
from tetractl.results.estimate import distributions
from tetractl.results.statistic import Figure, Statistic, mean_figure

SHARE = 0.95
"""Share of the time for which a robot is in its disc."""
SETTLING_S = 5.0
"""Time from the begin of a hold that is not counted [s]."""


def discs(log: TrialLog) -> Floats:
    """Return the diameter (N,) of each robot's disc [length unit]; NaN if no frame counts."""
    setup = log.start.setup
    held_ns = [s.observation.sampled_ns for s in log.steps if s.plan.leg == len(setup.legs)]
    counts_from_ns = held_ns[0] + SETTLING_S * SECOND if held_ns else np.inf
    poses = log.mocap if log.truth is None else log.truth
    distances = setup.distances(poses[log.mocap_ns >= counts_from_ns, :, :2])
    if not len(distances):
        return np.full(distances.shape[1], np.nan)
    return 2 * np.nanquantile(distances, SHARE, axis=0)


@lru_cache(maxsize=1024)
def _of_log(log: Path, digest: str | None) -> Sequence[float]:
    """Return `discs` of the log with a content digest: a table of trials and its means need it."""
    trial = read_trial(log)
    return tuple(discs(trial).tolist())


def _of_trial(trial: ResultSummary) -> dict[str, Any]:
    """Return the diameter of each robot's disc; None without a whole log or a complete hold."""
    hold = trial.experiment.hold
    if hold is None or hold.time <= SETTLING_S:
        return {}
    names = trial.experiment.setup.names
    diameters: Sequence[float | None] = [None] * len(names)
    if trial.outcome.complete and not trial.brief:
        diameters = _of_log(Path(trial.log), trial.digest)
    return {f"disc_{name}": diameter for name, diameter in zip(names, diameters, strict=True)}


def _of_batch(trials: Sequence[ResultSummary]) -> list[Figure]:
    """Return the mean of each robot's diameter over the trials, with its 95 % interval."""
    rows = [_of_trial(trial) for trial in trials]
    unit = trials[0].experiment.units.length
    figures: list[Figure] = []
    for key in rows[0]:
        diameters = [row[key] for row in rows if row[key] is not None]
        (distribution,) = distributions(np.array([diameters], dtype=float))
        label = f"diameter of the disc of 95 % of the hold ({key}), mean [{unit}]"
        figures.append(mean_figure(key, label, distribution, states_n=True))
    return figures


DISC = Statistic(_of_batch, _of_trial)
