"""Search plans of several lengths in one control step of the controller `mpc`.

The length of a plan is its number of signals. If the robots stand still, the first search is for
plans that are about as long as the path. If no plan of a length is good, longer plans are tried. A
good plan is then *shortened*: it is compressed in time and polished, as long as it stays good.
While robots follow a plan, the rest of it is shortened in the same way in each step. Near the end
of a plan, the few signals left cannot correct the 2N coordinates of N robots. If the present plan
is then no longer good, it is stretched, or longer plans (detours) lead the robots away from their
targets and back.
"""

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from tetractl.control.search.rng import mix
from tetractl.core.plan import Limits, Problem, Search
from tetractl.core.poses import Floats, wrap
from tetractl.core.protocols import Optimizer

GROWTH = 1.2  # ratio of successive lengths tried for a longer plan, under way
SPREAD = 1.3  # ratio of successive lengths tried at rest
TRIES = 4  # number of first plans that are shortened at rest
CUT = 1 / 8  # share of a plan's length that is tried first to shorten it
SIGNALS_PER_ROBOT = 6  # least number of signals per robot in a plan for several robots


def least_length(problem: Problem) -> int:
    """Compute the minimum length of plans to try [signals].

    It has enough signals for each robot to drive straight to its target, and at least
    SIGNALS_PER_ROBOT signals per robot if there are several. The result is 1 if a robot that is
    not at its target has speed 0.
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


def longer(count: int, length_max: int) -> Iterator[int]:
    """Yield increasing lengths of plans above `count`, up to `length_max` [signals].

    Each length is about GROWTH times the one before.
    """
    length = count + 1
    while length <= length_max:
        yield length
        length = max(length + 1, round(GROWTH * length))


def resampled(signals: Floats, length: int) -> Floats:
    """Stretch or compress a sequence of directions (L,) [rad] in time to `length` directions.

    The results are from -pi to pi.
    """
    count = len(signals)
    times = (np.arange(length) + 0.5) * (count / length) - 0.5
    angles = np.unwrap(signals)
    drawn = np.interp(times, np.arange(count), angles)
    return wrap(drawn)


class Searcher:
    """Runs the searches of one control step, and collects their results in `found`.

    Once the time limit has passed, only the first search is made.

    Args:
        optimizer: Searches a plan of a given length.
        problem: The robots, targets and obstacles of the step.
        step_key: Seed of the step's random numbers.
        limits: The time and the number of evaluations that the searches may use.
    """

    def __init__(
        self,
        optimizer: Optimizer,
        problem: Problem,
        step_key: int,
        limits: Limits,
    ) -> None:
        self._optimizer = optimizer
        self.problem = problem
        self._key = step_key
        self._limits = limits
        self.found: list[Search] = []

    def search(self, length: int, start: Floats | None = None) -> Search | None:
        """Search sequences of one length, record the result in `found`, and return it.

        The result is None if the time limit has passed, unless this is the step's first search.

        Args:
            length: The number of signals.
            start: A sequence to start from, shape (length,). None to start without one.
        """
        tries = sum(search.length == length for search in self.found)
        key = mix(self._key, length)
        if tries:  # another search of the same length has other random numbers
            key = mix(key, tries)
        return self._search(self.problem, length, start, key)

    def _search(
        self, problem: Problem, length: int, start: Floats | None, key: int
    ) -> Search | None:
        """Search sequences of one length for a problem, and record the result in `found`.

        The result is None if the time limit has passed, unless this is the step's first search.
        """
        if self.found and self._limits.expired(0):
            return None
        search = self._optimizer.search(problem, length, start, key, self._limits)
        self.found.append(search)
        return search

    def spread(self, length_min: int, length_max: int, good: Callable[[Search], bool]) -> bool:
        """Search increasing lengths until a plan is good, and shorten that plan.

        This is repeated several times, because plans that start from other random numbers reach
        other lengths.

        Args:
            length_min: The shortest length that can be good.
            length_max: The longest length that can be good.
            good: Decides whether a plan is good.

        Returns:
            Whether a good plan was found.
        """
        reached = False
        for _ in range(TRIES):
            if self._grow(length_min, length_max, good):
                length_max = self.shorten(length_min, good)
                reached = True
        return reached

    def _grow(self, length_min: int, length_max: int, good: Callable[[Search], bool]) -> bool:
        """Search growing lengths until a plan is good, and return whether one is.

        It stops without a good plan after `length_max`, or when the time limit has passed.
        """
        # several robots hardly ever reach their targets along straight lines
        several = self.problem.a.size > 1
        length = min(round(SPREAD * length_min) if several else length_min, length_max)
        while True:
            search = self.search(length)
            if search is None:
                return False
            if good(search):
                return True
            if length == length_max:
                return False
            length = min(length_max, max(length + 1, round(SPREAD * length)))

    def shorten(self, length_min: int, good: Callable[[Search], bool]) -> int:
        """Make the last good plan shorter, as long as a search then finds a plan that is good.

        Args:
            length_min: The minimum length.
            good: Decides whether a plan is good.

        Returns:
            The length of the shortest good plan.
        """
        best = self.found[-1]
        cut = max(1, round(CUT * best.length))
        while cut > 0:
            shorter = best.length - cut
            search = None
            if shorter >= length_min:
                search = self.search(shorter, resampled(best.signals, shorter))
                if search is None:
                    break
            if search and good(search):
                best = search
            else:
                cut //= 2
        return best.length

    def onward(
        self, problem: Problem, starts: Iterable[Floats], good: Callable[[Search], bool]
    ) -> bool:
        """Search plans from given sequences, one after another, until a plan is good.

        Args:
            problem: The problem to search. Its robots are those of the searcher.
            starts: The sequences to start from.
            good: Decides whether a plan is good.

        Returns:
            Whether these searches found the lowest cost of all searches.
        """
        before = len(self.found)
        for start in starts:
            key = mix(self._key, len(start))
            search = self._search(problem, len(start), start, key)
            if search is None or good(search):
                break
        costs = [search.cost for search in self.found]
        return costs.index(min(costs)) >= before
