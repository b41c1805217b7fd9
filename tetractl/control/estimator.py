"""Turning rate a and speed v of each robot, estimated while it moves.

One scalar Kalman filter a robot and parameter, started at the spec's value with a standard
deviation of PRIOR of it. Between two observations t apart,

    speed:  |displacement| = v t sinc(dheading/2) for a steady turn, whatever the direction was;
    a:      the heading predicted by the model from the directions sent, against the one measured.

A heading that differs by more than OUTLIER rad is left out: a command was lost, a is not wrong.
"""

from dataclasses import replace

import numpy as np

from tetractl.control.delay import Held, advance
from tetractl.core.clock import SECOND
from tetractl.core.plan import Estimate
from tetractl.core.poses import Bools, Floats, Observation, wrap
from tetractl.core.problem import Problem

PRIOR = 0.15  # relative standard deviation of a and v before anything is seen
HEADING_STD = 0.02  # of a measured heading [rad] ...
HEADING_WALK = 0.1  # ... and of its random walk [rad/sqrt(s)]
POSITION_STD = 0.01  # of a measured displacement, in seconds of travel [s]
OUTLIER = 0.35  # rad
STEP = 1e-4  # relative, of the numerical derivative by a


class Estimator:
    """Refines the a and speed of a problem, observation by observation."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._var_a = (PRIOR * problem.a) ** 2
        self._var_v = (PRIOR * problem.speed) ** 2
        self._last: Observation | None = None

    @property
    def estimate(self) -> Estimate:
        """The a and speed as known, with the standard deviations of their filters."""
        return Estimate(
            a=self.problem.a,
            a_std=np.sqrt(self._var_a),
            speed=self.problem.speed,
            speed_std=np.sqrt(self._var_v),
        )

    def update(self, observation: Observation, held: list[Held]) -> Problem:
        """Return the problem with a and speed as known after an observation.

        `held` are the directions that acted since the observation before.
        """
        last, self._last = self._last, observation
        if last is None or observation.sampled_ns <= last.sampled_ns:
            return self.problem
        t = (observation.sampled_ns - last.sampled_ns) / SECOND
        moving = sum(until - since for since, until, _ in held) / SECOND >= 0.999 * t
        if moving:
            usable = last.valid & observation.valid
            turned = wrap(observation.poses.heading - last.poses.heading)
            self._update_speed(last, observation, turned, t, usable)
            self._update_a(last, turned, t, held, usable)
        return self.problem

    def _update_speed(
        self, last: Observation, new: Observation, turned: Floats, t: float, usable: Bools
    ) -> None:
        displacement = np.hypot(new.poses.x - last.poses.x, new.poses.y - last.poses.y)
        by_speed = t * np.sinc(turned / (2 * np.pi))  # its derivative by the speed
        speed = self.problem.speed
        noise = (POSITION_STD * speed) ** 2 + 1e-300
        gain = self._var_v * by_speed / (by_speed**2 * self._var_v + noise)
        gain = np.where(usable & (np.abs(turned) < np.pi / 2), gain, 0.0)
        self._var_v = self._var_v * (1 - gain * by_speed)
        corrected = np.maximum(speed + gain * (displacement - by_speed * speed), 0.0)
        self.problem = replace(self.problem, speed=corrected)

    def _update_a(
        self, last: Observation, turned: Floats, t: float, held: list[Held], usable: Bools
    ) -> None:
        a = self.problem.a
        predicted = advance(self.problem, last.poses, held).heading - last.poses.heading
        nudged = replace(self.problem, a=a * (1 + STEP))
        more = advance(nudged, last.poses, held).heading - last.poses.heading
        by_a = (more - predicted) / (STEP * a)  # derivative of the turn by a
        miss = wrap(turned - predicted)
        noise = 2 * HEADING_STD**2 + HEADING_WALK**2 * t
        gain = self._var_a * by_a / (by_a**2 * self._var_a + noise)
        gain = np.where(usable & (np.abs(miss) < OUTLIER), gain, 0.0)
        self._var_a = self._var_a * (1 - gain * by_a)
        self.problem = replace(self.problem, a=np.clip(a + gain * miss, 0.2 * a, 5 * a))
