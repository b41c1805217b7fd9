"""What a controller knows of the robots at a control step, from frames and commands alone.

Given every frame and every command of a trial, in order, it returns where the robots will be when
the direction decided now acts, and how they move: their a and speed, as the spec says or as
identified while they drive, the dead time, and which commands arrived.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from tetractl.control.delay import Predictor, advance
from tetractl.control.evidence import Evidence
from tetractl.control.identify import Prior
from tetractl.control.losses import Arrivals
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.plan import Estimate
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.problem import Problem
from tetractl.experiment.kinds import MOTIONS

BELIEVABLE_S = 0.03  # deviation of the dead time up to which lost commands are told from late ones
REMEMBERED = SECOND  # ns for which commands are remembered after they stopped acting


class Knowledge:
    """What is known during one trial.

    `problem` has a and speed of the spec. With a `prior`, the motion is identified while driving;
    with `losses`, lost commands are believed in.
    """

    def __init__(
        self,
        problem: Problem,
        period_s: float,
        dead_time_s: float,
        prior: Prior | None,
        losses: bool,
    ) -> None:
        self.problem = problem
        self.predictor = Predictor(dead_time_s, len(problem.a))
        self.period = round(period_s * SECOND)
        self.estimate: Estimate | None = None if prior is None else prior.estimate()
        self._prior = prior
        lanes = MOTIONS.load(problem.motion).lanes(problem.a, problem.period)
        lanes = lanes.of(problem.a, problem.speed, problem.period)
        self._arrivals = Arrivals(self.predictor, lanes) if losses else None
        self._evidence: Evidence | None = None
        if prior is not None:
            from tetractl.control.kernels.identify import fit

            self._fit = partial(fit, prior=prior, lanes=lanes)
            settled = prior.dead_time + 3 * prior.dead_time_std
            self._evidence = Evidence(problem.speed, period_s, settled)
        self._last_sent: int | None = None
        self._newest_ns = 0

    def sent(self, sent_ns: int, u: float) -> None:
        """Add a direction u [rad] sent at a time [ns] in answer to the newest frame."""
        self._last_sent = sent_ns
        self.predictor.sent(self._newest_ns if self._prior is None else sent_ns, u)
        if self._evidence:
            self._evidence.sent(sent_ns, u)

    def seen(self, observation: Observation, last_command: Command | None = None) -> Problem:
        """Add a frame, and how the direction before it was sent; return the problem of the robots
        where the next direction will act."""
        if last_command is not None and last_command.direction is not None:
            self.sent(last_command.sent_ns, last_command.direction)
        now, estimate = observation.sampled_ns, self.estimate
        self._newest_ns = now
        if self._evidence and self._evidence.seen(observation):
            assert estimate is not None
            intervals, directions = self._evidence.intervals(), self._evidence.directions()
            self.estimate = estimate = self._fit(intervals, directions, guess=estimate)
            self.problem = replace(self.problem, a=estimate.a, speed=estimate.speed)
            assert estimate.dead_time is not None
            self.predictor.dead_time_s = estimate.dead_time
        bias = self._bias()
        if self._arrivals:
            self._arrivals.seen(observation)
            if estimate is None or (estimate.dead_time_std or 0.0) < BELIEVABLE_S:
                self._arrivals.believe(self.problem, bias)
        self.predictor.forget(now - REMEMBERED)
        poses, acts = observation.poses, self.acts(observation)
        if acts is not None:
            poses = advance(self.problem, poses, self.predictor.held(now, acts), bias)
        return replace(self.problem, poses=poses)

    def held_at_action(self, observation: Observation) -> tuple[Floats, Floats]:
        """Return the directions (N,) [rad] held when one decided on a frame will act, NaN for a
        robot that stands, and the heading biases (N,) [rad].
        """
        acts = self.acts(observation)
        at = observation.sampled_ns if acts is None else acts
        return self.predictor.held(at, at + 1)[-1][2], self._bias()

    def _bias(self) -> Floats:
        known = None if self.estimate is None else self.estimate.heading_bias
        return np.zeros(len(self.problem.a)) if known is None else known

    def acts(self, observation: Observation) -> int | None:
        """Return when a direction decided on a frame will act [ns], None without any dead time.

        A dead time that is told counts from the exposure of the frame. One that is identified
        counts from the sending, a control period after the one before or as soon as the frame was
        received: what planning and a late frame take is no part of it.
        """
        if self._prior is None:
            delay = self.predictor.delay_ns
            return observation.sampled_ns + delay if delay else None
        send = observation.received_ns
        if self._last_sent is not None:
            due = self._last_sent + self.period
            if send <= due <= send + 3 * self.period // 2:
                send = due
        return send + self.predictor.delay_ns


def warm_up(problem: Problem, period_s: float, prior: Prior | None, losses: bool) -> None:
    """Compile, or load from the cache, what a `Knowledge` of these runs.

    It is shown robots that go straight on. Where the motion is identified, losses are believed in
    only once the dead time is known: another `Knowledge`, which is told it, believes in them.
    """
    several = [] if prior is None else [Knowledge(problem, period_s, 0.0, prior, losses=False)]
    if losses:
        several.append(Knowledge(problem, period_s, 0.0, None, losses=True))
    start, valid = problem.poses, np.ones(len(problem.a), dtype=np.bool_)
    for knowledge in several:
        for k in range(3):
            way, now = problem.speed * (k * period_s), k * knowledge.period
            x, y = start.x + way * np.cos(start.heading), start.y + way * np.sin(start.heading)
            knowledge.seen(Observation(k, now, now, Poses(x, y, start.heading), valid))
            knowledge.sent(now, 0.0)
