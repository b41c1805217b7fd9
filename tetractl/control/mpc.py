"""Model predictive control, Algorithm 2: choose the horizon, exert the first signal, warm start.

Where each line of Algorithm 2 is:

    2-4     for h = 1 ... h_max: u_(h) = pso(NULL)                        _candidates, _decide
    5, 23   u_(opt) = the u_(h) of the least J                            _choose
    6, 24   u_(warm) = u_(opt) without its first signal                   plan, at the next step
    7, 25   exert u_(opt)(1)                                              run.trial, from plan
    9, 26   for k = 1 ... k_max                                           plan, by run.trial
    10      H = length of u_(warm)                                        _candidates
    11, 22  for h = H - 1, H, H + 1                                       _candidates, _decide
    12      feedback of the robots, once a step                           plan, _problem
    13-15   break if the robots are close enough to their targets         _arrived
    16-17   u_gb^0 = u_(warm) and a 0, for h = H + 1                      _candidates
    18-20   u_gb^0 = the last h signals of u_(warm), for the others       _candidates
    21      u_(h) = pso(u_gb^0), by any optimiser                         _decide

Beyond Algorithm 2: the plan's grid may be coarser than the control's (`hold`), the state may be
predicted over the dead time, a and speed may be estimated, an optimiser may count costs as equally
good, and the searches of a step may be limited.
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from tetractl.control.cost import costs_along, predict
from tetractl.control.delay import Predictor
from tetractl.control.estimator import Estimator
from tetractl.control.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.plan import Limits, Outcome, Plan, Search, never
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.problem import Problem
from tetractl.core.protocols import Optimizer
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative, inconsistent
from tetractl.experiment.choice import Choice, OneOf
from tetractl.experiment.controller import ControllerSection, OptimizerSection, same
from tetractl.experiment.kinds import MOTIONS, OPTIMIZERS
from tetractl.model.obstacles import Obstacles

WORTHWHILE = 4
"""How many times the least evaluations of a search each horizon of step 0 gets under a limit."""
Candidate = tuple[int, Floats | None]
"""A length to try, and the u_gb^0 to start from."""

_OPTIMIZER = Choice(OPTIMIZERS, default="pso")


class Collision(Model):
    """How the planner's potential (13) decides that a robot is inside an obstacle."""

    check: Literal["samples", "swept"] = "samples"
    """`samples` tests the predicted positions as (13) is printed; `swept` tests the whole segment
    between two of them."""
    margin: NonNegative = 0.0
    """Obstacles are grown by this much for the planner [length unit]."""
    walls: bool = False
    """Whether leaving the arena counts as entering an obstacle."""


class MpcSection(ControllerSection):
    """Model predictive control, Algorithm 2, with any optimiser; the paper's is PSO."""

    type: Literal["mpc"] = "mpc"
    hold: PositiveInt = 1
    """Control periods for which each signal of a sequence is meant to be held: the plan's grid is
    `hold` times coarser than the control's, and a signal under way can still be changed."""
    motion: Annotated[str, OneOf(MOTIONS)] = "euler"
    """Prediction: `euler` is (4)-(6); `arc` holds the wheel speeds of (24)-(25) over a period;
    `exact` is the closed form of (1)-(3) under a held direction."""
    estimate: bool = False
    """Whether a and speed of each robot are estimated while it moves, starting from the spec's.
    The estimate trusts `dead_time`: where that is far off, it learns a wrong a."""
    horizon_max: int = Field(default=51, ge=1, le=2000)
    """Longest sequence tried at step 0, in signals. A sequence of `length` signals is the paper's
    horizon h = length - 1."""
    obstacle_weight: NonNegative = 1000.0
    """Weight omega_p of the obstacle potential in (7) [length unit]."""
    collision: Collision = Collision()
    """How the planner tells that a robot is inside an obstacle."""
    evaluations_max: int | None = Field(default=None, ge=1)
    """Cost evaluations one control step may spend, shared equally by its horizons; then the best
    sequence so far is used. No limit by default."""
    optimizer: Annotated[OptimizerSection, _OPTIMIZER] = Field(default_factory=_OPTIMIZER.make)
    """The optimiser of each search."""

    @model_validator(mode="after")
    def _a_limit_pays_for_a_search(self) -> Self:
        least = self.optimizer.evaluations_min
        if self.evaluations_max is not None and self.evaluations_max < least:
            message = f"must be at least {least}, the least of a search by this optimiser"
            raise inconsistent("evaluations_max", message)
        return self

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search."""
        return self.optimizer.iterations_max

    def bounds(self) -> dict[str, str]:
        """Return the horizons of step 0 and the evaluations of a search."""
        found = {"horizons at step 0": f"1 ... {self.horizon_max} signals"}
        if most := self.optimizer.evaluations_max:
            found["cost evaluations of a horizon"] = f"at most {most}"
        return found

    def problem(self, setup: Setup, poses: Poses | None = None) -> Problem:
        """Return the problem with the robots at `poses`, or at their starts."""
        walls = setup.arena if self.collision.walls else None
        return Problem(
            poses=setup.starts if poses is None else poses,
            targets=setup.targets,
            a=setup.a,
            speed=setup.speed,
            motion=self.motion,
            period=self.hold * self.period,
            first_period=self.hold * self.period,
            obstacles=Obstacles.of(setup.obstacles, self.collision.margin, walls),
            obstacle_weight=self.obstacle_weight,
            swept=self.collision.check == "swept",
        )

    def build(
        self,
        setup: Setup,
        key: int,
        wrap: Callable[[OptimizerSection], Optimizer] = same,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> "Mpc":
        """Return the controller of one trial."""
        return Mpc(self, setup, key, wrap(self.optimizer), timer)

    def warm_up(self, setup: Setup) -> None:
        """Search one signal for the robots at their starts."""
        self.optimizer.search(self.problem(setup), 1, np.zeros(1), 0, Limits())


class Mpc:
    """The controller of one trial; `key` is the root of all its random draws.

    `timer` [ns] is only looked at where the section sets a deadline.
    """

    def __init__(
        self,
        section: MpcSection,
        setup: Setup,
        key: int,
        optimizer: Optimizer,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.section = section
        self.problem = section.problem(setup)
        self.predictor = Predictor(section.dead_time)
        self.estimator = Estimator(self.problem) if section.estimate else None
        self.last_ns = 0  # when the frame before was exposed
        self.key = key
        self.optimizer = optimizer
        self.timer = timer
        self.k = 0
        self.warm: Floats | None = None  # u_(warm), None before step 0

    def plan(self, observation: Observation) -> Plan | Outcome:
        """Do one control step: decide u_(opt), or that the trial is over."""
        phase = self.k % self.section.hold  # control periods since the last knot of the plan
        if self.warm is not None and phase == 0:
            self.warm = self.warm[1:]  # lines 6, 24
        problem = self._problem(observation, (self.section.hold - phase) * self.section.period)
        if self._arrived(problem):  # lines 13-15
            return Outcome.ARRIVED
        if self.k > self.section.steps_max:  # line 9
            return Outcome.STEPS_MAX
        if self.warm is not None and len(self.warm) == 0:
            return Outcome.SEQUENCE_COMPLETED
        plan = self._decide(problem, mix(self.key, self.k))
        self.predictor.sent(observation.sampled_ns, float(plan.signals[0]))
        self.warm = plan.signals
        self.k += 1
        return plan

    def _problem(self, observation: Observation, first_period: float) -> Problem:
        """Pose the problem where a direction decided now will act, for the robots as known."""
        now, problem = observation.sampled_ns, self.problem
        if self.estimator:
            held = self.predictor.held(self.last_ns, now)
            problem = self.estimator.update(observation, held)
        self.predictor.forget(now)
        self.last_ns = now
        problem = replace(problem, poses=observation.poses, first_period=first_period)
        return replace(problem, poses=self.predictor.ahead(problem, now))

    def _arrived(self, problem: Problem) -> bool:
        gaps = problem.poses.distances(problem.targets)
        tolerance = self.section.arrival_tolerance
        return tolerance > 0 and bool(np.all(gaps <= tolerance))

    def _decide(self, problem: Problem, step_key: int) -> Plan:
        """Search every horizon that is a candidate now, and choose.

        A limit of evaluations is shared equally. Where it is too small for all horizons of step 0,
        fewer are tried, evenly spread, each with WORTHWHILE times the least of a search.
        """
        candidates, left = list(self._candidates()), self.section.evaluations_max
        least = self.section.optimizer.evaluations_min
        if left is not None:
            candidates = self._affordable(candidates, left // least)
        expired = never
        if self.section.deadline is not None and self.warm is not None:
            end = self.timer() + round(self.section.deadline * SECOND)
            expired = lambda: self.timer() >= end  # noqa: E731
        searches: list[Search] = []
        for i, (length, start) in enumerate(candidates):
            share = None if left is None else left // (len(candidates) - i)
            if searches and (expired() or (share is not None and share < least)):
                break
            limits, key = Limits(share, expired), mix(step_key, length)
            found = self.optimizer.search(problem, length, start, key, limits)  # lines 3, 21
            searches.append(found)
            if left is not None:
                left -= found.evaluations
        plan = make_plan(problem, searches, self._choose(searches), step_key)
        return replace(plan, estimate=self.estimator.estimate) if self.estimator else plan

    def _affordable(self, candidates: list[Candidate], searches: int) -> list[Candidate]:
        """Thin the candidates out: evenly at step 0, and to the plan as it is (H) after it."""
        if self.warm is None:
            stride = math.ceil(len(candidates) / max(1, searches // WORTHWHILE))
            return candidates[::-stride][::-1]
        count = len(self.warm)
        kept = sorted(candidates, key=lambda one: abs(one[0] - count))[: max(1, searches)]
        return sorted(kept, key=lambda one: one[0])

    def _candidates(self) -> Iterable[Candidate]:
        """Yield each (length, u_gb^0): lines 2-4 at step 0, then lines 10-20."""
        if self.warm is None:  # Part I
            for length in range(1, self.section.horizon_max + 1):
                yield length, None
            return
        count = len(self.warm)  # H; Part II. The paper indexes from 1
        if count > 1:
            yield count - 1, self.warm[1:]
        yield count, self.warm
        yield count + 1, np.append(self.warm, 0.0)

    def _choose(self, searches: list[Search]) -> int:
        """Return the index of the least cost, lines 5 and 23.

        Among costs that the optimiser counts as equally good, the length nearest to that of the
        plan under way (H) is chosen; at step 0 the shortest.
        """
        good_enough = self.section.optimizer.good_enough
        if good_enough is not None:
            good = [i for i, search in enumerate(searches) if search.cost <= good_enough]
            if good:
                count = 0 if self.warm is None else len(self.warm)
                return min(good, key=lambda i: abs(searches[i].length - count))
        return min(range(len(searches)), key=lambda i: searches[i].cost)


def make_plan(problem: Problem, searches: list[Search], chosen: int, step_key: int) -> Plan:
    """Assemble the decision from its searches, with the predicted path and the terms of (7)."""
    best = searches[chosen]
    path = predict(problem, best.signals)
    costs = costs_along(problem, path[:, None])
    return Plan(
        signals=best.signals,
        path=path,
        cost=best.cost,
        target_cost=float(costs.target[0]),
        obstacle_cost=float(costs.obstacle[0]),
        searches=tuple(searches),
        chosen=chosen,
        generator=step_key,
    )
