"""A controller that sends a given sequence of directions, open loop."""

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import evaluate
from tetractl.control.estimator import StateEstimator
from tetractl.control.filter import warm_up
from tetractl.control.fixed_sequence import given_search, make_plan, plain_problem
from tetractl.control.prior import nothing
from tetractl.control.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.plan import End, Outcome, Plan, Problem
from tetractl.core.poses import Observation
from tetractl.core.protocols import Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.base import Finite, NonNegative
from tetractl.experiment.controller import ControllerSection, OptimizerSection, same
from tetractl.model.obstacles import Obstacles

AHEAD = 50  # number of signals for which each step predicts the path


class SequenceSection(ControllerSection):
    """A given sequence of directions, one per control step, without a search."""

    type: Literal["sequence"] = "sequence"
    directions: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=100_000)]
    """The direction of each control step [rad]; the robots are stopped after the last one."""
    remainder: NonNegative = 0.0
    """Time for which the last direction is held in addition to one control period [s]."""

    def bounds(self) -> dict[str, str]:
        """Return the number of directions, for display: {name: text}."""
        return {"directions": f"{len(self.directions)}"}

    def problem(self, setup: Setup) -> Problem:
        """Return the problem used to compute the logged cost, for robots at their starts."""
        return plain_problem(setup, self.period, Obstacles.of(setup.obstacles))

    def build(
        self,
        setup: Setup,
        key: int,
        wrap: Callable[[OptimizerSection], Optimizer] = same,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> "SequenceController":
        """Return the controller of one trial."""
        return SequenceController(self, setup, key)

    def warm_up(self, setup: Setup) -> None:
        """Compile the cost and the prediction over the dead time by using each once."""
        problem = self.problem(setup)
        evaluate(problem, np.zeros((1, 1)))
        warm_up(nothing(problem, self.dead_time), setup.starts)


class SequenceController:
    """The controller of one trial. No random numbers are drawn; `key` is only used for the log."""

    def __init__(self, section: SequenceSection, setup: Setup, key: int) -> None:
        self.section, self._key = section, key
        problem = section.problem(setup)
        self._estimator = StateEstimator(
            problem, section.period, nothing(problem, section.dead_time)
        )
        self._k = 0

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Return the plan of the next direction, with the path predicted for up to AHEAD
        directions.
        """
        problem, section = self._estimator.seen(observation, last_command), self.section
        gaps = problem.poses.distances(problem.targets)
        if section.arrived(gaps):
            return Outcome.ARRIVED
        if self._k > section.steps_max:
            return Outcome.STEPS_MAX
        if self._k == len(section.directions):
            delay_ns = round(section.remainder * SECOND)
            done = Outcome.SEQUENCE_COMPLETED
            return End(done, delay_ns) if delay_ns else done
        signals = np.array(section.directions[self._k : self._k + AHEAD])
        step_key = mix(self._key, self._k)
        self._k += 1
        return make_plan(problem, [given_search(problem, signals)], 0, step_key)
