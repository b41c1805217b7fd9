"""Algorithm 1 as one kernel: the twin of `tetractl.control.pso`."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tetractl.control.kernels.numeric import KERNEL, PART
from tetractl.control.kernels.rollout import costs
from tetractl.model.state import Floats

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_1, MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S27, S30, S31, S33 = (np.uint64(s) for s in (27, 30, 31, 33))
LOW_31 = np.uint64(0x7FFF_FFFF)
UNIT_31 = 2.0**-31
SPAN = 2 * math.pi  # |ub - lb|, (15)

CRITERION, ITERATIONS, TARGET, EVALUATIONS, PAUSED, NOT_FINITE = range(6)
REASONS = ("criterion", "iterations", "target", "evaluations", "deadline")
BUDGET_STOP, PAPER_STOP, RELATIVE_STOP, TARGET_STOP = range(4)


class Swarm(NamedTuple):
    """The swarm's state between calls; arrays are updated in place."""

    u: Floats  # (L, P) coordinates
    v: Floats  # (L, P) velocities
    best: Floats  # (L, P) local bests, one move behind: see `move`
    cost: Floats  # (P,) J(u_n)
    best_cost: Floats  # (P,) J(u_lb,n)
    better: Floats  # (P,) 1 where u_n has just become the local best
    u_gb: Floats  # (L,)
    history: Floats  # (z_max + 1,) J(u_gb)


class Rules(NamedTuple):
    """Parameters of (14)-(20); see `SwarmSpec`."""

    key: np.uint64
    inertia: float
    cognitive: float
    social: float
    iterations: int
    budget: int  # evaluations, of which `spent` were used before the first iteration
    spent: int
    stop: int
    window: int
    decrease: float
    target: float


@njit(**PART)
def move(u, v, best, better, j, u_gb, key, first, inertia, cognitive, social):
    """(14)-(17) of signal j of every particle, with draws first, first + 1, ...

    Before it moves, a particle that had just improved leaves its coordinate as its local best,
    (18): done here, where the row is at hand anyway.
    """
    for n in range(u.shape[1]):
        z = key + np.uint64(first + n + 1) * GOLDEN
        z = (z ^ (z >> S30)) * MIX_1
        z = (z ^ (z >> S27)) * MIX_2
        z = z ^ (z >> S31)
        r1 = np.float64(np.int32(z >> S33)) * UNIT_31
        r2 = np.float64(np.int32(z & LOW_31)) * UNIT_31
        at = u[j, n]
        own = at if better[n] > 0.5 else best[j, n]
        best[j, n] = own
        velocity = inertia * v[j, n] + cognitive * r1 * (own - at) + social * r2 * (u_gb - at)
        velocity = max(-SPAN, min(velocity, SPAN))
        v[j, n] = velocity
        u[j, n] = max(-math.pi, min(at + velocity, math.pi))


@njit(**PART)
def lead(swarm, z):
    """(18)-(19): note who improved, and let the best become u_gb."""
    leader, least = -1, swarm.history[z - 1]
    for n in range(swarm.cost.size):
        improved = swarm.cost[n] < swarm.best_cost[n]
        swarm.better[n] = 1.0 if improved else 0.0
        swarm.best_cost[n] = min(swarm.cost[n], swarm.best_cost[n])
    for n in range(swarm.cost.size):
        if swarm.best_cost[n] < least:
            leader, least = n, swarm.best_cost[n]
    swarm.history[z] = least
    if leader >= 0:  # its best is its coordinate now, or the one it started with
        for j in range(swarm.u_gb.size):
            fresh = swarm.better[leader] > 0.5
            swarm.u_gb[j] = swarm.u[j, leader] if fresh else swarm.best[j, leader]


@njit(**PART)
def stop_reason(history, z, rules):
    """Why to stop after iteration z, or PAUSED: the twin of `tetractl.control.stop`."""
    if rules.stop == TARGET_STOP and history[z] <= rules.target:
        return TARGET
    if rules.stop == RELATIVE_STOP and z > max(rules.window, 10):
        before = history[z - rules.window]
        if before - history[z] <= rules.decrease * abs(before):
            return CRITERION
    if rules.stop == PAPER_STOP and z > 10:  # (20)
        c = math.log(history[z - 10])
        delta = 0.0
        for m in range(z - 9, z + 1):
            c += math.log(history[m])
            delta += math.log(history[m - 1] - history[m])
        if delta < c / 2:
            return CRITERION
    return PAUSED


@njit(**KERNEL)
def iterate(course, swarm, rules, z, pause):
    """Run iterations z + 1, ... until something stops the search or iteration `pause` is done.

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
            first = (z * length + j) * particles
            move(u, v, best, better, j, u_gb[j], key, first, w, c1, c2)
        if not costs(course, u, swarm.cost):
            return NOT_FINITE, z
        z += 1
        lead(swarm, z)
        reason = stop_reason(swarm.history, z, rules)
        if reason != PAUSED:
            return reason, z
