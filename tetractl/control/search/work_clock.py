"""A clock for simulations that counts the work of an optimiser instead of real time.

The result of a simulation must not depend on the speed of the computer. Therefore a controller's
deadline counts the evaluations that its searches report, each with the processor time that it takes
on an ordinary computer.
"""

from dataclasses import dataclass

from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats
from tetractl.core.protocols import Optimizer

ROBOT_STEP_NS = 8
"""Time to predict one robot under one signal, in a rollout or a polish [ns]."""
SEARCH_NS = 600_000
"""Time to prepare one search and to check its result [ns]."""


class WorkClock:
    """A clock whose time [ns] is the work that searches of the optimisers given to `wrap` took."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        """Return the virtual time [ns]."""
        return self.now_ns

    def wrap(self, optimizer: Optimizer) -> Optimizer:
        """Wrap an optimiser so that its searches advance this clock, with unchanged results."""
        return _ClockedOptimizer(optimizer, self)


@dataclass(frozen=True, slots=True)
class _ClockedOptimizer:
    """An optimiser whose searches advance a `WorkClock`."""

    optimizer: Optimizer
    clock: WorkClock

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search with the wrapped optimiser; see `Optimizer`.

        Before each check of the deadline, the clock advances by the work done.
        """
        start_ns = self.clock.now_ns + SEARCH_NS
        evaluation_ns = ROBOT_STEP_NS * length * problem.a.size

        def expired(evaluations: int) -> bool:
            self.clock.now_ns = start_ns + evaluations * evaluation_ns
            return limits.expired(evaluations)

        clocked_limits = limits
        if limits.timed:
            clocked_limits = Limits(limits.evaluations, expired)
        search = self.optimizer.search(problem, length, warm, key, clocked_limits)
        self.clock.now_ns = start_ns + search.evaluations * evaluation_ns
        return search
