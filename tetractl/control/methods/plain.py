"""Base classes of controllers that do not search for plans."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

from tetractl.control.estimation.estimator import StateEstimator
from tetractl.control.estimation.prior import Prior, certain_prior
from tetractl.control.methods.trial_time import TrialTime
from tetractl.control.search.rng import mix
from tetractl.core.commands import Command
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Decision, Outcome, Problem
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup
from tetractl.spec.controller import ControllerSection


class PlainSection(ControllerSection):
    """Base class of the fields in a spec for a controller that does not search for plans.

    Such a controller knows the robots' motion exactly, and predicts it over the dead time.
    """

    model_monitor: ClassVar[str] = ""

    def problem(self, setup: Setup) -> Problem:
        """Return the problem used to compute the logged cost, for robots at their starts.

        It predicts the exact motion. Touching an obstacle costs nothing.
        """
        return Problem(
            poses=setup.starts,
            targets=setup.targets,
            a=setup.a,
            speed=setup.speed,
            motion="exact",
            period=self.period,
            first_period=self.period,
            obstacles=Obstacles.from_shapes(setup.obstacles),
            obstacle_weight=0.0,
            swept=False,
        )

    def known(self, setup: Setup) -> Prior:
        """Return a prior without uncertainty: the motion is assumed to be exactly the spec's."""
        return certain_prior(self.problem(setup), self.dead_time)


class PlainController:
    """Base class of a controller that does not search for plans, in one trial.

    The class counts the control steps, k, and estimates the robots' poses. Derive from it, and
    implement `decided`.

    Args:
        section: The fields of the controller in the spec.
        setup: The constants of the experiment.
        key: Seed of all random numbers.
    """

    def __init__(self, section: PlainSection, setup: Setup, key: int) -> None:
        self.key = key
        self.k = 0
        self._section = section
        self.problem = section.problem(setup)
        self._known = section.known(setup)
        self._time = TrialTime(section.time_limit, section.period)

    @cached_property
    def estimator(self) -> StateEstimator:
        """The predictor of the robots' poses at the moment when the next direction acts."""
        return StateEstimator(self.problem, self._section.period, self._known)

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Decide what the robots do in one step, or end the trial; see `Controller.plan`."""
        problem = self.step(observation, last_command)
        if isinstance(problem, Outcome):
            return problem
        decision = self.decided(problem, observation, mix(self.key, self.k))
        self.k += 1
        return decision

    def step(self, observation: Observation, last_command: Command | None) -> Problem | Outcome:
        """Predict the problem of one step, or return the outcome if the trial is over.

        The problem has the poses at which the next direction acts. `open_trial` uses it, and lets
        the script decide what to send.
        """
        self._time.add_step(observation, last_command)
        problem = self.predicted(observation, last_command)
        if self._section.arrived(problem.poses.distances(problem.targets)):
            return Outcome.ARRIVED
        if self._time.is_over:
            return Outcome.TIME_LIMIT
        return problem

    def predicted(self, observation: Observation, last_command: Command | None) -> Problem:
        """Return the problem with the poses that robots have when the next direction acts."""
        return self.estimator.add_step(observation, last_command)

    @abstractmethod
    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Decision:
        """Decide what to send in step k.

        Args:
            problem: The problem, with the poses at which the next direction acts.
            observation: The newest camera frame.
            step_key: Seed of the step's random numbers.
        """
