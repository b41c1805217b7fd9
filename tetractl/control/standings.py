"""Counts how often robots are found to stand although they are sent a direction.

The rate h [1/s] is the number of times that one of the robots was found to begin to stand, over the
time passed and HALF_KNOWN_S: one early case does not yet tell of a high rate. Where no robot ever
sticks it is exactly 0. Only robots that surely stand count: where pictures come late, those that
drive are found to stand for a picture or two, with less probability.
"""

from collections.abc import Sequence

from tetractl.core.plan import Estimate

HALF_KNOWN_S = 10.0  # time of a trial after which the rate is half of what was counted [s]


class Standings:
    """The number of times in a trial that one of the robots `names` was found to begin to stand."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._standing = set[str]()
        self._begun = 0

    def see(self, estimate: Estimate | None) -> None:
        """Count who stands by the estimate of a step, and did not by that of the step before."""
        if estimate is None:
            return
        standing = set(estimate.standing(self._names))
        self._begun += len(standing - self._standing)
        self._standing = standing

    def rate_hz(self, passed_s: float) -> float:
        """Return how often one of the robots begins to stand, `passed_s` after the trial began."""
        return self._begun / (passed_s + HALF_KNOWN_S)
