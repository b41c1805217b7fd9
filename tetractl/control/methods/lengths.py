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

DRIVING_GROWTH = 1.2
"""Ratio of successive lengths that are tried for a longer plan while robots drive."""
REST_GROWTH = 1.3
"""Ratio of successive lengths that are tried while robots stand still."""
REST_PLANS = 4
"""Number of first plans that are shortened while robots stand still."""
CUT_FRACTION = 1 / 8
"""Fraction of a plan's length by which it is first shortened."""
SIGNALS_PER_ROBOT = 6
"""Minimum number of signals per robot in a plan for several robots."""


def min_length(problem: Problem) -> int:
    """Compute the minimum length of plans to try [signals].

    Such a plan has enough signals for each robot to drive straight to its target, and at least
    SIGNALS_PER_ROBOT signals per robot if there are several. The result is 1 if a robot that is
    not at its target has speed 0.
    """
    gaps = problem.poses.distances(problem.targets).tolist()
    gaps_and_speeds = zip(gaps, problem.speed.tolist(), strict=True)
    seconds = [gap / speed if speed else math.inf for gap, speed in gaps_and_speeds if gap != 0]
    if not all(map(math.isfinite, seconds)):
        return 1
    straight_length = 1 + max(
        0, math.ceil((max(seconds, default=0.0) - problem.first_period) / problem.period)
    )
    return max(straight_length, SIGNALS_PER_ROBOT * len(gaps) if len(gaps) > 1 else 1)


def longer_lengths(count: int, length_max: int) -> Iterator[int]:
    """Yield increasing lengths of plans above `count`, up to `length_max` [signals].

    Each length is about DRIVING_GROWTH times the one before.
    """
    length = count + 1
    while length <= length_max:
        yield length
        length = max(length + 1, round(DRIVING_GROWTH * length))


def resample(signals: Floats, length: int) -> Floats:
    """Stretch or compress a sequence of directions (L,) [rad] in time to `length` directions.

    The results are from -pi to pi.
    """
    count = len(signals)
    times = (np.arange(length) + 0.5) * (count / length) - 0.5
    angles = np.unwrap(signals)
    directions = np.interp(times, np.arange(count), angles)
    return wrap(directions)


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
        self.searches: list[Search] = []

    def search(self, length: int, start: Floats | None = None) -> Search | None:
        """Search sequences of one length, record the result in `found`, and return it.

        The result is None if the time limit has passed, unless this is the step's first search.

        Args:
            length: The number of signals.
            start: A sequence to start from, shape (length,). None to start without one.
        """
        n_same_length = sum(search.length == length for search in self.searches)
        key = mix(self._key, length)
        if n_same_length:  # another search of the same length has other random numbers
            key = mix(key, n_same_length)
        return self._search(self.problem, length, start, key)

    def _search(
        self, problem: Problem, length: int, start: Floats | None, key: int
    ) -> Search | None:
        """Search sequences of one length for a problem, and record the result in `found`.

        The result is None if the time limit has passed, unless this is the step's first search.
        """
        if self.searches and self._limits.expired(0):
            return None
        search = self._optimizer.search(problem, length, start, key, self._limits)
        self.searches.append(search)
        return search

    def search_lengths(
        self, length_min: int, length_max: int, is_good: Callable[[Search], bool]
    ) -> bool:
        """Search plans of increasing length until one is good, and shorten that plan.

        This is repeated several times, because plans that start from other random numbers reach
        other lengths.

        Args:
            length_min: The shortest length that can be good.
            length_max: The longest length that can be good.
            is_good: Decides whether a plan is good.

        Returns:
            Whether a good plan was found.
        """
        is_reached = False
        for _ in range(REST_PLANS):
            if self._grow(length_min, length_max, is_good):
                length_max = self.shorten(length_min, is_good)
                is_reached = True
        return is_reached

    def _grow(self, length_min: int, length_max: int, is_good: Callable[[Search], bool]) -> bool:
        """Search plans of increasing length, and return whether a good plan was found.

        The search stops without a good plan after `length_max`, or when the time limit has passed.
        """
        # several robots hardly ever reach their targets along straight lines
        has_several_robots = self.problem.a.size > 1
        length = min(
            round(REST_GROWTH * length_min) if has_several_robots else length_min, length_max
        )
        while True:
            search = self.search(length)
            if search is None:
                return False
            if is_good(search):
                return True
            if length == length_max:
                return False
            length = min(length_max, max(length + 1, round(REST_GROWTH * length)))

    def shorten(self, length_min: int, is_good: Callable[[Search], bool]) -> int:
        """Shorten the last plan step by step, as long as a search finds a shorter good plan.

        Args:
            length_min: Minimum length of a plan [signals].
            is_good: Decides whether a plan is good.

        Returns:
            The length of the shortest good plan.
        """
        best = self.searches[-1]
        cut_signals = max(1, round(CUT_FRACTION * best.length))
        while cut_signals > 0:
            length = best.length - cut_signals
            search = None
            if length >= length_min:
                search = self.search(length, resample(best.signals, length))
                if search is None:
                    break
            if search and is_good(search):
                best = search
            else:
                cut_signals //= 2
        return best.length

    def search_from_starts(
        self, problem: Problem, starts: Iterable[Floats], is_good: Callable[[Search], bool]
    ) -> bool:
        """Search plans from given sequences, one after another, until a plan is good.

        Args:
            problem: The problem to search. Its robots are those of the searcher.
            starts: The sequences to start from.
            is_good: Decides whether a plan is good.

        Returns:
            Whether these searches found the lowest cost of all searches.
        """
        n_before = len(self.searches)
        for start in starts:
            key = mix(self._key, len(start))
            search = self._search(problem, len(start), start, key)
            if search is None or is_good(search):
                break
        costs = [search.cost for search in self.searches]
        return costs.index(min(costs)) >= n_before
