"""A recorded trial without its closed loop: its commands driven again, and other decisions on its
observations.

`paths_apart` measures the distance between the recorded and the new path. A controller of kind
`sequence` sends the recorded directions in a separate trial, which is run, logged and, in the lab,
guarded like any other trial.

In `what_if` another controller receives each recorded observation and the directions that were
sent, not its own, so every step starts from the recorded state. Under its own decisions, the robots
would have been elsewhere at the next step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.sequence import SequenceSection
from tetractl.control.work_clock import WorkClock
from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.plan import End, Plan
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import LoadedSpec, parse_spec, resolved_yaml
from tetractl.log.format.codec import drawn
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.identification.tracks import require_field, stopped_ns
from tetractl.replay.recompute import first_steps, plan_again
from tetractl.run.checked_controller import CheckedController
from tetractl.run.task import trial_seeds


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
    # a stop may precede the end of a control period by this fraction of the period
    count = max(1, (end - began + round(0.25 * period)) // period)
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


SAME_RAD = 1e-9
"""Directions that differ by less than this [rad] count as the same."""


@dataclass(frozen=True, slots=True)
class StepPrediction:
    """The recorded decision and the other controller's decision at control step k.

    `difference` [rad] is the other direction minus the one sent, in [-pi, pi]. `recorded_error` and
    `other_error` are the sums of distances to the targets at the predicted ends of both plans, and
    `apart` (N,) is the distance between each robot's two predicted ends [length unit].
    `recorded_length` and `other_length` are the numbers of signals of both plans.
    """

    k: int
    time_s: float
    recorded: float
    other: float
    difference: float
    recorded_length: int
    other_length: int
    recorded_error: float
    other_error: float
    apart: Floats


@dataclass(frozen=True, slots=True)
class WhatIf:
    """The predictions for a trial; `ended` is why later steps have no prediction, or ""."""

    unit: str
    steps: tuple[StepPrediction, ...]
    recorded_steps: int
    ended: str

    @property
    def changed(self) -> int:
        """Number of steps at which the other controller decides another direction."""
        return sum(abs(step.difference) > SAME_RAD for step in self.steps)


def other_experiment(log: TrialLog, sets: Sequence[str]) -> Experiment:
    """Return the log's experiment with values of its controller replaced.

    UsageError for settings outside the controller, and for another control period, since
    observations exist only at the recorded one. SpecError if the changed spec is not valid.
    """
    for setting in sets:
        path = setting.partition("=")[0].strip()
        if path.split(".")[0] != "controller":
            raise UsageError(
                f"--set {setting}: only fields of 'controller' can be replaced in a log",
                "to change the plant or the robots, run the spec again",
            )
    other = parse_spec(log.start.resolved, "the log's spec", sets, written=True).experiment
    period, recorded = other.controller.period, log.experiment.controller.period
    if period != recorded:
        raise UsageError(
            f"controller.period: {period:g} differs from the recorded {recorded:g}",
            "keep the period: there are no observations between the recorded ones",
        )
    return other


def what_if(log: TrialLog, other: Experiment) -> WhatIf:
    """Return what another experiment's controller would have decided at each step of a log.

    Deadlines are kept by the work of searches. Steps after a gap in the log are left out.
    UsageError if either controller switches the field off at times.
    """
    require_field(log)
    if other.controller.switches_field:
        raise UsageError(
            f"controller.type: {other.controller.type} switches the field off at times",
            "choose a controller that sends a direction at every step",
        )
    key, _ = trial_seeds(log.start.seed, log.start.trial)
    setup = other.setup
    work = WorkClock()
    controller = CheckedController(other.controller, setup, key, Host(work.wrap, work))
    found, ended, last = [], "", None
    steps = first_steps(log)
    for step in steps:
        try:
            decision = plan_again(controller, log, last, step.observation)
        except TetractlError as error:
            ended = f"at step {step.k} the other controller fails: {error.message}"
            break
        if not isinstance(decision, Plan):
            outcome = decision.outcome if isinstance(decision, End) else decision
            ended = f"at step {step.k} the other controller would have ended the trial: {outcome}"
            break
        u, sent = float(decision.signals[0]), float(step.plan.signals[0])
        ends = [drawn(plan.path[-1, :, :2]) for plan in (step.plan, decision)]
        found.append(
            StepPrediction(
                k=step.k,
                time_s=log.elapsed_s(step.command.sent_ns),
                recorded=sent,
                other=u,
                difference=float(wrap(np.array(u - sent))),
                recorded_length=len(step.plan.signals),
                other_length=len(decision.signals),
                recorded_error=float(setup.distances(ends[0]).sum()),
                other_error=float(setup.distances(ends[1]).sum()),
                apart=np.hypot(*(ends[1] - ends[0]).T),
            )
        )
        last = step
    if not ended and len(steps) < len(log.steps):
        ended = f"the log lacks step {len(steps)}"
    return WhatIf(setup.unit, tuple(found), len(log.steps), ended)
