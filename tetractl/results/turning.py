"""Compares how each robot of a lab turned by itself with its other trials in the batch.

A pose that turns, with its course, from the start of a trial on looks like wheels that differ, and
no check of one trial can tell the two apart. But a robot has the same wheels in every trial. With
its rate x_k and standard error e_k in trial k of n (`lab.drift_check`), the median m of the rates
and e of the errors, trial k differs if

    |x_k - m| > z sqrt(e_k^2 + max(0, (1 + FEW / n)^2 s^2 - e^2)),   s = 1.4826 median |x_j - m|,

where s is the standard deviation of the rates, whatever fewer than half of them show, and z a
quantile of the normal distribution: of all N n rates of N robots, one is beyond it by chance in the
fraction CHANCE of batches. The fewer trials, the less is known of s; with FEW, normal rates exceed
the limit in 1 % of batches of ten trials or more, and in at most 3 % of smaller ones.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from tetractl.core.table.table import NONE
from tetractl.experiment.lab_section import LabLimits, LabSection
from tetractl.log.read.trial_log import ResultSummary
from tetractl.results.open_batch import listing
from tetractl.results.statistic import Statistic, Value

CHANCE = 0.01
LEAST, FEW = 6, 14.0
LABEL = "less certain"


def _compared(trials: Sequence[ResultSummary]) -> Iterator[tuple[str, str, float, float]]:
    """Yield the path of a trial, a robot, by how much it turned otherwise than in the median of its
    trials, and the limit of this [rad/s].
    """
    robots = trials[0].experiment.setup.names if trials else ()
    for i, name in enumerate(robots):
        turns = ((trial.log, trial.result.verdict) for trial in trials)
        known = [(path, v.turn[i], v.turn_std[i]) for path, v in turns if v.turn]
        known = [one for one in known if math.isfinite(one[2])]
        if len(known) < LEAST:
            continue
        off, errors = np.array([each for _, *each in known]).T
        off = off - np.median(off)
        spread = (1 + FEW / len(known)) * 1.4826 * np.median(np.abs(off))
        beyond = max(0.0, spread**2 - np.median(errors) ** 2)  # what no error explains
        z = NormalDist().inv_cdf(1 - CHANCE / (2 * len(robots) * len(known)))
        limits = z * np.sqrt(errors**2 + beyond)
        for (path, *_), each, limit in zip(known, off.tolist(), limits.tolist(), strict=True):
            yield path, name, each, limit


def turned_otherwise(trials: Sequence[ResultSummary]) -> dict[str, list[str]]:
    """Return a text for each robot that turned otherwise than in its other trials, by the path of
    the trial.
    """
    found = defaultdict[str, list[str]](list)
    for path, name, off, limit in _compared(trials):
        if abs(off) > limit:
            found[path].append(f"{name} turned by {off:+.2f} rad/s unlike in the other trials")
    return found


def _of_batch(trials: Sequence[ResultSummary]) -> Value:
    if not any(trial.result.verdict.turn for trial in trials):
        return Value({"less_certain": None}, ())
    compared = list(_compared(trials))
    if not compared:
        text = (
            f"{NONE} (one camera does not tell a pose that turns by up to {_hidden(trials[0]):.1f} "
            f"rad/s while its robot drives from unequal wheels; {LEAST} trials are compared)"
        )
        return Value.row(LABEL, text, less_certain=None)
    odd = [(path, name, off) for path, name, off, limit in compared if abs(off) > limit]
    count = len({path for path, *_ in odd})
    text = f"{count} of {len({path for path, *_ in compared})} trials"
    if odd:
        named = [f"{name} in {Path(path).stem}, {off:+.2f} rad/s" for path, name, off in odd]
        text += f", by wheels that changed or false poses: {listing(named, '; ')}"
    else:
        text += f", turns above {max(limit for *_, limit in compared):.2f} rad/s would be seen"
    return Value.row(LABEL, text, not odd, less_certain=count)


def _hidden(trial: ResultSummary) -> float:
    """Return the fastest turn [rad/s] of a pose that wheels within `wheel_error` explain: of one
    that is so much too slow and one that is so much too fast."""
    setup = trial.experiment.setup
    plant = trial.experiment.plant
    limits = plant.limits if isinstance(plant, LabSection) else LabLimits()
    radius = setup.wheel_radius or math.inf
    return limits.wheel_error * float(setup.speed.max()) / radius


def _of_trial(trial: ResultSummary) -> dict[str, Any]:
    """Return each robot's rate and its standard error, None if they are unknown."""
    verdict, names = trial.result.verdict, trial.experiment.setup.names
    if trial.simulated or trial.experiment.setup.wheel_radius is None:
        return {}
    nothing = (math.inf,) * len(names)
    rates, errors = verdict.turn or nothing, verdict.turn_std or nothing
    items = dict[str, Any]()
    for name, rate, error in zip(names, rates, errors, strict=True):
        known = math.isfinite(error)
        items[f"turn_{name}_rad_s"] = rate if known else None
        items[f"turn_std_{name}_rad_s"] = error if known else None
    return items


TURN = Statistic(_of_batch, _of_trial)
