"""Particle swarm optimisation, Algorithm 1 with (14)-(20), readable beside the paper.

This is the reference: the compiled twin in `kernels` must agree with it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tetractl.control.cost import Problem, evaluate
from tetractl.control.rng import mix, uniform, uniform_pair
from tetractl.control.stop import stopped
from tetractl.core.plan import Search
from tetractl.core.poses import Floats
from tetractl.experiment.controller import SwarmSpec

LOWER, UPPER = -np.pi, np.pi  # lb and ub, (12)
SPAN = abs(UPPER - LOWER)  # |ub - lb|, (15)


def never() -> bool:
    """Return False: no deadline."""
    return False


class Searcher(Protocol):
    """Finds a sequence of `length` signals of small cost, from a warm start or from nothing.

    `spec` is the optimiser's part of the spec. `key` fixes every random draw; `budget` bounds the
    cost evaluations, None for no bound; once `expired()`, the best so far is returned.
    """

    def __call__(
        self,
        problem: Problem,
        length: int,
        warm: Floats | None,
        spec: Any,
        key: int,
        budget: int | None = None,
        expired: Callable[[], bool] = ...,
    ) -> Search:
        """Return the best sequence found and how the search went."""
        ...


@dataclass(slots=True)
class Swarm:
    """np particles in L dimensions, asked for coordinates and told their costs.

    u, v, best (np, L): coordinates u_n, velocities v_n and local bests u_lb,n; best_cost (np,):
    J(u_lb,n); u_gb (L,) with cost J(u_gb).
    """

    spec: SwarmSpec
    key: int
    u: Floats
    v: Floats
    best: Floats
    best_cost: Floats
    u_gb: Floats
    cost: float
    z: int = 0

    @classmethod
    def scatter(cls, spec: SwarmSpec, length: int, key: int) -> "Swarm":
        """Algorithm 1, line 1: draw u_n, v_n and u_lb,n uniformly in their search spaces."""
        n = spec.particles
        draws = uniform(mix(key, 0), 0, 3 * length * n).reshape(3, length, n)
        u, v, best = (np.ascontiguousarray(draw.T) for draw in draws)
        return cls(
            spec,
            mix(key, 1),
            u=LOWER + SPAN * u,
            v=-SPAN + 2 * SPAN * v,
            best=LOWER + SPAN * best,
            best_cost=np.full(n, np.inf),
            u_gb=np.zeros(length),
            cost=np.inf,
        )

    def ask(self) -> Floats:
        """Move the swarm by (14)-(17) and return the new coordinates (np, L)."""
        w, c1, c2 = self.spec.inertia, self.spec.cognitive, self.spec.social
        size, shape = self.u.size, self.u.T.shape
        r1, r2 = (r.reshape(shape).T for r in uniform_pair(self.key, self.z * size, size))
        v_new = w * self.v + c1 * r1 * (self.best - self.u) + c2 * r2 * (self.u_gb - self.u)  # (14)
        self.v = np.maximum(-SPAN, np.minimum(v_new, SPAN))  # (15)
        u_new = self.u + self.v  # (16)
        self.u = np.maximum(LOWER, np.minimum(u_new, UPPER))  # (17)
        self.z += 1
        return self.u

    def tell(self, costs: Floats) -> None:
        """Take the costs of the coordinates asked for, and update the bests by (18)-(19)."""
        better = costs < self.best_cost
        self.best[better] = self.u[better]  # (18)
        self.best_cost[better] = costs[better]
        leader = int(np.argmin(self.best_cost))
        if self.best_cost[leader] < self.cost:  # (19)
            self.u_gb, self.cost = self.best[leader].copy(), float(self.best_cost[leader])


def pso(
    problem: Problem,
    length: int,
    warm: Floats | None,
    spec: SwarmSpec,
    key: int,
    budget: int | None = None,
    expired: Callable[[], bool] = never,
) -> Search:
    """Algorithm 1, pso(u_gb^0): search sequences of `length` signals, from `warm` or from NULL."""
    swarm = Swarm.scatter(spec, length, key)  # line 1
    swarm.best_cost = evaluate(problem, swarm.best).total
    evaluations = spec.particles
    if warm is None:  # lines 2-3
        leader = int(np.argmin(swarm.best_cost))
        swarm.u_gb, swarm.cost = swarm.best[leader].copy(), float(swarm.best_cost[leader])
    else:  # lines 4-5: taken without comparing it with the swarm; (19) then compares
        swarm.u_gb, swarm.cost = warm.copy(), float(evaluate(problem, warm[None]).total[0])
        evaluations += 1
    history = [swarm.cost]
    reason = "iterations"
    for _ in range(spec.iterations):  # line 7
        if budget is not None and evaluations + spec.particles > budget:
            reason = "evaluations"
            break
        if expired():
            reason = "deadline"
            break
        swarm.tell(evaluate(problem, swarm.ask()).total)  # line 8
        evaluations += spec.particles
        history.append(swarm.cost)
        if why := stopped(np.array(history), spec.stop):  # line 9
            reason = why
            break
    return Search(length, swarm.u_gb, swarm.cost, np.array(history), evaluations, reason)
