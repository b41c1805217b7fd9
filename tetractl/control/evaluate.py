"""J of many sequences at once, for optimisers: the compiled rollout behind one call."""

from collections.abc import Callable

import numpy as np

from tetractl.control.cost import require_finite
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem


def compiled_costs(problem: Problem, count: int) -> Callable[[Floats], Floats]:
    """Return a function that maps `count` sequences, (L, count), to their costs J, (count,).

    It agrees with `tetractl.control.cost.evaluate` to 1e-9, and raises ControlError where a cost is
    not finite.
    """
    from tetractl.control.kernels.rollout import costs, lay_out

    rollout = lay_out(problem, count)

    def evaluate(signals: Floats) -> Floats:
        found = np.empty(count)
        costs(rollout, np.ascontiguousarray(signals), found)
        require_finite(found)
        return found

    return evaluate
