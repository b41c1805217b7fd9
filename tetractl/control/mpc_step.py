"""What the controller `mpc` begins a leg and a step with, and the candidates that it compares."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tetractl.control.collision import Collision
from tetractl.control.cost import Foreseen
from tetractl.control.lengths import Searcher, longer
from tetractl.control.margins import Margins
from tetractl.control.value import Worth
from tetractl.core.plan import Outcome, Problem, Search
from tetractl.core.poses import Floats

NEXT = 2  # number of next signals of the present plan that must be safe
UNSURE = 2  # number of last signals of a plan that need not be safe
KEPT = 0.2  # clearance while robots receive no command, as a fraction of their radius


@dataclass(frozen=True, slots=True)
class Leg:
    """The part of a trial up to way-point `index` or the targets, or, after it, the hold, with the
    time of the trial [s] and of the clock [ns] of its beginning, when the robots were `moving` or
    not; `outcome` is how the leg before ended."""

    index: int
    began_s: float
    began_ns: int
    moving: bool
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class StepStart:
    """What a step begins with: the `problem`, what is left of the plan under way (H,), u_(warm),
    None if none is under way, the longest plan and the time until the limit in signals, and how
    plans are valued."""

    problem: Problem
    warm: Floats | None
    horizon_max: int
    signals_left: float
    value: Worth

    def is_new(self, signals: Floats) -> bool:
        """Return whether signals (L,) are longer than the plan under way and one signal more."""
        return self.warm is None or len(signals) > len(self.warm) + 1

    def allows(self, length: int, wait_s: float) -> bool:
        """Return whether there is time for a plan of `length` signals that begins in `wait_s`;
        if the targets are farther away than the longest plan leads, for the longest plan."""
        left = self.signals_left - wait_s / self.problem.period
        return min(length, self.horizon_max) <= left

    @property
    def signals_max(self) -> int:
        """The most signals of a plan that ends before the limit of time."""
        return min(self.horizon_max, int(self.signals_left))

    def clear_unheard(
        self,
        margins: Margins,
        collision: Collision,
        signals: Floats,
        seen: Foreseen,
        seconds: float,
    ) -> bool:
        """Return whether robots keep clear if, after any one of the signals (L,), they receive no
        command for so many seconds.

        The last UNSURE signals are not tested; of a plan under way, only the first NEXT are."""
        count = len(signals)
        count = min(count - UNSURE, count if self.is_new(signals) else NEXT)
        if not collision.silence or count <= 0:
            return True
        kept = KEPT * collision.radius, collision.separation
        return margins.clear_unheard(self.problem, seen.path, signals[:count], seconds, *kept)


class Candidate(NamedTuple):
    """A search, the prediction for its signals, and what their plan is worth."""

    worth: float
    search: Search
    seen: Foreseen


def search_on(
    searcher: Searcher,
    step: StepStart,
    warm: Floats,
    good_enough: float,
    after: int,
    valued: Callable[[Search, StepStart], Candidate],
) -> list[Candidate]:
    """Search plans about as long as the one under way, of which the signals `warm` (H,) are left,
    and longer ones if these can be worth more; return them as `valued`. The search of longer ones
    begins with lengths above `after`."""
    value, count, most = step.value, len(warm), step.signals_max
    nearest = [(count, warm), (count - 1, warm[1:]), (count + 1, np.append(warm, 0.0))]
    found = list[Candidate]()
    for length, start in nearest:
        if not 0 < length <= max(most, 1):
            continue
        search = searcher.search(length, start)
        if search is None:
            return found
        found.append(valued(search, step))
        if search.cost <= good_enough and found[-1].worth <= value.plan(good_enough, length, False):
            return [found[-1]]
    for length in longer(count, most, after):
        if value.plan(0.0, length, True) >= min(one.worth for one in found):
            continue
        search = searcher.search(length)
        if search is None:
            break
        found.append(valued(search, step))
    return found
