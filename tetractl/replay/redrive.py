"""Drives a plant again with the recorded commands of a trial, open loop, and measures the distance
between the recorded and the new path.

A controller of kind `sequence` sends the directions in a separate trial, which is run, logged and,
in the lab, guarded like any other trial.
"""

from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.sequence import SequenceSection
from tetractl.core.clock import SECOND
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.experiment.load import LoadedSpec, parse_spec, resolved_yaml
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.identification.tracks import require_field, stopped_ns

EARLY = 0.25  # a stop may precede the end of a control period by this fraction of the period


def recorded_directions(log: TrialLog) -> tuple[Floats, float]:
    """Return the direction (C,) [rad] of each control period of a log, and a remainder [s].

    Periods count from the first direction sent, which may belong to the square that robots drive
    for identification before the first plan. A direction sent in the first half of a period counts
    for the whole period. The remainder is the time for which the last direction was held after the
    last whole period. UsageError if no direction was sent, or if the field was off at times.
    """
    require_field(log)
    sent = sorted(
        (one for one in log.commands if one.direction is not None), key=lambda one: one.sent_ns
    )
    if not sent:
        raise UsageError(f"{log.path}: no direction was sent")
    period = round(log.experiment.controller.period * SECOND)
    began = sent[0].sent_ns
    end = stopped_ns(log)
    end = sent[-1].sent_ns + period if end is None else end
    times = np.array([one.sent_ns - began for one in sent])
    count = max(1, (end - began + round(EARLY * period)) // period)
    at = np.arange(count) * period + period // 2
    index = np.searchsorted(times, at, side="right") - 1
    directions = np.array([sent[i].direction for i in index], dtype=np.float64)
    return directions, max(0, end - began - count * period) / SECOND


def sequence_spec(spec: LoadedSpec, directions: Floats, remainder: float) -> LoadedSpec:
    """Return a spec whose controller sends `directions` [rad], one per control period, and holds
    the last one for `remainder` [s] more.

    The robots stand still until the first direction, and arrival does not end the trial.
    """
    controller = SequenceSection(
        period=spec.experiment.controller.period,
        dead_time=spec.experiment.controller.dead_time,
        steps_max=len(directions),
        directions=tuple(directions.tolist()),
        remainder=remainder,
    )
    experiment = spec.experiment.model_copy(update={"controller": controller})
    text = resolved_yaml(experiment)
    made = parse_spec(text, spec.name, written=True)
    return replace(spec, experiment=made.experiment, text=text, path=None)


@dataclass(frozen=True, slots=True)
class Apart:
    """The distance between two trials of N robots at M times; `time_s` (M,) counts from the first
    direction of each trial.

    `distance` (M, N) [length unit] is the distance between the positions of a robot measured in the
    two trials, NaN unless it was tracked in both.
    """

    names: tuple[str, ...]
    unit: str
    time_s: Floats
    distance: Floats

    @property
    def final(self) -> Floats:
        """The last known distance between each robot's two positions, (N,)."""
        known = [column[np.isfinite(column)] for column in self.distance.T]
        return np.array([one[-1] if one.size else np.nan for one in known])


def paths_apart(recorded: TrialLog, again: TrialLog) -> Apart:
    """Return the distances between two trials of the same robots, at the recorded frames.

    The positions of `again` are interpolated between its frames. Times before the first direction
    and after the end of either trial are left out.
    """
    names = recorded.start.setup.names
    if names != again.start.setup.names:
        raise UsageError(f"{again.path}: its robots differ from those of {recorded.path}")
    first, second = ((log.mocap_ns - log.began_ns) / SECOND for log in (recorded, again))
    within = (first >= 0) & (first <= (second[-1] if len(second) else -1.0))
    time = first[within]
    distance = np.full((len(time), len(names)), np.nan)
    for i in range(len(names)):
        seen = again.valid[:, i]
        if not seen.any():
            continue
        x, y = (np.interp(time, second[seen], again.mocap[seen, i, axis]) for axis in (0, 1))
        was = recorded.mocap[within, i]
        gap = np.hypot(was[:, 0] - x, was[:, 1] - y)
        distance[:, i] = np.where(recorded.valid[within, i], gap, np.nan)
    return Apart(names, recorded.start.setup.unit, time, distance)
