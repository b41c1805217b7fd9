"""What the controllers without a search share: the problem whose cost is logged, and a step."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from tetractl.control.estimation.prior import Prior, nothing
from tetractl.control.methods.trial_time import TrialTime
from tetractl.control.search.rng import mix
from tetractl.core.commands import Command
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Decision, Outcome, Problem
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup
from tetractl.spec.controller import ControllerSection

if TYPE_CHECKING:  # a spec is read without the filter
    from tetractl.control.estimation.estimator import StateEstimator


class PlainSection(ControllerSection):
    """A controller that knows the robots' motion, and predicts them over the dead time."""

    def problem(self, setup: Setup) -> Problem:
        """Return the problem used to compute the logged cost, for robots at their starts, predicted
        by the exact motion; touching an obstacle costs nothing."""
        return Problem(
            poses=setup.starts,
            targets=setup.targets,
            a=setup.a,
            speed=setup.speed,
            motion="exact",
            period=self.period,
            first_period=self.period,
            obstacles=Obstacles.of(setup.obstacles),
            obstacle_weight=0.0,
            swept=False,
        )

    def known(self, setup: Setup) -> Prior:
        """Return what is assumed of the robots' motion: nothing is uncertain."""
        return nothing(self.problem(setup), self.dead_time)

    def warm_up(self, setup: Setup) -> None:
        """Compile the prediction over the dead time by using it once."""
        from tetractl.control.estimation.filter import warm_up

        warm_up(self.known(setup), setup.starts)


class PlainController:
    """The controller of one trial: its number of the step, k, and its estimator; `key` seeds all
    its random numbers."""

    def __init__(self, section: PlainSection, setup: Setup, key: int) -> None:
        self.key = key
        self.k = 0
        self._ends = section
        self.problem = section.problem(setup)
        self._known = section.known(setup)
        self._time = TrialTime(section.time_limit, section.period)

    @cached_property
    def estimator(self) -> "StateEstimator":
        """The robots' poses at the moment when the next direction acts."""
        from tetractl.control.estimation.estimator import StateEstimator

        return StateEstimator(self.problem, self._ends.period, self._known)

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Decide what the robots do in one step, or end the trial."""
        problem = self.step(observation, last_command)
        if isinstance(problem, Outcome):
            return problem
        decision = self.decided(problem, observation, mix(self.key, self.k))
        self.k += 1
        return decision

    def step(self, observation: Observation, last_command: Command | None) -> Problem | Outcome:
        """Return the problem of one step, with the poses at which the next direction acts, or the
        outcome if the trial is over; `open_trial` decides by itself what is sent."""
        self._time.add_step(observation, last_command)
        problem = self.predicted(observation, last_command)
        if self._ends.arrived(problem.poses.distances(problem.targets)):
            return Outcome.ARRIVED
        if self._time.over:
            return Outcome.TIME_LIMIT
        return problem

    def predicted(self, observation: Observation, last_command: Command | None) -> Problem:
        """Return the problem with the poses at which the next direction acts."""
        return self.estimator.add_step(observation, last_command)

    @abstractmethod
    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Decision:
        """Return the decision of step k, whose random numbers `step_key` seeds."""
