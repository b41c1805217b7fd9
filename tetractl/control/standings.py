"""Counts how often robots are found to stand although they are sent a direction.

The rate h [1/s] is the number of times that one of the robots was found to stand, and may have
stood for LEAST_S, over the time passed and HALF_KNOWN_S: one early case does not yet tell of a high
rate. Where no robot ever sticks it is exactly 0. Only robots that surely stand count: where
pictures come late, those that drive are found to stand for a picture or two, with less probability.
"""

from collections.abc import Sequence

from tetractl.core.plan import Estimate

HALF_KNOWN_S = 10.0  # time of a trial after which the rate is half of what was counted [s]
LEAST_S = 0.29
"""Least time for which a robot that sticks may have stood, from the last step in which it drove to
the next step [s]. One that its watchdog stopped, as it missed commands, goes on sooner, with the
next one that it hears: at 20 Hz most were found to stand in three steps. At 5 Hz one step counts.
"""


class Standings:
    """The number of times in a trial that one of the robots `names` was found to stand; a control
    step lasts `period_s`."""

    def __init__(self, names: Sequence[str], period_s: float) -> None:
        self._names = names
        self._period_s = period_s
        self._drove_s = dict.fromkeys(names, 0.0)  # time of each robot's last step without standing
        self._stuck = set[str]()
        self._count = 0

    def see(self, estimate: Estimate | None, now_s: float) -> None:
        """Count who stands by the estimate of a step `now_s` after the trial began, and counts as
        stuck since this step."""
        if estimate is None:
            return
        standing = estimate.standing(self._names)
        for name in self._names:
            if name not in standing:
                self._drove_s[name] = now_s
        next_s = now_s + self._period_s
        stuck = {name for name in standing if next_s - self._drove_s[name] >= LEAST_S}
        self._count += len(stuck - self._stuck)
        self._stuck = stuck

    def rate_hz(self, passed_s: float) -> float:
        """Return how often one of the robots begins to stand, `passed_s` after the trial began."""
        return self._count / (passed_s + HALF_KNOWN_S)
