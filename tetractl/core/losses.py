"""Which robots of a trial are lost: a cell that left, divided or died, or a robot out of view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Observation

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LossRule:
    """A robot that was not tracked for `after_s` is lost, and the trial goes on without it.

    If lost robots are `replaced`, a lost robot that is tracked again is another robot, which takes
    over the target.
    """

    after_s: float
    replaced: bool


class Losses:
    """Which of N robots are `lost` (N,), and how often each has been lost, `times` (N,).

    Given every camera frame in order, the result is the same for the controller, for the log's
    reader and for `verify`. Without a rule no robot is ever lost.
    """

    def __init__(self, rule: LossRule | None, count: int) -> None:
        self._rule = rule
        self._after_ns = round(rule.after_s * SECOND) if rule else 0
        self.lost: Bools = np.zeros(count, dtype=np.bool_)
        self.times: Integers = np.zeros(count, dtype=np.int64)
        self._seen_ns: Integers | None = None

    def see(self, frame: Observation) -> list[int]:
        """Take the next frame; return the indices of robots that are replaced by others in it."""
        if self._rule is None:
            return []
        if self._seen_ns is None:
            self._seen_ns = np.full(len(self.lost), frame.sampled_ns)
        gone = ~self.lost & (frame.sampled_ns - self._seen_ns >= self._after_ns)
        self._seen_ns[frame.valid] = frame.sampled_ns
        self.times += gone
        self.lost |= gone
        back = self.lost & frame.valid if self._rule.replaced else np.zeros_like(self.lost)
        self.lost &= ~back
        return np.flatnonzero(back).tolist()
