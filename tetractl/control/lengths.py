"""The searches of one control step: the lengths to try, their limits, and the choice of a plan.

Lines 2-5 and 10-23 of Algorithm 2, and as an extension longer sequences (`control.detour`).
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tetractl.control.rng import mix
from tetractl.core.plan import Limits, Problem, Search, never
from tetractl.core.poses import Floats
from tetractl.core.protocols import Optimizer
from tetractl.experiment.controller import OptimizerSection

WORTHWHILE = 4
"""Evaluations for each length of step 0 if they are limited, as a multiple of the least number that
a search needs."""
GROWTH = 1.2  # ratio of successive lengths tried for a detour
SPREAD = 1.3  # ratio of successive lengths tried at step 0
FINE = 0.05  # precision of the shortest good length, as a fraction of it
SIGNALS = 6  # least number of signals per robot in a plan for several robots
THOROUGH, THOROUGH_GROWTH = 3, 1.4
"""Number of lengths searched thoroughly if step 0 found no good plan, and their growth factor."""
Candidate = tuple[int, Floats | None]
"""A length to try, and the sequence u_gb^0 from which its search starts, None at step 0."""


def candidates(warm: Floats | None, horizon_max: int) -> Iterable[Candidate]:
    """Yield the (length, u_gb^0) to try, by Algorithm 2: lines 2-4 at step 0, where `warm` is None,
    and lines 10-20 after it."""
    if warm is None:  # Part I
        for length in range(1, horizon_max + 1):
            yield length, None
        return
    count = len(warm)  # H of Part II, whose signals are counted from 1 in the paper
    if count > 1:
        yield count - 1, warm[1:]
    if count > 0:
        yield count, warm
    yield count + 1, np.append(warm, 0.0)


def affordable(found: list[Candidate], warm: Floats | None, searches: int) -> list[Candidate]:
    """Return the candidates to search if evaluations suffice for `searches` searches of least size:
    evenly spread lengths at step 0, later the lengths nearest to the present plan's."""
    if warm is None:
        stride = math.ceil(len(found) / max(1, searches // WORTHWHILE))
        return found[::-stride][::-1]
    count = len(warm)
    kept = sorted(found, key=lambda one: abs(one[0] - count))[: max(1, searches)]
    return sorted(kept, key=lambda one: one[0])


def choose(searches: Sequence[Search], good_enough: float | None, count: int) -> int:
    """Return the index of the search with the least cost, lines 5 and 23 of Algorithm 2.

    All costs up to `good_enough` count as equal: of the searches with these costs, the one whose
    length is nearest to `count`, the present plan's (H), is chosen; at step 0, where `count` is 0,
    the shortest one.
    """
    if good_enough is not None:
        good = [i for i, search in enumerate(searches) if search.cost <= good_enough]
        if good:
            return min(good, key=lambda i: abs(searches[i].length - count))
    return min(range(len(searches)), key=lambda i: searches[i].cost)


def least_length(problem: Problem) -> int:
    """Return the least length to try: enough signals for each robot to drive straight to its
    target, and at least SIGNALS per robot.
    """
    gaps = problem.poses.distances(problem.targets)
    with np.errstate(divide="ignore", invalid="ignore"):
        seconds = float(np.max(np.where(gaps > 0, gaps / problem.speed, 0.0)))
    if not math.isfinite(seconds):
        return 1
    straight = 1 + max(0, math.ceil((seconds - problem.first_period) / problem.period))
    return max(straight, SIGNALS * len(gaps) if len(gaps) > 1 else 1)


def always(_: Floats) -> bool:
    """Return True: the default test of whether a plan is safe, which accepts every plan."""
    return True


class Searcher:
    """Runs the searches of one control step within its limits, and collects their results.

    `evaluations` bounds the cost evaluations of the step, None for no bound; once `expired(0)` is
    true, only the first search is done. A plan is good only if `safe` returns True for its signals.
    """

    def __init__(
        self,
        optimizer: Optimizer,
        section: OptimizerSection,
        problem: Problem,
        step_key: int,
        evaluations: int | None = None,
        expired: Callable[[int], bool] = never,
        safe: Callable[[Floats], bool] = always,
    ) -> None:
        self._optimizer, self._least = optimizer, section.evaluations_min
        self._problem, self._key = problem, step_key
        self._left, self._expired, self._safe = evaluations, expired, safe
        self.found: list[Search] = []
        self._known = dict[int, bool]()  # result of `safe`, by the id of a search

    def search(
        self, length: int, start: Floats | None, among: int = 1, thorough: bool = False
    ) -> Search | None:
        """Search sequences of one length; return None if the limits do not allow it.

        The evaluations left are shared equally by `among` searches: this one and the next ones.
        """
        share = None if self._left is None else self._left // among
        if self.found and (self._expired(0) or (share is not None and share < self._least)):
            return None
        limits, key = Limits(share, self._expired, thorough), mix(self._key, length)
        found = self._optimizer.search(self._problem, length, start, key, limits)  # lines 3, 21
        self.found.append(found)
        if self._left is not None:
            self._left -= found.evaluations
        return found

    def good(self, found: Search, good_enough: float) -> bool:
        """Return whether the sequence found is safe and costs at most `good_enough`."""
        if found.cost > good_enough:
            return False
        if id(found) not in self._known:
            self._known[id(found)] = self._safe(found.signals)
        return self._known[id(found)]

    def search_all(self, wanted: list[Candidate], good_enough: float | None, count: int) -> None:
        """Search the candidates until the limits are reached.

        With `good_enough`, the lengths nearest to `count`, which `choose` prefers, are searched
        first, and the search ends with the first length that is good enough.
        """
        if good_enough is not None:
            wanted = sorted(wanted, key=lambda one: abs(one[0] - count))
        for i, (length, start) in enumerate(wanted):
            found = self.search(length, start, len(wanted) - i)
            if found is None or (good_enough is not None and self.good(found, good_enough)):
                break

    def search_longer(self, lengths: list[int], good_enough: float) -> int:
        """Search the lengths in turn, each from scratch, until a cost is good enough; return 0 or,
        if the limits are reached first, the length with which the next step continues.
        """
        for length in lengths:
            found = self.search(length, None)
            if found is None:
                return length
            if self.good(found, good_enough):
                break
        return 0

    def search_spread(self, least: int, most: int, good_enough: float) -> None:
        """Search growing lengths from `least` to `most` until a cost is good enough.

        Bisection between the last two lengths then approaches the shortest length that is good
        enough, up to a difference of the fraction FINE of the length.
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
        """Search up to THOROUGH growing lengths, each thoroughly, until a cost is good enough.

        The searches use `problem`, which has the same robots as the searcher's own problem. Of the
        two problems, the one in which the least cost was found is returned.
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
