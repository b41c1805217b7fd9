"""Algorithm 1 as one kernel: the compiled version of `tetractl.control.optimizers.pso`."""

import math
from typing import NamedTuple

import numpy as np

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST
from tetractl.control.kernels.rollout import costs
from tetractl.control.kernels.update import move
from tetractl.control.stop import DECREASE, WINDOW
from tetractl.core.poses import Floats

CRITERION, ITERATIONS, TARGET, EVALUATIONS, PAUSED, NOT_FINITE = range(6)
BUDGET_STOP, PAPER_STOP, RELATIVE_STOP, TARGET_STOP = range(4)


class SwarmArrays(NamedTuple):
    """The swarm's state between calls; arrays are updated in place."""

    u: Floats  # (L, P) coordinates
    v: Floats  # (L, P) velocities
    best: Floats  # (L, P) local bests, updated by the next `move`
    cost: Floats  # (P,) J(u_n)
    best_cost: Floats  # (P,) J(u_lb,n)
    better: Floats  # (P,) 1 where u_n has just become the local best
    u_gb: Floats  # (L,)
    history: Floats  # (z_max + 1,) J(u_gb)


class SwarmRules(NamedTuple):
    """Parameters of (14)-(20); see `tetractl.control.optimizers.pso.Pso`."""

    key: np.uint64
    inertia: float
    cognitive: float
    social: float
    iterations: int
    budget: int  # largest number of evaluations; `spent` of them precede the first iteration
    spent: int
    stop: int
    target: float


@compiled(**INLINE_FAST)
def update_local_bests(swarm, least):
    """Apply (18), marking in `better` the particles that improved; return the index of the best and
    its J.

    Returns -1 and `least` if no particle is below `least`.
    """
    leader = -1
    for n in range(swarm.cost.size):
        improved = swarm.cost[n] < swarm.best_cost[n]
        swarm.better[n] = 1.0 if improved else 0.0
        swarm.best_cost[n] = min(swarm.cost[n], swarm.best_cost[n])
    for n in range(swarm.cost.size):
        if swarm.best_cost[n] < least:
            leader, least = n, swarm.best_cost[n]
    return leader, least


@compiled(**INLINE_FAST)
def update_bests(swarm, z):
    """Apply (18)-(19) after move z. A particle's best is its present coordinate or its previous
    best.
    """
    leader, swarm.history[z] = update_local_bests(swarm, swarm.history[z - 1])
    if leader >= 0:
        fresh = swarm.better[leader] > 0.5
        for j in range(swarm.u_gb.size):
            swarm.u_gb[j] = swarm.u[j, leader] if fresh else swarm.best[j, leader]


@compiled(**INLINE_FAST)
def stop_reason(history, z, rules):
    """Return the reason to stop after iteration z, or PAUSED to go on; `tetractl.control.stop`,
    compiled.
    """
    if rules.stop == TARGET_STOP and history[z] <= rules.target:
        return TARGET
    if rules.stop == RELATIVE_STOP and z > WINDOW:
        before = history[z - WINDOW]
        if before - history[z] <= DECREASE * abs(before):
            return CRITERION
    if rules.stop == PAPER_STOP and z > WINDOW:  # (20)
        c = math.log(history[z - 10])
        delta = 0.0
        for m in range(z - 9, z + 1):
            c += math.log(history[m])
            delta += math.log(history[m - 1] - history[m])
        if delta < c / 2:
            return CRITERION
    return PAUSED


@compiled(**ENTRY_FAST)
def iterate(rollout, swarm, rules, z, pause):
    """Run iterations z + 1, ... until a criterion or limit stops the search or `pause` is reached.

    Returns (reason, iterations done).
    """
    u, v, best, better, u_gb = swarm.u, swarm.v, swarm.best, swarm.better, swarm.u_gb
    length, particles = u.shape
    key, w, c1, c2 = rules.key, rules.inertia, rules.cognitive, rules.social
    while True:
        if z >= rules.iterations:
            return ITERATIONS, z
        if rules.spent + (z + 1) * particles > rules.budget:
            return EVALUATIONS, z
        if z >= pause:
            return PAUSED, z
        for j in range(length):
            draw = (z * length + j) * particles
            move(u, v, best, better, j, u_gb[j], key, draw, w, c1, c2)
        if not costs(rollout, u, swarm.cost):
            return NOT_FINITE, z
        z += 1
        update_bests(swarm, z)
        reason = stop_reason(swarm.history, z, rules)
        if reason != PAUSED:
            return reason, z
