"""IPOPT with multiple shooting (benchmarks/tetractl-ipopt), in the race and in closed loop."""

from collections.abc import Callable
from typing import Any, ClassVar, NoReturn

import numpy as np

from tetractl.control.methods.algorithm2 import Algorithm2
from tetractl.control.methods.mpc_section import RecommendedMpc
from tetractl.control.search.cost import evaluate
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats
from tetractl.spec.controller import OptimizerSection
from tetractl.spec.experiment import Experiment

from .peers import Meter
from .problems import LENGTH

PACKAGE = "tetractl_ipopt"
ITERATIONS = 300


def ipopt(cap_s: float) -> Callable[[Meter, int], NoReturn]:
    """Create the solver for a race that lasts `cap_s`."""

    def run(meter: Meter, seed: int) -> NoReturn:
        from tetractl_ipopt import best_random_starts

        rng = np.random.default_rng(seed)
        problem = meter.problem
        programme = shooter(problem, meter.length, cap_s)
        while True:
            (start,) = best_random_starts(problem, meter.length, rng, 1)
            solution = programme.solve(problem, start)
            meter.note(float(evaluate(problem, solution[None]).total[0]))

    return run


class ShrinkingSection(RecommendedMpc):
    """The fields of `Shrinking`: the recommended problem, and the steps that Algorithm 2 counts."""

    steps_max: int = LENGTH
    """A trial ends with its sequence, one step a signal, and so before this step."""

    controller: ClassVar[str] = "solverbench.shooting:Shrinking"


def shrinking(spec: Experiment, optimizer: OptimizerSection) -> Experiment:
    """Return a spec with `Shrinking` instead of its recommended controller.

    Its control period must equal the period of its signals, because Algorithm 2 drops a signal in
    each step.
    """
    recommended = spec.controller
    assert isinstance(recommended, RecommendedMpc)
    assert recommended.signal_periods == 1
    fields: dict[str, Any] = dict(recommended) | {"optimizer": optimizer}
    return spec.model_copy(update={"controller": ShrinkingSection(**fields)})


class Shrinking(Algorithm2):
    """Model predictive control with IPOPT: one length at step 0, and then the rest of the plan."""

    def _starts(self) -> list[tuple[int, Floats | None]]:
        return [(LENGTH, None) if self.warm is None else (len(self.warm), self.warm)]


def shooter(problem: Problem, length: int, cap_s: float) -> Any:
    """Return the optimisation problem for a length. Building it is not timed."""
    import tetractl_ipopt

    return tetractl_ipopt.shooting_programme(problem, length, ITERATIONS, max(cap_s, 0.01))


def build_all(problem: Problem, shortest: int) -> None:
    """Build the optimisation problems that a closed loop needs, before its time counts."""
    import tetractl_ipopt

    tetractl_ipopt.shooting_programme(problem, LENGTH, tetractl_ipopt.ITERATIONS_COLD)
    for length in range(shortest, LENGTH + 1):
        tetractl_ipopt.shooting_programme(
            problem, length, tetractl_ipopt.ITERATIONS_WARM, warm=True
        )
