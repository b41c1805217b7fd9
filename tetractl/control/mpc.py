"""Model predictive control, Algorithm 2: choose the horizon, exert the first signal, warm start."""

from collections.abc import Iterable

import numpy as np

from tetractl.control.cost import Problem, evaluate, predict
from tetractl.control.draws import mix
from tetractl.control.plan import Outcome, Plan, Search
from tetractl.control.pso import Searcher, pso
from tetractl.model.state import Floats, Observation
from tetractl.spec.experiment import Experiment


class PsoMpc:
    """The controller of one trial; `key` is the root of all its random draws."""

    def __init__(self, experiment: Experiment, key: int, search: Searcher = pso) -> None:
        self.experiment = experiment
        self.key = key
        self.search = search
        self.k = 0
        self.warm: Floats | None = None  # u_(warm), None before step 0

    def plan(self, observation: Observation) -> Plan | Outcome:
        """Do one control step: decide u_(opt), or that the trial is over."""
        control = self.experiment.controller
        problem = Problem.of(self.experiment, observation.poses)
        if self._arrived(problem):  # Algorithm 2, line 13
            return Outcome.ARRIVED
        if self.k > control.steps_max:  # line 9
            return Outcome.STEPS_MAX
        if self.warm is not None and len(self.warm) == 0:
            return Outcome.SEQUENCE_USED_UP
        step_key = mix(self.key, self.k)
        plan = self._decide(problem, step_key)
        self.warm = plan.signals[1:]  # lines 6 and 24
        self.k += 1
        return plan

    def _arrived(self, problem: Problem) -> bool:
        gaps = np.hypot(*(problem.poses.xy - problem.targets).T)
        return bool(np.all(gaps <= self.experiment.controller.arrival_tolerance))

    def _decide(self, problem: Problem, step_key: int) -> Plan:
        """Search every horizon that is a candidate now, and take the one of least cost."""
        control = self.experiment.controller
        left = control.evaluations_max
        searches: list[Search] = []
        for length, start in self._candidates():
            if searches and left is not None and left <= control.swarm.particles:
                break
            found = self.search(problem, length, start, control.swarm, mix(step_key, length), left)
            searches.append(found)
            if left is not None:
                left -= found.evaluations
        chosen = min(range(len(searches)), key=lambda i: searches[i].cost)  # lines 5 and 23
        return make_plan(problem, searches, chosen, step_key)

    def _candidates(self) -> Iterable[tuple[int, Floats | None]]:
        """Yield (length, u_gb^0) of Algorithm 2: lines 2-4 at step 0, then lines 10-20."""
        if self.warm is None:  # Part I
            for length in range(1, self.experiment.controller.horizon_max + 1):
                yield length, None
            return
        count = len(self.warm)  # H; Part II. The paper indexes from 1
        if count > 1:
            yield count - 1, self.warm[1:]
        yield count, self.warm
        yield count + 1, np.append(self.warm, 0.0)


def make_plan(problem: Problem, searches: list[Search], chosen: int, step_key: int) -> Plan:
    """Assemble the decision from its searches, with the predicted path and the terms of (7)."""
    best = searches[chosen]
    costs = evaluate(problem, best.signals[None])
    return Plan(
        signals=best.signals,
        path=predict(problem, best.signals),
        cost=best.cost,
        target_cost=float(costs.target[0]),
        obstacle_cost=float(costs.obstacle[0]),
        searches=tuple(searches),
        chosen=chosen,
        generator=step_key,
    )
