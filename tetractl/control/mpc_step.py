"""What the controller `mpc` begins a leg and a step with, and the candidates that it compares."""

from dataclasses import dataclass
from typing import NamedTuple

from tetractl.control.cost import Foreseen
from tetractl.control.value import Worth
from tetractl.core.plan import Outcome, Problem, Search
from tetractl.core.poses import Floats


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


class Candidate(NamedTuple):
    """A search, the prediction for its signals, and what their plan is worth."""

    worth: float
    search: Search
    seen: Foreseen
