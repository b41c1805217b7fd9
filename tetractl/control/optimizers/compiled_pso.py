"""Algorithm 1 by compiled kernels; `tetractl.control.optimizers.pso` has a readable version."""

import numpy as np

from tetractl.control.cost import require_finite
from tetractl.control.evaluate import compiled_costs
from tetractl.control.kernels import pso as kernel
from tetractl.control.kernels.multistart import BETWEEN_LOOKS
from tetractl.control.kernels.rollout import Rollout, aligned, costs, lay_out
from tetractl.control.optimizers.pso import PsoFields, Swarm
from tetractl.control.rng import mix
from tetractl.control.stop import BudgetStop, PaperStop, RelativeStop, StopCriterion, TargetStop
from tetractl.core.plan import Limits, Problem, Search, StopReason
from tetractl.core.poses import Floats

NO_LIMIT = 2**62
BETWEEN_SIGNALS = 2_000_000  # robot steps between two returns to Python, which handles Ctrl-C
REASONS = {
    kernel.CRITERION: StopReason.CRITERION,
    kernel.ITERATIONS: StopReason.ITERATIONS,
    kernel.TARGET: StopReason.TARGET,
    kernel.EVALUATIONS: StopReason.EVALUATIONS,
    kernel.PAUSED: StopReason.DEADLINE,
}


def pso(
    section: PsoFields,
    problem: Problem,
    length: int,
    warm: Floats | None,
    key: int,
    limits: Limits,
) -> Search:
    """Search by Algorithm 1 with the same draws as `pso.pso`; results differ only by rounding."""
    rollout = lay_out(problem, section.particles)
    swarm, evaluations = scatter(section, problem, rollout, length, warm, key)
    rules = make_rules(section, key, evaluations, limits)
    work = BETWEEN_LOOKS if limits.timed else BETWEEN_SIGNALS
    stride = max(1, work // (length * section.particles * problem.a.size))
    reason, z = kernel.PAUSED, 0
    while reason == kernel.PAUSED and not limits.expired(evaluations + z * section.particles):
        reason, z = kernel.iterate(rollout, swarm, rules, z, z + stride)
    if reason == kernel.NOT_FINITE:
        require_finite(swarm.cost)
    history = swarm.history[: z + 1].copy()
    evaluations += z * section.particles
    return Search(length, swarm.u_gb, float(history[-1]), history, evaluations, REASONS[reason])


def scatter(
    section: PsoFields,
    problem: Problem,
    rollout: Rollout,
    length: int,
    warm: Floats | None,
    key: int,
) -> tuple[kernel.SwarmArrays, int]:
    """Run lines 1-6 of Algorithm 1; return the swarm and the number of evaluations spent."""
    drawn = Swarm.scatter(section, length, key)
    u, v, best = (aligned((length, section.particles)) for _ in range(3))
    u[:], v[:], best[:] = drawn.u.T, drawn.v.T, drawn.best.T
    best_cost = np.empty(section.particles)
    costs(rollout, best, best_cost)
    require_finite(best_cost)
    evaluations = section.particles
    history = np.empty(section.iterations + 1)
    if warm is None:
        leader = int(np.argmin(best_cost))
        u_gb, history[0] = best[:, leader].copy(), best_cost[leader]
    else:
        u_gb = warm.copy()
        history[0] = compiled_costs(problem, 1)(u_gb[:, None])[0]
        evaluations += 1
    cost, better = np.zeros((2, section.particles))
    return kernel.SwarmArrays(u, v, best, cost, best_cost, better, u_gb, history), evaluations


def make_rules(section: PsoFields, key: int, spent: int, limits: Limits) -> kernel.SwarmRules:
    """Return the parameters of equations (14)-(20) for the kernel; `spent` evaluations are done."""
    stop, target = _stop(section.stop)
    return kernel.SwarmRules(
        key=np.uint64(mix(key, 1)),
        inertia=section.inertia,
        cognitive=section.cognitive,
        social=section.social,
        iterations=section.iterations,
        budget=NO_LIMIT if limits.evaluations is None else limits.evaluations,
        spent=spent,
        stop=stop,
        target=target,
    )


def _stop(stop: StopCriterion) -> tuple[int, float]:
    match stop:
        case PaperStop():
            return kernel.PAPER_STOP, 0.0
        case RelativeStop():
            return kernel.RELATIVE_STOP, 0.0
        case TargetStop(cost=cost):
            return kernel.TARGET_STOP, cost
        case BudgetStop():
            return kernel.BUDGET_STOP, 0.0
