"""Estimate the state of the robots at each control step, from camera frames and sent commands.

Commands act late, because the camera, the planner, the radio and the wheels all take time (the
*dead time*). A plan therefore has to start at the poses that the robots will have when the
direction that is decided now begins to act. This module predicts these poses from the newest frame.

There are two ways to predict. If the spec's values of the motion are certain, `KnownMotion` uses
them. Otherwise a bank of Kalman filters (`FilterBank`) learns the motion of each robot from all
frames and commands while the robots drive.

The controller calls `add_step` once a step, with the command of the previous step and the frames
since then. The result is the planning problem of this step. Commands that are sent between two
steps, such as turns and stops, are added by `add_command`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tetractl.control.estimation.known_motion import KnownForecast, KnownMotion
from tetractl.control.estimation.prediction_check import PredictionCheck, SentStep
from tetractl.control.estimation.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff
from tetractl.core.errors import ControlError
from tetractl.core.losses import LossRule, LossTracker
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, Observation

if TYPE_CHECKING:  # a trial of robots whose motion is known loads no filter
    from tetractl.control.estimation.filter import FilterBank


class StateEstimator:
    """Estimates the state and motion of the robots in one trial.

    Robots that are lost (`losses.lost`) are left out of every result.

    Args:
        problem: The spec's values of turning rate a and speed. With an uncertain prior, both are
            identified.
        period_s: The control period [s].
        prior: The uncertainty at the start.
        loss: The rule by which a robot is lost. None if no robot can be lost.
    """

    def __init__(
        self,
        problem: Problem,
        period_s: float,
        prior: Prior,
        loss: LossRule | None = None,
    ) -> None:
        self.problem = problem
        self.losses = LossTracker(loss, problem.speed)
        self.robots_changed = False
        """Whether robots were lost or replaced since the previous step."""
        self._period_ns = round(period_s * SECOND)
        self.filter = None if prior.certain else _filter_bank(prior)
        """The filters that identify each robot's motion.

        None if the motion is known exactly.
        """
        self._predictor = self.filter or KnownMotion(prior)
        self.estimate: Estimate | None = None if prior.certain else prior.estimate()
        self._predictions = PredictionCheck(period_s)
        self._has_misfit = False  # whether the model failed to fit at any time so far
        self._last_problem: Problem | None = None  # of all robots, in the previous step
        self._last_sent_ns: int | None = None
        self._newest_ns = 0
        self._held_directions = np.full(len(problem.a), np.nan)
        self.dead_time_s = prior.dead_time
        """Time from a command to its effect [s]: from the prior, later as identified."""

    @property
    def present(self) -> Bools:
        """An array (N,) that is True for each robot still in the trial, False for a lost one."""
        return self.losses.present

    @property
    def is_radio_sparse(self) -> bool:
        """Whether the filters found that the radio loses most directions.

        False without filters.
        """
        return self.filter is not None and self.filter.reception.is_sparse

    @property
    def present_estimate(self) -> Estimate | None:
        """The latest estimate of the motion, for the robots that are not lost.

        None if the motion is known exactly, so that nothing is identified.
        """
        return self.estimate and self.estimate.select_robots(self.present)

    def add_step(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Problem:
        """Add the previous step's command and the new frames, and predict the present problem.

        Args:
            observation: The newest frame.
            last_command: The command of the previous step. None if there is none to add.
            earlier: Frames between the frame of the previous step and the newest, oldest first.

        Returns:
            The problem with the poses that the robots will have when the next direction takes
            effect, and with the motion identified so far. Lost robots are left out.

        Raises:
            ControlError: If all robots are lost.
        """
        self._record_step(last_command, observation)
        if last_command is not None:
            self.add_command(last_command)
        self._newest_ns = observation.sampled_ns
        changes_before = self.losses.change_count
        replaced = [i for frame in (*earlier, observation) for i in self.losses.add_frame(frame)]
        self.robots_changed = self.losses.change_count > changes_before
        if self.robots_changed and not self.present.any():
            raise ControlError("all robots of the trial are lost")
        self._predictor.add_frames(observation, earlier)
        self._predictor.restart(replaced)
        forecast = self._predictor.forecast(self.sending_ns(observation))
        self._held_directions = forecast.directions
        self.dead_time_s = forecast.dead_time_s
        if isinstance(forecast, KnownForecast):
            return replace(self.problem, poses=forecast.poses).select_robots(self.present)
        estimate = forecast.estimate
        self._has_misfit |= not estimate.fits
        if self._has_misfit:
            estimate = replace(estimate, predictions=self._predictions.errors())
        self.estimate = estimate
        problem = replace(
            self.problem,
            poses=forecast.poses,
            bias=forecast.turn_bias,
            flow=forecast.flow,
            a=estimate.a,
            speed=estimate.speed,
            side=estimate.side,
            saturation=estimate.saturation,
        )
        self._last_problem = problem
        return problem.select_robots(self.present)

    def _record_step(self, last_command: Command | None, observation: Observation) -> None:
        """Record the previous step, to compare its prediction with frames if the model misfits.

        Predictions are only compared while all robots drive.
        """
        direction = None if last_command is None else last_command.direction
        if last_command is None or direction is None or self._last_problem is None:
            self._predictions.clear()
            return
        acts_ns = last_command.sent_ns + round(self.dead_time_s * SECOND)
        step = SentStep(self._last_problem, direction, acts_ns)
        self._predictions.add_step(step, observation)

    def add_command(self, command: Command) -> None:
        """Record a command that was sent to the robots, with the time at which it was sent.

        If the radio lets only a few directions through, robots hardly ever receive the repetition
        of a direction within the same signal period. In this case, such repetitions are ignored,
        so that the filter counts each signal only once.
        """
        if not isinstance(command.action, FieldOff):
            self._last_sent_ns = None if command.direction is None else command.sent_ns
        if self.estimate is None:
            command = replace(command, sent_ns=self._newest_ns)
        if self._is_repetition(command):
            return
        self._predictor.add_command(command)

    def _is_repetition(self, command: Command) -> bool:
        """Check whether a command repeats the last one within a signal period of a sparse radio.

        Control steps are not perfectly regular. A command that comes up to half a step before the
        end of the period therefore belongs to the next period.
        """
        if self.filter is None or not self.filter.reception.is_sparse:
            return False
        commands = self.filter.commands
        if command.direction is None or not len(commands.sent_s):
            return False
        is_same = command.direction == commands.directions[-1]
        since_ns = command.sent_ns - round(commands.sent_s[-1] * SECOND)
        signal_ns = round(self.problem.period * SECOND)
        return bool(is_same and since_ns < signal_ns - self._period_ns // 2)

    def sending_ns(self, observation: Observation) -> int:
        """Compute the time from which the dead time of the next direction counts [ns].

        The spec's dead time counts from the exposure of the frame on which a direction is decided,
        so the result is the time of the exposure. An identified dead time counts from the sending
        of the direction. The direction is expected one control period after the previous one. If
        that moment is earlier than the reception of the frame, or more than 1.5 periods later, the
        result is the reception; the time for planning is neglected.
        """
        if self.estimate is None:
            return observation.sampled_ns
        received_ns = observation.received_ns
        if self._last_sent_ns is None:
            return received_ns
        due_ns = self._last_sent_ns + self._period_ns
        is_due = received_ns <= due_ns <= received_ns + 3 * self._period_ns // 2
        return due_ns if is_due else received_ns

    @property
    def directions_at_action(self) -> Floats:
        """The direction [rad] that each robot follows when the next direction takes effect.

        Lost robots are left out. The direction is NaN for a robot that stands still.
        """
        return self._held_directions[self.present]


def _filter_bank(prior: Prior) -> "FilterBank":
    """Create the filters that learn the motion of robots with an uncertain prior."""
    from tetractl.control.estimation.filter import FilterBank

    return FilterBank(prior)
