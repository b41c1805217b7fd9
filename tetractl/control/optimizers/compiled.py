"""Algorithm 1 by the compiled kernels: the twin of `tetractl.control.optimizers.pso.pso`."""

from collections.abc import Callable

import numpy as np

from tetractl.control.cost import Problem, require_finite
from tetractl.control.kernels import pso as kernel
from tetractl.control.kernels.rollout import Rollout, aligned, costs, lay_out
from tetractl.control.optimizers.pso import Swarm, never
from tetractl.control.rng import mix
from tetractl.core.plan import Search
from tetractl.core.poses import Floats
from tetractl.experiment.controller import (
    BudgetStop,
    PaperStop,
    RelativeStop,
    Stop,
    SwarmSpec,
    TargetStop,
)

NO_LIMIT = 2**62
BETWEEN_LOOKS = 130_000  # robot-steps between two looks at the deadline, some 0.1 ms
BETWEEN_SIGNALS = 2_000_000  # and between two chances for Python to see a Ctrl-C


def pso(
    problem: Problem,
    length: int,
    warm: Floats | None,
    spec: SwarmSpec,
    key: int,
    budget: int | None = None,
    expired: Callable[[], bool] = never,
) -> Search:
    """Algorithm 1 with the same draws as the reference, to which it agrees but for rounding."""
    rollout = lay_out(problem, spec.particles)
    swarm, evaluations = scatter(problem, rollout, length, warm, spec, key)
    rules = make_rules(spec, key, evaluations, budget)
    work = BETWEEN_SIGNALS if expired is never else BETWEEN_LOOKS
    stride = max(1, work // (length * spec.particles * problem.a.size))
    reason, z = kernel.PAUSED, 0
    while reason == kernel.PAUSED and not expired():
        reason, z = kernel.iterate(rollout, swarm, rules, z, z + stride)
    if reason == kernel.NOT_FINITE:
        require_finite(swarm.cost)
    history = swarm.history[: z + 1].copy()
    evaluations += z * spec.particles
    why = kernel.REASONS[reason]
    return Search(length, swarm.u_gb, float(history[-1]), history, evaluations, why)


def scatter(
    problem: Problem, rollout: Rollout, length: int, warm: Floats | None, spec: SwarmSpec, key: int
) -> tuple[kernel.Swarm, int]:
    """Algorithm 1, lines 1-6; returns the swarm and the evaluations it took."""
    drawn = Swarm.scatter(spec, length, key)
    u, v, best = (aligned((length, spec.particles)) for _ in range(3))
    u[:], v[:], best[:] = drawn.u.T, drawn.v.T, drawn.best.T
    best_cost = np.empty(spec.particles)
    costs(rollout, best, best_cost)
    require_finite(best_cost)
    evaluations = spec.particles
    history = np.empty(spec.iterations + 1)
    if warm is None:
        leader = int(np.argmin(best_cost))
        u_gb, history[0] = best[:, leader].copy(), best_cost[leader]
    else:
        first = np.empty(1)
        costs(lay_out(problem, 1), np.ascontiguousarray(warm[:, None]), first)
        require_finite(first)
        u_gb, history[0] = warm.copy(), first[0]
        evaluations += 1
    room = np.zeros((2, spec.particles))
    return kernel.Swarm(u, v, best, room[0], best_cost, room[1], u_gb, history), evaluations


def make_rules(spec: SwarmSpec, key: int, spent: int, budget: int | None) -> kernel.Rules:
    """Lay out (14)-(20) for the kernel."""
    stop, window, decrease, target = _stop(spec.stop)
    return kernel.Rules(
        key=np.uint64(mix(key, 1)),
        inertia=spec.inertia,
        cognitive=spec.cognitive,
        social=spec.social,
        iterations=spec.iterations,
        budget=NO_LIMIT if budget is None else budget,
        spent=spent,
        stop=stop,
        window=window,
        decrease=decrease,
        target=target,
    )


def _stop(stop: Stop) -> tuple[int, int, float, float]:
    match stop:
        case PaperStop():
            return kernel.PAPER_STOP, 10, 0.0, 0.0
        case RelativeStop(window=window, decrease=decrease):
            return kernel.RELATIVE_STOP, window, decrease, 0.0
        case TargetStop(cost=cost):
            return kernel.TARGET_STOP, 10, 0.0, cost
        case BudgetStop():
            return kernel.BUDGET_STOP, 10, 0.0, 0.0
