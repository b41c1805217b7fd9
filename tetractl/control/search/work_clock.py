"""A clock that measures the work of searches, for deadlines in virtual time.

A simulation must not depend on the speed of its host. A controller's timer therefore counts the
evaluations that its searches report, with the processor time that each takes on an ordinary
computer.
"""

from dataclasses import dataclass

from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats
from tetractl.core.protocols import Optimizer

ROBOT_STEP_NS = 8  # to predict one robot under one signal, in a rollout or a polish
SEARCH_NS = 600_000  # to lay out a search, and to check its result


class WorkClock:
    """The time [ns] that the searches of the optimisers given to `wrap` have taken."""

    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        """Return the time [ns]."""
        return self.ns

    def wrap(self, optimizer: Optimizer) -> Optimizer:
        """Return an optimiser that counts its searches on this clock while they run."""
        return _Counted(optimizer, self)


@dataclass(frozen=True, slots=True)
class _Counted:
    optimizer: Optimizer
    clock: WorkClock

    def search(
        self, problem: Problem, length: int, warm: Floats | None, key: int, limits: Limits
    ) -> Search:
        """Search, and count evaluations before each check of the deadline; see `Optimizer`."""
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
