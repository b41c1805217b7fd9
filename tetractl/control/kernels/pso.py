"""Algorithm 1 as one kernel: the twin of `tetractl.control.optimizers.pso`."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from tetractl.control.kernels.cache import compiled
from tetractl.control.kernels.options import ENTRY_FAST, INLINE_FAST
from tetractl.control.kernels.rollout import Rollout, add_up, begin, evaluate, follow, views
from tetractl.control.kernels.update import move
from tetractl.core.poses import Floats

CRITERION, ITERATIONS, TARGET, EVALUATIONS, PAUSED, NOT_FINITE = range(6)
BUDGET_STOP, PAPER_STOP, RELATIVE_STOP, TARGET_STOP = range(4)


class DoublePrecisionCheck(NamedTuple):
    """What tells J of one sequence in double precision."""

    rollout: Rollout  # of one particle
    signals: Floats  # (L, 1)
    cost: Floats  # (1,)


class SwarmArrays(NamedTuple):
    """The swarm's state between calls; arrays are updated in place.

    Those of the particles are of the kind of the rollout's numbers. Where that is single precision,
    `judge` tells the leader's cost, else it is None.
    """

    u: Any  # (L, P) coordinates
    v: Any  # (L, P) velocities
    best: Any  # (L, P) local bests, one move behind: see `move`
    cost: Any  # (P,) J(u_n)
    best_cost: Any  # (P,) J(u_lb,n)
    better: Any  # (P,) 1 where u_n has just become the local best
    u_gb: Floats  # (L,)
    history: Floats  # (z_max + 1,) J(u_gb)
    judge: Any


class SwarmRules(NamedTuple):
    """Parameters of (14)-(20); see `tetractl.control.optimizers.pso.Pso`."""

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


@compiled(**INLINE_FAST)
def update_local_bests(swarm, least):
    """Apply (18), marking in `better` who improved; return who is best and its J.

    That is -1 and `least` where no particle is below `least`.
    """
    leader = -1
    one, zero = swarm.better.dtype.type(1), swarm.better.dtype.type(0)
    for n in range(swarm.cost.size):
        improved = swarm.cost[n] < swarm.best_cost[n]
        swarm.better[n] = one if improved else zero
        swarm.best_cost[n] = min(swarm.cost[n], swarm.best_cost[n])
    for n in range(swarm.cost.size):
        if swarm.best_cost[n] < least:
            leader, least = n, swarm.best_cost[n]
    return leader, least


@compiled(**INLINE_FAST)
def copy_best(swarm, leader, to):
    """Copy the best of a particle: its coordinate now, or the one it started with."""
    for j in range(to.size):
        fresh = swarm.better[leader] > 0.5
        to[j] = swarm.u[j, leader] if fresh else swarm.best[j, leader]


@compiled(**INLINE_FAST)
def judge_best(swarm, leader):
    """Return J of the best of a particle in double precision, left in the check's signals.

    It replaces the particle's own opinion, so that no sequence of a particle is evaluated twice.
    """
    judge = swarm.judge
    signals = judge.signals[:, 0]
    copy_best(swarm, leader, signals)
    for j in range(signals.size):  # single precision rounds pi up
        signals[j] = max(-math.pi, min(signals[j], math.pi))
    evaluate(judge.rollout, judge.signals, judge.cost)
    swarm.best_cost[leader] = judge.cost[0]
    return judge.cost[0]


def update_bests(swarm: Any, z: int) -> None:
    """Apply (18)-(19) after move z."""


@overload(update_bests, jit_options=INLINE_FAST)
def _update_bests(swarm, z):
    fields = dict(zip(swarm.fields, swarm.types, strict=True))

    def update(swarm, z):
        leader, swarm.history[z] = update_local_bests(swarm, swarm.history[z - 1])
        if leader >= 0:
            copy_best(swarm, leader, swarm.u_gb)

    def update_judged(swarm, z):
        before = swarm.history[z - 1]
        swarm.history[z] = before
        leader, _ = update_local_bests(swarm, swarm.best_cost.dtype.type(before))
        if leader >= 0:
            cost = judge_best(swarm, leader)
            if cost < before:
                swarm.history[z] = cost
                swarm.u_gb[:] = swarm.judge.signals[:, 0]

    return update if fields["judge"] == types.none else update_judged


@compiled(**INLINE_FAST)
def stop_reason(history, z, rules):
    """Return why to stop after iteration z, else PAUSED: the twin of `tetractl.control.stop`."""
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


@compiled(**ENTRY_FAST)
def iterate(rollout, swarm, rules, z, pause):
    """Run iterations z + 1, ... until something stops the search or iteration `pause` is done.

    Returns (reason, iterations done).
    """
    u, v, best, better, u_gb = swarm.u, swarm.v, swarm.best, swarm.better, swarm.u_gb
    length, particles = u.shape
    key, w, c1, c2 = rules.key, rules.inertia, rules.cognitive, rules.social
    lanes, scratch = views(rollout)
    while True:
        if z >= rules.iterations:
            return ITERATIONS, z
        if rules.spent + (z + 1) * particles > rules.budget:
            return EVALUATIONS, z
        if z >= pause:
            return PAUSED, z
        begin(rollout, lanes, scratch)
        for j in range(length):
            draw = (z * length + j) * particles
            move(u, v, best, better, j, u.dtype.type(u_gb[j]), key, draw, w, c1, c2)
            follow(rollout, lanes, scratch, u, j)
        if not add_up(rollout, lanes, swarm.cost):
            return NOT_FINITE, z
        z += 1
        update_bests(swarm, z)
        reason = stop_reason(swarm.history, z, rules)
        if reason != PAUSED:
            return reason, z
