"""Estimates the robots' state at a control step from frames and commands.

The estimate is the poses that the robots will have when the direction decided now begins to act.
The prediction starts at the newest frame and uses the spec's values of the motion, or the values
that a bank of filters identifies from all frames and commands while the robots drive.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tetractl.control.delay import Held, Predictor, advance
from tetractl.control.filter import FilterBank, Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.errors import ControlError
from tetractl.core.plan import Estimate, Problem
from tetractl.core.poses import Bools, Floats, Observation
from tetractl.core.tour import Losses, LossRule

REMEMBERED = SECOND  # time for which commands are kept after they stopped acting [ns]


class StateEstimator:
    """Estimates the state and motion of the robots in one trial.

    `problem` has the spec's values of turning rate a and speed; with a `prior` both are identified.
    With `drive_first`, robots drive a square before the first plan, and identification starts when
    the first direction acts. Robots that the `loss` rule counts as lost (`losses.lost`) are left
    out of every result.
    """

    def __init__(
        self,
        problem: Problem,
        period_s: float,
        dead_time_s: float,
        prior: Prior | None,
        drive_first: bool = False,
        loss: LossRule | None = None,
    ) -> None:
        self.problem = problem
        self.losses = Losses(loss, len(problem.a))
        self.period = round(period_s * SECOND)
        self.predictor = Predictor(dead_time_s, len(problem.a))
        self.filter = None if prior is None else FilterBank(prior, drive_first)
        self.estimate: Estimate | None = None if prior is None else prior.estimate()
        self._last_sent: int | None = None
        self._newest_ns = 0

    @property
    def dead_time_s(self) -> float:
        """The identified dead time, or the spec's if none is identified [s]."""
        known = None if self.estimate is None else self.estimate.dead_time
        return self.predictor.dead_time_s if known is None else known

    @property
    def left(self) -> Bools:
        """True for each robot that is not lost, (N,)."""
        return ~self.losses.lost

    @property
    def known(self) -> Estimate | None:
        """The latest estimate for the robots that are not lost; None if nothing is identified."""
        return self.estimate and self.estimate.only(self.left)

    def seen(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Problem:
        """Add the previous step's command and the frames since; return the problem with the poses
        at which the next direction acts.
        """
        if last_command is not None:
            self.sent(last_command)
        self._newest_ns = observation.sampled_ns
        others = {i for frame in (*earlier, observation) for i in self.losses.see(frame)}
        if self.losses.lost.all():
            raise ControlError("every robot is lost")
        if self.filter is not None:
            return self._identified(observation, earlier, others).only(self.left)
        self.predictor.forget(self._newest_ns - REMEMBERED)
        poses, acts = observation.poses, self.acts(observation)
        if acts > self._newest_ns:
            poses = advance(self.problem, poses, self.held(acts))
        return replace(self.problem, poses=poses).only(self.left)

    def sent(self, command: Command) -> None:
        """Add a direction with the time at which it was sent and the robots that received it."""
        if not command.field_off:
            u = np.nan if command.direction is None else command.direction
            self._last_sent = None if command.direction is None else command.sent_ns
            self.predictor.sent(self._newest_ns, u)
        if self.filter is not None:
            self.filter.sent(command)

    def _identified(
        self, observation: Observation, earlier: Sequence[Observation], others: Iterable[int]
    ) -> Problem:
        assert self.filter is not None
        self.filter.seen(observation, earlier)
        self.filter.restart(others)
        estimate = self.estimate = self.filter.estimate()
        poses, bias, flow = self.filter.course()
        known = replace(self.problem, a=estimate.a, speed=estimate.speed, bias=bias, flow=flow)
        until = self.acts(observation)
        if self.filter.prior.lag > 0:
            return replace(known, poses=self.filter.rests(until))
        return replace(known, poses=advance(known, poses, self.held(until)))

    def held(self, until: int) -> list[Held]:
        """Return the directions that act from the newest frame to a time [ns], oldest first."""
        if self.filter is not None:
            return self.filter.held(until)
        return self.predictor.held(self._newest_ns, until)

    def held_at_action(self, observation: Observation) -> Floats:
        """Return, for each robot that is not lost, the direction [rad] that it follows at the
        moment when the next direction begins to act, NaN for a robot that stands still.
        """
        return self.held(self.acts(observation) + 1)[-1][2][self.left]

    def acts(self, observation: Observation) -> int:
        """Return the time at which a direction decided on a frame acts [ns].

        The spec's dead time counts from the exposure of the frame. An identified dead time counts
        from the sending of the direction. The direction is assumed to be sent one control period
        after the previous one or, if that moment is before the frame's reception or more than 1.5
        periods after it, at the reception; the time for planning is neglected.
        """
        if self.filter is None:
            return observation.sampled_ns + self.predictor.delay_ns
        send = observation.received_ns
        if self._last_sent is not None:
            due = self._last_sent + self.period
            if send <= due <= send + 3 * self.period // 2:
                send = due
        return send + round(self.dead_time_s * SECOND)
