"""(a) time per PSO iteration at equal particles."""

from collections.abc import Callable

import numpy as np

from tetractl.control.cost import evaluate
from tetractl.control.evaluate import compiled_costs
from tetractl.control.optimizers.pso import Swarm
from tetractl.core.plan import Problem

from .peers import OPTIONS, available
from .problems import PARTICLES, SIGNALS, SWARM, printed, tuned_cost
from .report import Pair, Report, Settings, in_pairs, load

SHORT = 20
"""Iterations timed at once: few, so that most repetitions run through without an interruption."""


def iteration(settings: Settings) -> Report:
    """Ours against pyswarms and the readable reference, in interleaved pairs."""
    report = Report("(a) Time per PSO iteration")
    report.say(
        f"{PARTICLES} particles, {SIGNALS} signals, 3 robots, one obstacle, Euler, one thread; "
        f"ours and the peer timed in turn, {load()}."
    )
    problem = printed()
    count = settings.repeats * 2
    search = _Iterations(problem)
    rows = []

    def add(name: str, peer: Callable[[int], object]) -> None:
        pair = in_pairs(lambda: search.run(SHORT), lambda: peer(2), count)
        pair = Pair(pair.ours / SHORT * 1e6, pair.theirs / 2 * 1e6)
        absolute = [f"{np.min(t):.1f} / {np.median(t):.1f}" for t in (pair.ours, pair.theirs)]
        rows.append([name, *absolute, f"{pair.ratio:.0f}"])

    add("our swarm, J by our NumPy reference", _reference(problem))
    if available("pyswarms"):
        add("pyswarms, J in NumPy, tuned", _pyswarms(tuned_cost(problem)))
        add("pyswarms, J by our kernel", _pyswarms(_by_kernel(problem)))
    else:
        report.say("pyswarms is not installed: skipped.")
    report.table(["peer", "ours [us]", "peer [us]", "ratio of the least"], rows)
    report.say("Times are least / median. Starting a search is not counted on either side.")
    return report


class _Iterations:
    """Iterations of the compiled swarm, and nothing else."""

    def __init__(self, problem: Problem) -> None:
        self.swarm = SWARM.swarm(problem, SIGNALS, None, key=1)

    def run(self, count: int) -> None:
        for _ in range(count):
            self.swarm.iterate()


def _reference(problem: Problem) -> Callable[[int], None]:
    swarm = Swarm.scattered(SWARM, SIGNALS, 1, lambda signals: evaluate(problem, signals.T).total)

    def run(count: int) -> None:
        for _ in range(count):
            swarm.iterate()

    return run


def _pyswarms(cost: Callable) -> Callable[[int], object]:
    from pyswarms.single import GlobalBestPSO

    bounds = (np.full(SIGNALS, -np.pi), np.full(SIGNALS, np.pi))
    swarm = GlobalBestPSO(PARTICLES, SIGNALS, OPTIONS, bounds, bh_strategy="nearest")
    return lambda count: swarm.optimize(cost, count, verbose=False)


def _by_kernel(problem: Problem) -> Callable:
    costs = compiled_costs(problem, PARTICLES)
    return lambda signals: costs(signals.T)
