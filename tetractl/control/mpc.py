"""Model predictive control, Algorithm 2: choose the horizon, exert the first signal, warm start.

Beside the letter: the plan's grid may be coarser than the control's (`hold`), the state may be
predicted over the dead time, and an optimiser with a tolerance may take costs within it as equal.
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from tetractl.control.cost import Problem, costs_along, predict
from tetractl.control.delay import Predictor
from tetractl.control.estimator import Estimator
from tetractl.control.optimizers.pso import Searcher, never, pso
from tetractl.control.rng import mix
from tetractl.core.clock import SECOND
from tetractl.core.plan import Outcome, Plan, Search
from tetractl.core.poses import Floats, Observation
from tetractl.experiment.controller import MultistartSpec
from tetractl.experiment.experiment import Experiment

SHARE = 4
Candidate = tuple[int, Floats | None]
"""A length to try, and the u_gb^0 to start from."""


class PsoMpc:
    """The controller of one trial; `key` is the root of all its random draws.

    `timer` [ns] is only looked at where the spec sets a deadline.
    """

    def __init__(
        self,
        experiment: Experiment,
        key: int,
        search: Searcher = pso,
        timer: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.control = experiment.controller
        self.problem = Problem.of(experiment)
        self.predictor = Predictor(self.control.dead_time)
        self.estimator = Estimator(self.problem) if self.control.estimate else None
        self.last_ns = 0  # when the frame before was exposed
        self.key = key
        self.search = search
        self.timer = timer
        self.k = 0
        self.warm: Floats | None = None  # u_(warm), None before step 0

    def plan(self, observation: Observation) -> Plan | Outcome:
        """Do one control step: decide u_(opt), or that the trial is over."""
        phase = self.k % self.control.hold  # control periods since the last knot of the plan
        if self.warm is not None and phase == 0:
            self.warm = self.warm[1:]  # lines 6 and 24
        problem = self._problem(observation, (self.control.hold - phase) * self.control.period)
        if self._arrived(problem):  # Algorithm 2, line 13
            return Outcome.ARRIVED
        if self.k > self.control.steps_max:  # line 9
            return Outcome.STEPS_MAX
        if self.warm is not None and len(self.warm) == 0:
            return Outcome.SEQUENCE_USED_UP
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
        tolerance = self.control.arrival_tolerance
        return tolerance > 0 and bool(np.all(gaps <= tolerance))

    def _decide(self, problem: Problem, step_key: int) -> Plan:
        """Search every horizon that is a candidate now, and choose.

        A budget of evaluations is shared equally. Where it is too small for all horizons of step 0,
        fewer are tried, evenly spread, so that each gets some SHARE swarms' worth.
        """
        candidates, left, expired = list(self._candidates()), self.control.evaluations_max, never
        least = self.control.swarm.particles + 1  # evaluations below which no search is worth it
        if left is not None:
            candidates = self._affordable(candidates, left // least)
        if self.control.deadline is not None and self.warm is not None:
            end = self.timer() + round(self.control.deadline * SECOND)
            expired = lambda: self.timer() >= end  # noqa: E731
        searches: list[Search] = []
        for i, (length, start) in enumerate(candidates):
            share = None if left is None else left // (len(candidates) - i)
            if searches and (expired() or (share is not None and share < least)):
                break
            key = mix(step_key, length)
            found = self.search(problem, length, start, self.control.swarm, key, share, expired)
            searches.append(found)
            if left is not None:
                left -= found.evaluations
        return make_plan(problem, searches, self._choose(searches), step_key)

    def _affordable(self, candidates: list[Candidate], searches: int) -> list[Candidate]:
        """Thin the candidates out: evenly at step 0, and to the plan as it is (H) after it."""
        if self.warm is None:
            stride = math.ceil(len(candidates) / max(1, searches // SHARE))
            return candidates[::-stride][::-1]
        count = len(self.warm)
        kept = sorted(candidates, key=lambda one: abs(one[0] - count))[: max(1, searches)]
        return sorted(kept, key=lambda one: one[0])

    def _candidates(self) -> Iterable[Candidate]:
        """Yield (length, u_gb^0) of Algorithm 2: lines 2-4 at step 0, then lines 10-20."""
        if self.warm is None:  # Part I
            for length in range(1, self.control.horizon_max + 1):
                yield length, None
            return
        count = len(self.warm)  # H; Part II. The paper indexes from 1
        if count > 1:
            yield count - 1, self.warm[1:]
        yield count, self.warm
        yield count + 1, np.append(self.warm, 0.0)

    def _choose(self, searches: list[Search]) -> int:
        """Return the index of the least cost, lines 5 and 23.

        Costs within the tolerance of a `multistart` are equal, and among equals the plan goes on as
        it is (H); at step 0 the shortest is taken.
        """
        if isinstance(self.control.swarm, MultistartSpec):
            good = [i for i, s in enumerate(searches) if s.cost <= self.control.swarm.tolerance]
            if good:
                going_on = 0 if self.warm is None else len(self.warm)
                return min(good, key=lambda i: abs(searches[i].length - going_on))
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
