"""The searches of one control step: which lengths are tried, within which limits, and the choice.

Lines 2-5 and 10-23 of Algorithm 2, and, beyond it, longer sequences (`tetractl.control.detour`).
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tetractl.control.rng import mix
from tetractl.core.plan import Limits, Search, never
from tetractl.core.poses import Floats
from tetractl.core.problem import Problem
from tetractl.core.protocols import Optimizer
from tetractl.experiment.controller import OptimizerSection

WORTHWHILE = 4
"""Under a limit, each horizon of step 0 gets this many times the least evaluations of a search."""
GROWTH = 1.2  # ratio of one length to the next: after step 0 ...
SPREAD = 1.3  # ... and at step 0
FINE = 0.05  # fraction of a length to which the shortest one is determined
SIGNALS = 6  # signals per robot that several robots take at least: each has two coordinates
THOROUGH, THOROUGH_GROWTH = 3, 1.4
"""Lengths that are searched thoroughly at step 0 if none of the others is good enough, and the
factor from one to the next."""
SEARCH_S = 0.005
"""Time of a control period for each search of a longer sequence [s]: what such a search takes, and
as much again for the rest of the step."""
Candidate = tuple[int, Floats | None]
"""A length to try, and the u_gb^0 to start from."""


def candidates(warm: Floats | None, horizon_max: int) -> Iterable[Candidate]:
    """Yield each (length, u_gb^0): lines 2-4 at step 0, if `warm` is None, then lines 10-20."""
    if warm is None:  # Part I
        for length in range(1, horizon_max + 1):
            yield length, None
        return
    count = len(warm)  # H; Part II. The paper indexes from 1
    if count > 1:
        yield count - 1, warm[1:]
    if count > 0:
        yield count, warm
    yield count + 1, np.append(warm, 0.0)


def affordable(found: list[Candidate], warm: Floats | None, searches: int) -> list[Candidate]:
    """Reduce the candidates: evenly at step 0, later to the length of the plan (H)."""
    if warm is None:
        stride = math.ceil(len(found) / max(1, searches // WORTHWHILE))
        return found[::-stride][::-1]
    count = len(warm)
    kept = sorted(found, key=lambda one: abs(one[0] - count))[: max(1, searches)]
    return sorted(kept, key=lambda one: one[0])


def choose(searches: Sequence[Search], good_enough: float | None, count: int) -> int:
    """Return the index of the least cost, lines 5 and 23.

    Among costs that the optimiser counts as equally good, the length nearest to that of the plan
    under way, `count` (H), is chosen; at step 0, if it is 0, the shortest.
    """
    if good_enough is not None:
        good = [i for i, search in enumerate(searches) if search.cost <= good_enough]
        if good:
            return min(good, key=lambda i: abs(searches[i].length - count))
    return min(range(len(searches)), key=lambda i: searches[i].cost)


def least_length(problem: Problem) -> int:
    """Return the fewest signals to try: enough for every robot to drive straight to its target,
    and at least SIGNALS per robot.
    """
    gaps = problem.poses.distances(problem.targets)
    with np.errstate(divide="ignore", invalid="ignore"):
        seconds = float(np.max(np.where(gaps > 0, gaps / problem.speed, 0.0)))
    if not math.isfinite(seconds):
        return 1
    straight = 1 + max(0, math.ceil((seconds - problem.first_period) / problem.period))
    return max(straight, SIGNALS * len(gaps) if len(gaps) > 1 else 1)


def always(_: Floats) -> bool:
    """Return True: the default accepts any signals."""
    return True


class Searcher:
    """Does the searches of one control step, within its limits, and keeps what they found.

    `evaluations` bounds the cost evaluations of the step, None for no bound; once `expired()` is
    true, only the first search is done. Only signals that are `safe` are good.
    """

    def __init__(
        self,
        optimizer: Optimizer,
        section: OptimizerSection,
        problem: Problem,
        step_key: int,
        evaluations: int | None = None,
        expired: Callable[[], bool] = never,
        safe: Callable[[Floats], bool] = always,
    ) -> None:
        self._optimizer, self._least = optimizer, section.evaluations_min
        self._problem, self._key = problem, step_key
        self._left, self._expired, self._safe = evaluations, expired, safe
        self.found: list[Search] = []
        self._known = dict[int, bool]()  # whether one of them is safe

    def search(
        self, length: int, start: Floats | None, among: int = 1, thorough: bool = False
    ) -> Search | None:
        """Search one length; None if that is beyond the limits.

        The evaluations left are shared equally `among` this search and those that are to follow.
        """
        share = None if self._left is None else self._left // among
        if self.found and (self._expired() or (share is not None and share < self._least)):
            return None
        limits, key = Limits(share, self._expired, thorough), mix(self._key, length)
        found = self._optimizer.search(self._problem, length, start, key, limits)  # lines 3, 21
        self.found.append(found)
        if self._left is not None:
            self._left -= found.evaluations
        return found

    def good(self, found: Search, good_enough: float) -> bool:
        """Return whether a plan that was found is safe and costs no more than that."""
        if found.cost > good_enough:
            return False
        if id(found) not in self._known:
            self._known[id(found)] = self._safe(found.signals)
        return self._known[id(found)]

    def search_all(self, wanted: list[Candidate], good_enough: float | None, count: int) -> None:
        """Search the candidates until the limits are reached.

        If the optimiser counts costs up to `good_enough` as equally good, they are searched in
        the order in which `choose` prefers them by `count`, until one is that good: the others
        could not be chosen any more.
        """
        if good_enough is not None:
            wanted = sorted(wanted, key=lambda one: abs(one[0] - count))
        for i, (length, start) in enumerate(wanted):
            found = self.search(length, start, len(wanted) - i)
            if found is None or (good_enough is not None and self.good(found, good_enough)):
                break

    def search_longer(self, lengths: list[int], period_s: float, good_enough: float) -> int:
        """Search the lengths afresh until a cost is good enough; return the length to continue
        with if the control period was too short, 0 otherwise."""
        for i, length in enumerate(lengths):
            in_time = (i + 1) * SEARCH_S < period_s or i == 0
            found = self.search(length, None) if in_time else None
            if found is None:
                return length
            if self.good(found, good_enough):
                break
        return 0

    def search_spread(self, least: int, most: int, good_enough: float) -> None:
        """Search from `least` on, at growing distances, until a cost is good enough; then between.

        Between that length and the one before it goes on by bisection, down to a fraction FINE of
        it.
        """
        length, failed = min(least, most), 0
        while True:
            found = self.search(length, None)
            if found is None:
                return
            if self.good(found, good_enough):
                break
            if length == most:
                return
            length, failed = min(most, max(length + 1, round(SPREAD * length))), length
        while failed > 0 and length - failed > max(1, FINE * length):
            middle = (length + failed) // 2
            found = self.search(middle, None)
            if found is None:
                return
            if self.good(found, good_enough):
                length = middle
            else:
                failed = middle

    def search_thoroughly(self, problem: Problem, most: int, good_enough: float) -> Problem:
        """Search THOROUGH lengths, each with all it takes, until a cost is good enough.

        It is done in `problem`, of the same robots; return the problem of the least cost found.
        """
        robots, posed, before = len(problem.a), self._problem, len(self.found)
        least = max(least_length(problem), 2 * SIGNALS * robots if robots > 1 else 1)
        self._problem = problem
        for i in range(THOROUGH):
            length = min(most, round(least * THOROUGH_GROWTH**i))
            found = self.search(length, None, THOROUGH - i, thorough=True)
            if found is None or found.cost <= good_enough or length == most:
                break
        best = min(range(len(self.found)), key=lambda i: self.found[i].cost)
        return problem if best >= before else posed
