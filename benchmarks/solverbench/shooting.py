"""IPOPT by multiple shooting, the package benchmarks/tetractl-ipopt: raced, and in the loop."""

from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import numpy as np

from tetractl.control.algorithm2 import Algorithm2
from tetractl.control.cost import evaluate
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats

from .peers import Meter
from .problems import LENGTH

PACKAGE = "tetractl_ipopt"
ITERATIONS = 300


def ipopt(cap_s: float) -> Callable[[Meter, int], NoReturn]:
    """Return the peer of a race that lasts `cap_s`."""

    def run(meter: Meter, seed: int) -> NoReturn:
        from tetractl_ipopt import promising

        rng = np.random.default_rng(seed)
        problem = meter.problem
        programme = shooter(problem, meter.length, cap_s)
        while True:
            (start,) = promising(problem, meter.length, rng, 1)
            solution = programme.solve(problem, start)
            meter.note(float(evaluate(problem, solution[None]).total[0]))

    return run


class Shrinking(Algorithm2):
    """Model predictive control by IPOPT: one length at step 0, then what is left of the plan."""

    def _candidates(self) -> Iterator[tuple[int, Floats | None]]:
        yield (LENGTH, None) if self.warm is None else (len(self.warm), self.warm)


def shooter(problem: Problem, length: int, cap_s: float) -> Any:
    """Return the programme for a length; building it is not timed."""
    import tetractl_ipopt

    return tetractl_ipopt.shooter(problem, length, ITERATIONS, max(cap_s, 0.01))


def build_all(problem: Problem, shortest: int) -> None:
    """Build the programmes a closed loop needs, outside its time."""
    import tetractl_ipopt

    section = tetractl_ipopt.Ipopt(type="ipopt")
    tetractl_ipopt.shooter(problem, LENGTH, section.iterations)
    for length in range(shortest, LENGTH + 1):
        tetractl_ipopt.shooter(problem, length, section.polish, warm=True)
