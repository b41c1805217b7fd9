"""Particle swarm optimisation: a readable version of the paper's Algorithm 1, equations (14)-(20).

`pso` is the reference. `Pso.search` runs its compiled twin, `compiled_pso`, which must agree with
it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.control.cost import evaluate
from tetractl.control.rng import mix, uniform, uniform_pair
from tetractl.control.stop import PaperStop, StopCriterion, stopped
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.experiment.controller import OptimizerSection

LOWER, UPPER = -np.pi, np.pi  # lb and ub, (12)
SPAN = abs(UPPER - LOWER)  # |ub - lb|, (15)


class PsoFields(OptimizerSection):
    """Fields of the particle swarm of the paper's Algorithm 1, equations (14)-(19)."""

    type: Literal["pso"] = "pso"
    particles: int = Field(default=100, ge=1, le=1_000_000)
    """Number of particles np."""
    iterations: int = Field(default=100, ge=1, le=1_000_000)
    """Largest number of iterations z_max of one search (one horizon)."""
    inertia: float = Field(default=0.7, gt=0, le=2, allow_inf_nan=False)
    """Momentum omega_v of the paper's equation (14)."""
    cognitive: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c1 of the paper's equation (14), towards a particle's own best."""
    social: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c2 of the paper's equation (14), towards the swarm's best."""
    stop: StopCriterion = PaperStop(type="paper")
    """Criterion by which a search ends before `iterations`."""

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search, z_max."""
        return self.iterations

    @property
    def evaluations_min(self) -> int:
        """Least number of cost evaluations of a search: all particles and a warm start."""
        return self.particles + 1

    @property
    def evaluations_max(self) -> int:
        """Largest number of cost evaluations of a search: all iterations and a warm start."""
        return (self.iterations + 1) * self.particles + 1

    def contradictions(self, found: Search, warmed: bool, limits: Limits) -> Iterator[str]:
        """Yield "evaluations" if the logged number of evaluations contradicts the logged history,
        and "stopped" if the logged reason for the end contradicts that history."""
        if not len(found.history):
            return
        if found.evaluations != self.particles * len(found.history) + warmed:
            yield "evaluations"
        with np.errstate(invalid="ignore"):  # logarithms fail if the history does not fall
            why = stopped(found.history, self.stop) if len(found.history) > 1 else None
        if why is None and len(found.history) > self.iterations:
            why = StopReason.ITERATIONS
        cut = {StopReason.EVALUATIONS} if limits.evaluations is not None else set()
        cut |= {StopReason.DEADLINE} if limits.timed else set()
        if found.stopped not in ({why} if why else cut):
            yield "stopped"


@dataclass(slots=True)
class Swarm:
    """np particles in L dimensions: `ask` for coordinates, then `tell` their costs.

    u, v, best (np, L): coordinates u_n, velocities v_n and local bests u_lb,n; best_cost (np,):
    J(u_lb,n); u_gb (L,) with cost J(u_gb).
    """

    section: PsoFields
    key: int
    u: Floats
    v: Floats
    best: Floats
    best_cost: Floats
    u_gb: Floats
    cost: float
    z: int = 0

    @classmethod
    def scatter(cls, section: PsoFields, length: int, key: int) -> "Swarm":
        """Algorithm 1, line 1: draw u_n, v_n and u_lb,n uniformly in their search spaces."""
        n = section.particles
        draws = uniform(mix(key, 0), 0, 3 * length * n).reshape(3, length, n)
        u, v, best = (np.ascontiguousarray(draw.T) for draw in draws)
        return cls(
            section,
            mix(key, 1),
            u=LOWER + SPAN * u,
            v=-SPAN + 2 * SPAN * v,
            best=LOWER + SPAN * best,
            best_cost=np.full(n, np.inf),
            u_gb=np.zeros(length),
            cost=np.inf,
        )

    def ask(self) -> Floats:
        """Move the swarm by equations (14)-(17) and return the new coordinates (np, L)."""
        w, c1, c2 = self.section.inertia, self.section.cognitive, self.section.social
        size, shape = self.u.size, self.u.T.shape
        r1, r2 = (r.reshape(shape).T for r in uniform_pair(self.key, self.z * size, size))
        v_new = w * self.v + c1 * r1 * (self.best - self.u) + c2 * r2 * (self.u_gb - self.u)  # (14)
        self.v = np.maximum(-SPAN, np.minimum(v_new, SPAN))  # (15)
        u_new = self.u + self.v  # (16)
        self.u = np.maximum(LOWER, np.minimum(u_new, UPPER))  # (17)
        self.z += 1
        return self.u

    def tell(self, costs: Floats) -> None:
        """Update the bests by equations (18)-(19) with the costs (np,) of `ask`'s coordinates."""
        better = costs < self.best_cost
        self.best[better] = self.u[better]  # (18)
        self.best_cost[better] = costs[better]
        leader = int(np.argmin(self.best_cost))
        if self.best_cost[leader] < self.cost:  # (19)
            self.u_gb, self.cost = self.best[leader].copy(), float(self.best_cost[leader])


def pso(
    section: PsoFields,
    problem: Problem,
    length: int,
    warm: Floats | None,
    key: int,
    limits: Limits,
) -> Search:
    """Algorithm 1, pso(u_gb^0): search sequences of `length` signals, from `warm` or from NULL."""
    swarm = Swarm.scatter(section, length, key)  # line 1
    swarm.best_cost = evaluate(problem, swarm.best).total
    evaluations = section.particles
    if warm is None:  # lines 2-3
        leader = int(np.argmin(swarm.best_cost))
        swarm.u_gb, swarm.cost = swarm.best[leader].copy(), float(swarm.best_cost[leader])
    else:  # lines 4-5: (19) compares it with the swarm later
        swarm.u_gb, swarm.cost = warm.copy(), float(evaluate(problem, warm[None]).total[0])
        evaluations += 1
    history = [swarm.cost]
    reason = StopReason.ITERATIONS
    for _ in range(section.iterations):  # line 7
        if not limits.allow(evaluations + section.particles):
            reason = StopReason.EVALUATIONS
            break
        if limits.expired(evaluations):
            reason = StopReason.DEADLINE
            break
        swarm.tell(evaluate(problem, swarm.ask()).total)  # line 8
        evaluations += section.particles
        history.append(swarm.cost)
        if why := stopped(np.array(history), section.stop):  # line 9
            reason = why
            break
    return Search(length, swarm.u_gb, swarm.cost, np.array(history), evaluations, reason)
