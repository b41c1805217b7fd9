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
FINE = 0.05  # precision of the shortest good length, as a fraction of it
SPREAD_WORK = 3e7  # evaluations x signals x robots after which no longer ones are tried: 0.25 s
SIGNALS = 6  # least number of signals per robot in a plan for several robots


def least_length(problem: Problem) -> int:
    """Return the least length to try: enough signals for each robot to drive straight to its
    target, and at least SIGNALS per robot.
    """
    gaps = problem.poses.distances(problem.targets).tolist()
    pairs = zip(gaps, problem.speed.tolist(), strict=True)
    seconds = [gap / speed if speed else math.inf for gap, speed in pairs if gap != 0]
    if not all(map(math.isfinite, seconds)):
        return 1
    straight = 1 + max(
        0, math.ceil((max(seconds, default=0.0) - problem.first_period) / problem.period)
    )
    return max(straight, SIGNALS * len(gaps) if len(gaps) > 1 else 1)


def longer(count: int, most: int, after: int) -> Iterator[int]:
    """Yield growing lengths [signals] from `count` + 2 to `most`, beginning with those above
    `after`; `count` is the length of the plan under way."""
    lengths, length = list[int](), count + 2
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
        self._optimizer, self.problem, self._key = optimizer, problem, step_key
        self._expired = expired
        self.found: list[Search] = []

    def search(self, length: int, start: Floats | None = None) -> Search | None:
        """Search sequences of one length; return None if the limits do not allow it."""
        return self._search(self.problem, length, start)

    def _search(self, problem: Problem, length: int, start: Floats | None) -> Search | None:
        """Search sequences of one length for a problem, unless the limits do not allow it."""
        if self.found and self._expired(0):
            return None
        limits = Limits(None, self._expired)
        key = mix(self._key, length)
        search = self._optimizer.search(problem, length, start, key, limits)
        self.found.append(search)
        return search

    def spread(self, least: int, most: int, good: Callable[[Search], bool]) -> bool:
        """Search growing lengths, of which `least` is the shortest and `most` the longest that can
        be good, until a plan is good; return whether one was found.

        Bisection between the last two lengths then approaches the shortest good length, up to a
        difference of the fraction FINE of the length.
        """
        # several robots hardly ever reach their targets along straight lines
        several = self.problem.a.size > 1
        length, failed = min(round(SPREAD * least) if several else least, most), least - 1
        while True:
            found = self.search(length)
            if found is None:
                return False
            if good(found):
                break
            spent = sum(one.evaluations * one.length for one in self.found)
            if length == most or spent * self.problem.a.size > SPREAD_WORK:
                return False
            length, failed = min(most, max(length + 1, round(SPREAD * length))), length
        while length - failed > max(1, FINE * length):
            middle = (length + failed) // 2
            found = self.search(middle)
            if found is None:
                break
            if good(found):
                length = middle
            else:
                failed = middle
        return True

    def onward(
        self, problem: Problem, starts: Iterable[Floats], good: Callable[[Search], bool]
    ) -> bool:
        """Search from each of `starts` until a plan is good; return whether the least cost of all
        searches was found so. The searches are for `problem`, which has the same robots as the
        searcher's own.
        """
        before = len(self.found)
        for start in starts:
            found = self._search(problem, len(start), start)
            if found is None or good(found):
                break
        costs = [search.cost for search in self.found]
        return costs.index(min(costs)) >= before
