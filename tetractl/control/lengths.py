"""The searches of one control step of `mpc`: the lengths to try, and their limits.

A search at rest begins with the shortest plan that could reach the targets. Near the end of a plan
the few signals left cannot correct the 2N coordinates of N robots; longer sequences (detours) lead
the robots away from their targets and back.
"""

import math
from collections.abc import Callable, Iterable, Iterator

from tetractl.control.rng import mix
from tetractl.core.plan import Limits, Problem, Search, never
from tetractl.core.poses import Floats
from tetractl.core.protocols import Optimizer

GROWTH = 1.2  # ratio of successive lengths tried for a detour
SPREAD = 1.3  # ratio of successive lengths tried at rest
VAIN = 10  # number of searches in a row that find no shorter plan, after which none is tried
SPREAD_WORK = 3e7  # evaluations x signals x robots after which no longer ones are tried: 0.25 s
SIGNALS_PER_ROBOT = 6  # least number of signals per robot in a plan for several robots


def least_length(problem: Problem) -> int:
    """Return the least length to try: enough signals for each robot to drive straight to its
    target, and at least SIGNALS_PER_ROBOT per robot.
    """
    gaps = problem.poses.distances(problem.targets).tolist()
    pairs = zip(gaps, problem.speed.tolist(), strict=True)
    seconds = [gap / speed if speed else math.inf for gap, speed in pairs if gap != 0]
    if not all(map(math.isfinite, seconds)):
        return 1
    straight = 1 + max(
        0, math.ceil((max(seconds, default=0.0) - problem.first_period) / problem.period)
    )
    return max(straight, SIGNALS_PER_ROBOT * len(gaps) if len(gaps) > 1 else 1)


def longer(count: int, most: int, after: int) -> Iterator[int]:
    """Yield growing lengths [signals] from `count` + 2 to `most`, beginning with those above
    `after`; `count` is the length of the plan under way."""
    lengths = list[int]()
    length = count + 2
    while length <= most:
        lengths.append(length)
        length = max(length + 1, round(GROWTH * length))
    yield from (n for n in lengths if n > after)
    yield from (n for n in lengths if n <= after)


class Searcher:
    """Runs the searches of one control step, and collects their results in `found`.

    Once `expired(0)` is true, only the first search is done.
    """

    def __init__(
        self,
        optimizer: Optimizer,
        problem: Problem,
        step_key: int,
        expired: Callable[[int], bool] = never,
    ) -> None:
        self._optimizer = optimizer
        self.problem = problem
        self._key = step_key
        self._expired = expired
        self.found: list[Search] = []

    def search(self, length: int, start: Floats | None = None) -> Search | None:
        """Search sequences of one length; return None if the limits do not allow it."""
        tries = sum(search.length == length for search in self.found)
        key = mix(self._key, length)
        if tries:  # another search of the same length has other random numbers
            key = mix(key, tries)
        return self._search(self.problem, length, start, key)

    def _search(
        self, problem: Problem, length: int, start: Floats | None, key: int
    ) -> Search | None:
        """Search sequences of one length for a problem, unless the limits do not allow it."""
        if self.found and self._expired(0):
            return None
        limits = Limits(None, self._expired)
        search = self._optimizer.search(problem, length, start, key, limits)
        self.found.append(search)
        return search

    def spread(self, least: int, most: int, good: Callable[[Search], bool]) -> bool:
        """Search growing lengths, of which `least` is the shortest and `most` the longest that can
        be good, until a plan is good, and then shorter ones; return whether one was found."""
        length = self._grow(least, most, good)
        if length is None:
            return False
        self._shorten(least, length, good)
        return True

    def _grow(self, least: int, most: int, good: Callable[[Search], bool]) -> int | None:
        """Search growing lengths until a plan is good; return its length, None if none is."""
        # several robots hardly ever reach their targets along straight lines
        several = self.problem.a.size > 1
        length = min(round(SPREAD * least) if several else least, most)
        while True:
            search = self.search(length)
            if search is None:
                return None
            if good(search):
                return length
            spent = sum(search.evaluations * search.length for search in self.found)
            if length == most or spent * self.problem.a.size > SPREAD_WORK:
                return None
            length = min(most, max(length + 1, round(SPREAD * length)))

    def _shorten(self, least: int, length: int, good: Callable[[Search], bool]) -> None:
        """Search plans shorter than a good one of `length` by bisection from `least` on.

        A search of a length fails by chance, and the shorter the plan the more often. The bisection
        is therefore repeated, with other random numbers, until VAIN searches in a row were in vain.
        """
        failed = least - 1
        vain = 0
        while length > least and vain < VAIN:
            middle = (failed + length) // 2
            search = self.search(middle)
            if search is None:
                return
            if good(search):
                length = middle
                vain = 0
            else:
                failed = middle
                vain += 1
            if failed >= length - 1:
                failed = least - 1

    def onward(
        self, problem: Problem, starts: Iterable[Floats], good: Callable[[Search], bool]
    ) -> bool:
        """Search from each of `starts` until a plan is good; return whether the least cost of all
        searches was found so. The searches are for `problem`, which has the same robots as the
        searcher's own.
        """
        before = len(self.found)
        for start in starts:
            key = mix(self._key, len(start))
            search = self._search(problem, len(start), start, key)
            if search is None or good(search):
                break
        costs = [search.cost for search in self.found]
        return costs.index(min(costs)) >= before
