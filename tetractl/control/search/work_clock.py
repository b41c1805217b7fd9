"""A clock for simulations that measures how much an optimiser has computed, not real time.

The result of a simulation must not depend on the speed of the computer. Therefore a controller's
deadline counts the evaluations that its searches report, each with the processor time that it takes
on an ordinary computer.
"""

from dataclasses import dataclass

from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats
from tetractl.core.protocols import Optimizer

ROBOT_STEP_NS = 8  # to predict one robot under one signal, in a rollout or a polish
SEARCH_NS = 600_000  # to lay out a search, and to check its result


class WorkClock:
    """The virtual time [ns] that searches have taken, for the optimisers given to `wrap`."""

    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        """Return the virtual time [ns]."""
        return self.ns

    def wrap(self, optimizer: Optimizer) -> Optimizer:
        """Return an optimiser that searches the same and advances this clock while it does."""
        return _Counted(optimizer, self)


@dataclass(frozen=True, slots=True)
class _Counted:
    optimizer: Optimizer
    clock: WorkClock

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search, and set the clock before each check of the deadline; see `Optimizer`."""
        began = self.clock.ns + SEARCH_NS
        evaluation_ns = ROBOT_STEP_NS * length * problem.a.size

        def expired(evaluations: int) -> bool:
            self.clock.ns = began + evaluations * evaluation_ns
            return limits.expired(evaluations)

        counted = limits
        if limits.timed:
            counted = Limits(limits.evaluations, expired)
        search = self.optimizer.search(problem, length, warm, key, counted)
        self.clock.ns = began + search.evaluations * evaluation_ns
        return search
