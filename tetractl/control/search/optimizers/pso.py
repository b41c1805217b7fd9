"""Particle swarm optimisation: the paper's Algorithm 1, equations (14)-(20).

A swarm has P particles (the paper's np; here, `np` is NumPy). Particle n has a sequence u_n of L
signals [rad], a velocity v_n, and u_lb,n, the best sequence it has met; u_gb is the best sequence
that the swarm has met. The cost J of a sequence, (7), is a length. One iteration, from z to z + 1,
is

    v_n    <-  omega_v v_n + c1 r1 (u_lb,n - u_n) + c2 r2 (u_gb - u_n)        (14)
    v_n    <-  max(-|ub - lb|, min(v_n, |ub - lb|))                           (15)
    u_n    <-  max(lb, min(u_n + v_n, ub))                                    (16), (17)
    u_lb,n <-  u_n     if J(u_n) < J(u_lb,n)                                  (18)
    u_gb   <-  u_lb,m  if J(u_lb,m) < J(u_gb), m = argmin_n J(u_lb,n)         (19)

with r1 and r2 uniform in [0, 1), drawn for each particle, signal and iteration, and with the bounds
lb = -pi and ub = pi of each signal, (12). (20) is `tetractl.control.search.stop`. Arrays have a
column for each particle, (L, P). The moves (14)-(17) and the costs are compiled
(`tetractl.control.search.kernels`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from tetractl.control.search.rng import mix, uniform
from tetractl.control.search.search_progress import SearchProgress
from tetractl.control.search.stop import PaperStop, StopCriterion, reason_to_stop
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats
from tetractl.model.motion.motion import LOWER, UPPER
from tetractl.spec.controller import OptimizerSection

SPAN = UPPER - LOWER
"""Maximum change |ub - lb| of a signal in one iteration, equation (15) [rad]."""
KEY_OF_START = 0
"""Index for `mix` that derives the key of the swarm's start from the key of the search."""
KEY_OF_MOVES = 1
"""Index for `mix` that derives the key of the swarm's moves (14) from the key of the search."""


class Pso(OptimizerSection):
    """The paper's optimiser: a particle swarm, Algorithm 1 with equations (14)-(19)."""

    type: Literal["pso"] = "pso"
    particles: int = Field(default=100, ge=1, le=1_000_000)
    """Number of particles np."""
    iterations: int = Field(default=100, ge=1, le=1_000_000)
    """Maximum number of iterations z_max of one search (one horizon)."""
    inertia: float = Field(default=0.7, gt=0, le=2, allow_inf_nan=False)
    """Momentum omega_v of the paper's equation (14)."""
    cognitive: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c1 of the paper's equation (14), towards a particle's own best."""
    social: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c2 of the paper's equation (14), towards the swarm's best."""
    stop: StopCriterion = PaperStop(type="paper")
    """Criterion that can end a search before `iterations`."""

    @property
    def iterations_max(self) -> int:
        """Maximum number of iterations of one search, the paper's z_max."""
        return self.iterations

    @property
    def evaluations_min(self) -> int:
        """Minimum number of cost evaluations: one of each particle, and one of a warm start."""
        return self.particles + 1

    @property
    def evaluations_max(self) -> int:
        """Maximum number of cost evaluations of a search: all iterations, and the warm start."""
        return (self.iterations + 1) * self.particles + 1

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search by the paper's Algorithm 1, pso(u_gb^0); see `Optimizer.search`.

        u_gb^0 is the warm start, or NULL if it is None. The line numbers in comments are the
        paper's.
        """
        progress = SearchProgress(length, limits)
        swarm = self.create_swarm(problem, length, warm, key)  # lines 1-6
        evaluations = self.particles if warm is None else self.particles + 1
        progress.add_best(swarm.global_best.signals, swarm.global_best.cost, evaluations)
        for _ in range(self.iterations):  # line 7
            progress.stop_reason = progress.find_limit(self.particles)
            if progress.stop_reason is None:
                swarm.iterate()  # line 8
                progress.add_best(swarm.global_best.signals, swarm.global_best.cost, self.particles)
                # line 9 of the algorithm
                progress.stop_reason = reason_to_stop(np.array(progress.history), self.stop)
            if progress.stop_reason is not None:
                break  # line 10
        return progress.to_search()  # line 13

    def create_swarm(self, problem: Problem, length: int, warm: Floats | None, key: int) -> "Swarm":
        """Create the swarm with which Algorithm 1 begins, lines 1-6.

        The swarm's u_gb is `warm` or, without a warm start, the best of all u_lb,n. A warm start is
        not compared with the u_lb,n before the first iteration.

        Args:
            problem: What to minimise.
            length: Number of signals in the sequence.
            warm: A sequence to start from [rad], shape (length,). None if there is none.
            key: Determines all random numbers of the search.
        """
        # imported late: reading a spec searches nothing
        from tetractl.control.search.evaluate import compiled_costs

        swarm = Swarm.create_random(self, length, key, compiled_costs(problem, self.particles))
        if warm is None:
            return swarm
        warm_costs_of = compiled_costs(problem, 1)
        warm_cost = float(warm_costs_of(warm[:, None])[0])
        return replace(swarm, global_best=BestSequence(warm.copy(), warm_cost))


@dataclass(frozen=True, slots=True)
class BestSequence:
    """The best sequence of signals (L,) [rad] met so far, with its cost J [length unit]."""

    signals: Floats
    cost: float


@dataclass(slots=True)
class Swarm:
    """A particle swarm: P sequences of L signals that move towards the best sequences met so far.

    `create_random` creates a swarm, and `iterate` moves it. `costs_of` maps sequences (L, P) to
    their costs J (P,). `key` determines all random numbers.
    """

    section: Pso
    key: int
    costs_of: Callable[[Floats], Floats]
    u: Floats
    """Present sequences u_n of the particles [rad], shape (L, P)."""
    v: Floats
    """Velocities v_n of the particles [rad per iteration], shape (L, P)."""
    u_lb: Floats
    """Best sequence u_lb,n that each particle has met [rad], shape (L, P)."""
    local_best_costs: Floats
    """Cost J(u_lb,n) of each particle's best sequence, shape (P,)."""
    global_best: BestSequence
    """Best sequence u_gb that the swarm has met, with its cost J(u_gb)."""
    z: int = 0
    """Number of iterations done."""

    @classmethod
    def create_random(
        cls, section: Pso, length: int, key: int, costs_of: Callable[[Floats], Floats]
    ) -> "Swarm":
        """Create a swarm with random positions and velocities.

        u_n, v_n and u_lb,n are uniform in their search spaces (line 1), and u_gb is the best of the
        u_lb,n (line 3).

        Args:
            section: Parameters of the swarm.
            length: Number of signals in the sequence.
            key: Determines all random numbers of the search.
            costs_of: Computes the costs (P,) of sequences (L, P).
        """
        shape = 3, length, section.particles
        uniform_draws = uniform(mix(key, KEY_OF_START), 0, 3 * length * section.particles)
        draws_u, draws_v, draws_lb = uniform_draws.reshape(shape)
        u_lb = LOWER + SPAN * draws_lb
        local_costs = costs_of(u_lb)
        return cls(
            section=section,
            key=mix(key, KEY_OF_MOVES),
            costs_of=costs_of,
            u=LOWER + SPAN * draws_u,
            v=-SPAN + 2 * SPAN * draws_v,
            u_lb=u_lb,
            local_best_costs=local_costs,
            global_best=find_best(u_lb, local_costs),
        )

    def iterate(self) -> None:
        """Move all particles, then update the best sequences: line 8 of Algorithm 1."""
        self._move()
        costs = self.costs_of(self.u)
        self.u_lb = np.where(costs < self.local_best_costs, self.u, self.u_lb)  # (18)
        self.local_best_costs = np.minimum(costs, self.local_best_costs)
        best = find_best(self.u_lb, self.local_best_costs)
        if best.cost < self.global_best.cost:  # (19)
            self.global_best = best
        self.z += 1

    def _move(self) -> None:
        """Move all particles in place by equations (14)-(17), which are compiled."""
        from tetractl.control.search.kernels.update import (
            move,  # late: reading a spec compiles nothing
        )

        move(
            self.u,
            self.v,
            self.u_lb,
            self.global_best.signals,
            np.uint64(self.key),
            self.z,
            self.section.inertia,
            self.section.cognitive,
            self.section.social,
        )


def find_best(signals: Floats, costs: Floats) -> BestSequence:
    """Find the sequence with the lowest cost, or the first one of several with equal costs.

    Args:
        signals: Sequences [rad], shape (L, P).
        costs: The cost J of each sequence, shape (P,).
    """
    best_index = int(np.argmin(costs))
    return BestSequence(signals[:, best_index].copy(), float(costs[best_index]))
