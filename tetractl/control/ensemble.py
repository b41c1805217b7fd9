"""Feedback Ensemble Control (section I of the paper): the field alternately rotates and is off.

While the field rotates, the robots follow it, each with a lag that depends on its turning rate a.
When their headings are such that the control Lyapunov function

    V = sum_i || s_i - tar_i ||

would fall without a field, the field is switched off, and the robots drive straight until V would
rise. The paper gives no parameters for this earlier algorithm of its authors; the defaults are
tetractl's choice. Obstacles are ignored.
"""

from collections import deque
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import foreseen_along, predict
from tetractl.control.fixed_sequence import given_search, make_plan
from tetractl.control.plain import PlainController, PlainSection
from tetractl.control.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff
from tetractl.core.plan import Outcome, Plan, Problem
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.experiment.base import Fraction, Positive
from tetractl.experiment.controller import ALONE, Host
from tetractl.model.motion.exact import step as exact


class EnsembleSection(PlainSection):
    """Feedback Ensemble Control: the field rotates until the sum of distances to the targets would
    fall without a field; then it is off as long as the sum falls. The controller ignores obstacles
    and works in simulations only."""

    switches_field: ClassVar[bool] = True
    type: Literal["ensemble"]
    rate: Positive = 1.3
    """Angular velocity of the rotating field, in units of the robots' least turning rate. Up to 1
    every robot follows with a constant lag; above 1 the robot with the least turning rate cannot
    follow.
    """
    fall: Fraction = 0.3
    """The field is switched off if, over the coming control period, the sum of distances would fall
    by more than this fraction of the robots' summed path lengths, which is the largest possible
    fall.
    """
    turns: float = Field(default=3.0, gt=0, le=1000, allow_inf_nan=False)
    """The trial ends if the field has made this number of turns without being switched off, and
    the next step would not reduce the sum of distances."""

    def warm_up(self, setup: Setup) -> None:
        """Do nothing: nothing is compiled."""

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "Ensemble":
        """Return the controller of one trial."""
        return Ensemble(self, setup, key)


class Ensemble(PlainController):
    """The controller of one trial. No random numbers are drawn; `key` is only used for the log."""

    def __init__(self, section: EnsembleSection, setup: Setup, key: int) -> None:
        super().__init__(section, setup, key)
        self.section = section
        self._delay_ns = round(section.dead_time * SECOND)
        # times from which directions act [ns], and the directions u [rad], None for no field
        self._acting: deque[tuple[int, float | None]] = deque()
        # direction of the rotating field [rad], None while it is off
        self._phase: float | None = None
        self._turned = 0.0  # angle by which the field has turned since it was switched on [rad]

    def predicted(self, observation: Observation, last_command: Command | None) -> Problem:
        """Return the problem with the poses at which the decision acts."""
        return replace(self.problem, poses=self._when_acting(observation))

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Plan | Outcome:
        """Rotate the field further, switch it off, or end the trial."""
        section = self.section
        straight = _ahead(problem, problem.poses, None, section.period)
        error = float(problem.poses.distances(problem.targets).sum())
        fall = error - _sum(problem, straight.array())
        driving = self._phase is None and self.k > 0  # the field stays off until V would rise
        least = 0.0 if driving else section.fall * float(problem.speed.sum()) * section.period
        if fall > least:
            self._phase = None
            self._turned = 0.0
            plan = self._decide(problem, np.zeros(1), straight)
        else:
            self._turn(problem)
            signals = np.array([self._phase])
            path = predict(problem, signals)
            if self._turned > 2 * np.pi * section.turns and _sum(problem, path[-1]) >= error:
                return Outcome.NO_BETTER_PLAN
            plan = self._decide(problem, signals, Poses.of(path[-1]))
        self._acting.append((observation.sampled_ns + self._delay_ns, plan.direction))
        return plan

    def _turn(self, problem: Problem) -> None:
        """Rotate the field by one step; if the field is off, begin at the robots' mean heading."""
        step = self.section.rate * float(problem.a.min()) * self.section.period
        if self._phase is None:
            heading = problem.poses.heading
            sine = np.sin(heading).sum()
            cosine = np.cos(heading).sum()
            self._phase = float(np.arctan2(sine, cosine))
        self._phase = float(np.remainder(self._phase + step + np.pi, 2 * np.pi) - np.pi)
        self._turned += step

    def _decide(self, problem: Problem, signals: Floats, end: Poses) -> Plan:
        """Return the plan of one control period, which ends at the poses `end`."""
        path = np.stack([problem.poses.array(), end.array()])
        foreseen = foreseen_along(problem, path)
        search = given_search(problem, signals, foreseen)
        plan = make_plan([search], 0, mix(self.key, self.k), foreseen)
        return replace(plan, instead=FieldOff() if self._phase is None else None)

    def _when_acting(self, observation: Observation) -> Poses:
        """Return the poses one dead time after the frame's exposure, when the decision acts."""
        now = observation.sampled_ns
        poses = observation.poses
        until = now + self._delay_ns
        while len(self._acting) > 1 and self._acting[1][0] <= now:
            self._acting.popleft()
        ends = [since for since, _ in self._acting][1:]
        for (since, u), end in zip(self._acting, [*ends, until], strict=False):
            seconds = (end - max(since, now)) / SECOND
            if seconds > 0:
                poses = _ahead(self.problem, poses, u, seconds)
        return poses


def _ahead(problem: Problem, poses: Poses, u: float | None, seconds: float) -> Poses:
    """Return the poses after a time [s] under a direction u [rad], or without a field.

    Without a field, robots follow their own headings and so do not turn.
    """
    towards = poses.heading if u is None else np.array(u)
    return Poses(
        *exact(poses.x, poses.y, poses.heading, towards, problem.a, problem.speed, seconds)
    )


def _sum(problem: Problem, poses: Floats) -> float:
    """Return V, the sum of the distances to the targets, for poses (N, 3) [length unit]."""
    return float(np.hypot(*(poses[:, :2] - problem.targets).T).sum())
