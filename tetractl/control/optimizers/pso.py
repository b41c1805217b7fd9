"""Particle swarm optimisation: the paper's Algorithm 1, equations (14)-(20).

Moves (14)-(17) and costs are compiled (`tetractl.control.kernels`); the rest is a few operations on
arrays.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.control.rng import mix, uniform
from tetractl.control.search_progress import Progress
from tetractl.control.stop import PaperStop, StopCriterion, stopped
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats
from tetractl.experiment.controller import OptimizerSection
from tetractl.model.motion.motion import DIRECTION

LOWER, UPPER, _ = DIRECTION  # lb and ub, (12)
SPAN = abs(UPPER - LOWER)  # |ub - lb|, (15)


class Pso(OptimizerSection):
    """Particle swarm of the paper's Algorithm 1, equations (14)-(19)."""

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

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Algorithm 1, pso(u_gb^0): search sequences of `length` signals, from `warm` or NULL."""
        progress, n = Progress(length, limits), self.particles
        for swarm in swarms(self, problem, length, warm, key):
            progress.keep(swarm.u_gb, swarm.cost)
            progress.evaluations += n if swarm.z else n + (warm is not None)
            if swarm.z:  # line 9
                progress.ended = stopped(np.array(progress.history), self.stop)
            if swarm.z == self.iterations or not progress.affords(n):
                return progress.search()
        raise AssertionError("the swarm moves without end")


@dataclass(slots=True)
class Swarm:
    """np particles in L dimensions: `ask` for sequences, then `tell` their costs.

    u, v, best (L, np): sequences u_n, velocities v_n and local bests u_lb,n; best_cost (np,):
    J(u_lb,n); u_gb (L,) with cost J(u_gb), None before it is known.
    """

    section: Pso
    key: int
    u: Floats
    v: Floats
    best: Floats
    best_cost: Floats = field(default_factory=lambda: np.empty(0))
    u_gb: Floats = field(default_factory=lambda: np.empty(0))
    cost: float = np.inf
    z: int = 0

    @classmethod
    def scatter(cls, section: Pso, length: int, key: int) -> "Swarm":
        """Algorithm 1, line 1: draw u_n, v_n and u_lb,n uniformly in their search spaces."""
        n = section.particles
        u, v, best = uniform(mix(key, 0), 0, 3 * length * n).reshape(3, length, n)
        return cls(
            section, mix(key, 1), LOWER + SPAN * u, -SPAN + 2 * SPAN * v, LOWER + SPAN * best
        )

    def ask(self) -> Floats:
        """Move the swarm by equations (14)-(17) and return the new sequences (L, np)."""
        from tetractl.control.kernels.update import move

        w, c1, c2 = self.section.inertia, self.section.cognitive, self.section.social
        move(self.u, self.v, self.best, self.u_gb, np.uint64(self.key), self.z, w, c1, c2)
        self.z += 1
        return self.u

    def tell(self, costs: Floats) -> None:
        """Update the bests by equations (18)-(19) with the costs (np,) of `ask`'s sequences."""
        better = costs < self.best_cost
        self.best = np.where(better, self.u, self.best)  # (18)
        self.best_cost = np.minimum(costs, self.best_cost)
        leader = int(np.argmin(self.best_cost))
        if self.best_cost[leader] < self.cost:  # (19)
            self.u_gb, self.cost = self.best[:, leader].copy(), float(self.best_cost[leader])


def swarms(
    section: Pso, problem: Problem, length: int, warm: Floats | None, key: int
) -> Iterator[Swarm]:
    """Yield Algorithm 1's swarm before the first and after each iteration, without end."""
    from tetractl.control.evaluate import compiled_costs  # late: reading a spec searches nothing

    costs = compiled_costs(problem, section.particles)
    swarm = Swarm.scatter(section, length, key)  # line 1
    swarm.best_cost = costs(swarm.best)
    if warm is None:  # lines 2-3
        leader = int(np.argmin(swarm.best_cost))
        swarm.u_gb, swarm.cost = swarm.best[:, leader].copy(), float(swarm.best_cost[leader])
    else:  # lines 4-5: (19) compares it with the swarm later
        swarm.u_gb, swarm.cost = warm.copy(), float(compiled_costs(problem, 1)(warm[:, None])[0])
    while True:  # line 7
        yield swarm
        swarm.tell(costs(swarm.ask()))  # line 8
