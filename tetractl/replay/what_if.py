"""Computes what another controller would have decided on the observations of a recorded trial.

The other controller receives each recorded observation and the directions that were sent, not its
own, so every step starts from the recorded state. This is not closed loop: under its own decisions,
the robots would have been elsewhere at the next step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.control.work_clock import WorkClock
from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.plan import End, Plan
from tetractl.core.poses import Floats, wrap
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import parse_spec
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.identification.tracks import require_field
from tetractl.replay.recompute import first_steps, plan_again
from tetractl.run.task import trial_seeds

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
    controller = other.controller.build(setup, key, Host(work.wrap, work))
    found, ended, last = [], "", None
    steps = first_steps(log)
    for step in steps:
        try:
            decision = plan_again(controller, log, last, step.observation)
        except TetractlError as error:
            ended = f"at step {step.k} the other controller fails: {error}"
            break
        if not isinstance(decision, Plan):
            outcome = decision.outcome if isinstance(decision, End) else decision
            ended = f"at step {step.k} the other controller would have ended the trial: {outcome}"
            break
        u, sent = float(decision.signals[0]), float(step.plan.signals[0])
        ends = [plan.path[-1, :, :2] for plan in (step.plan, decision)]
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
