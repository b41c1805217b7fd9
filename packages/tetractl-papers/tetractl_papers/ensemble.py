"""Feedback Ensemble Control: a controller whose field alternately rotates and is off.

This is the earlier method that section I of the paper by Ou and others describes.

While the field rotates, the robots follow it, each with a lag that depends on its turning rate a.
When their headings are such that the control Lyapunov function

    V = sum_i || s_i - tar_i ||

would fall without a field, the field is switched off, and the robots drive straight until V would
rise. The paper gives no parameters for this earlier algorithm of its authors; the defaults are
tetractl's choice. Obstacles are ignored.
"""

from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from tetractl.control.methods.fixed_sequence import given_search, make_plan
from tetractl.control.methods.plain import PlainController, PlainSection
from tetractl.control.search.cost import predict, prediction_from_path
from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff
from tetractl.core.plan import Outcome, Plan, Problem
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.setup import Setup
from tetractl.model.motion.exact import step as exact_step
from tetractl.spec.base import Fraction, Positive
from tetractl.spec.controller import ALONE, Host


class EnsembleSection(PlainSection):
    """Feedback Ensemble Control: a controller whose field alternately rotates and is off.

    The field rotates until the sum of distances to the targets would fall without a field. Then the
    field is off as long as the sum falls. The controller ignores obstacles and works in simulations
    only.
    """

    switches_field: ClassVar[bool] = True
    type: Literal["ensemble"]
    rate: Positive = 1.3
    """Angular velocity of the rotating field, in units of the robots' lowest turning rate. Up to 1,
    every robot follows with a constant lag. Above 1, the robot with the lowest turning rate cannot
    follow.
    """
    fall: Fraction = 0.3
    """The field is switched off if the sum of distances would fall by more than this fraction of
    the largest possible fall in the coming control period. The largest possible fall is the sum of
    the robots' path lengths.
    """
    turns: float = Field(default=3.0, gt=0, le=1000, allow_inf_nan=False)
    """The trial ends if the field has made this number of turns without being switched off, and the
    next step would not reduce the sum of distances.
    """

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "Ensemble":
        """Create the controller of one trial; see `ControllerSection.build`."""
        return Ensemble(self, setup, key)


class HeldDirection(NamedTuple):
    """A direction of the field, or no field, that acts from a given time.

    Attributes:
        since_ns: When the direction starts to act [ns].
        direction: Direction of the field [rad]. None for no field.
    """

    since_ns: int
    direction: float | None


class Ensemble(PlainController):
    """The controller of one trial of Feedback Ensemble Control.

    At each step, it compares two values of the Lyapunov function V: V after driving without a field
    for one control period, and V now minus a threshold (`fall`).

    It needs no random numbers. `key` is only used for the log.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Only logged, because nothing is random.
    """

    def __init__(self, section: EnsembleSection, setup: Setup, key: int) -> None:
        super().__init__(section, setup, key)
        self.section = section
        self._dead_time_ns = round(section.dead_time * SECOND)
        self._held_directions: list[HeldDirection] = []
        """The decisions that act now or will act later, oldest first."""
        self._field_rad: float | None = None
        """The direction of the rotating field [rad]. None while it is off."""
        self._turned_rad = 0.0
        """Angle by which the field has turned since it was switched on [rad]."""

    def predicted(self, observation: Observation, last_command: Command | None) -> Problem:
        """Predict the poses for the time at which the next decision acts, and return the problem.

        That time is one dead time after the exposure of the frame.
        """
        now_ns = observation.sampled_ns
        while len(self._held_directions) > 1 and self._held_directions[1].since_ns <= now_ns:
            self._held_directions.pop(0)  # a later decision has replaced this one
        acts_ns = now_ns + self._dead_time_ns
        ends_ns = [held.since_ns for held in self._held_directions[1:]] + [acts_ns]
        poses = observation.poses
        for held, end_ns in zip(self._held_directions, ends_ns, strict=False):
            duration_s = (end_ns - max(held.since_ns, now_ns)) / SECOND
            if duration_s > 0:
                poses = predict_poses(self.problem, poses, held.direction, duration_s)
        return replace(self.problem, poses=poses)

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Plan | Outcome:
        """Rotate the field, switch it off, or end the trial; see `PlainController.decided`.

        The field is off while that lowers the sum of the distances enough. The outcome is
        NO_BETTER_PLAN if `turns` rotations of the field have not lowered it.
        """
        section = self.section
        distance_sum = problem.poses.distances(problem.targets).sum()  # the Lyapunov function V
        straight_poses = predict_poses(problem, problem.poses, None, section.period)
        expected_fall = distance_sum - straight_poses.distances(problem.targets).sum()
        stays_off = self._field_rad is None and self.k > 0  # the field stays off until V would rise
        fall_max = problem.speed.sum() * section.period
        fall_min = 0.0 if stays_off else section.fall * fall_max
        if expected_fall > fall_min:
            self._field_rad = None
            self._turned_rad = 0.0
            signals = np.zeros(1)
            end_poses = straight_poses
        else:
            self._rotate(problem)
            signals = np.array([self._field_rad])
            end_poses = Poses.from_array(predict(problem, signals)[-1])
            has_turned_enough = self._turned_rad > 2 * np.pi * section.turns
            if has_turned_enough and end_poses.distances(problem.targets).sum() >= distance_sum:
                return Outcome.NO_BETTER_PLAN
        self._held_directions.append(
            HeldDirection(observation.sampled_ns + self._dead_time_ns, self._field_rad)
        )
        return self._create_plan(problem, signals, end_poses, step_key)

    def _rotate(self, problem: Problem) -> None:
        """Rotate the field anticlockwise by one step. If it was off, start at the mean heading.

        The direction stays within -pi to pi.
        """
        if self._field_rad is None:
            heading = problem.poses.heading
            east = elementwise.cos(heading).sum()
            north = elementwise.sin(heading).sum()
            self._field_rad = float(elementwise.atan2(north, east))
        step_rad = self.section.rate * float(problem.a.min()) * self.section.period
        self._field_rad = float(np.remainder(self._field_rad + step_rad + np.pi, 2 * np.pi) - np.pi)
        self._turned_rad += step_rad

    def _create_plan(
        self, problem: Problem, signals: Floats, end_poses: Poses, step_key: int
    ) -> Plan:
        """Create the plan of one control period that ends at the poses `end_poses`.

        If the field is off, the action of the plan is FieldOff, and `signals` are ignored.
        """
        path = np.stack([problem.poses.array(), end_poses.array()])
        foreseen = prediction_from_path(problem, path)
        search = given_search(problem, signals, foreseen)
        plan = make_plan([search], 0, step_key, foreseen)
        return replace(plan, instead=FieldOff() if self._field_rad is None else None)


def predict_poses(
    problem: Problem, poses: Poses, direction: float | None, duration_s: float
) -> Poses:
    """Predict the poses of robots after they have driven under a constant field or without a field.

    Without a field, robots drive straight on.

    Args:
        problem: The robots' parameters.
        poses: Poses at the start.
        direction: Direction of the field [rad]. None for no field.
        duration_s: How long they drive [s].
    """
    direction_or_heading = poses.heading if direction is None else np.array(direction)
    x, y, heading = exact_step(
        poses.x, poses.y, poses.heading, direction_or_heading, problem.a, problem.speed, duration_s
    )
    return Poses(x, y, heading)
