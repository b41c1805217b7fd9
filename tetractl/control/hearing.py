"""Learns how many commands in a row no robot hears, from what the filters found.

For each command, the filter of robot i tells by which factor e_i frames changed the odds that the
robot heard it (`tetractl.control.filter.Heard`). If each set of robots that may have heard the
command is as probable as another, frames are

    L = (product over robots of (1 + e_i) - 1) / (2^N - 1)

times as probable if at least one of N robots heard it as if none did; e_i is 1 for a robot to which
the command was no news. It counts as sent out if L > SURE, and as missed if L < 1 / SURE. Commands
that robots miss each by itself hardly count.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tetractl.control.filter import Heard

SURE = 4.0
"""Factor by which frames must tell that a command was sent out, or that it was not. Of two or three
robots at least two must have missed it: with one of them alone, L is 1/3 or more."""
MEMORY = 10  # number of commands sent out over which the mean is taken
RUN = 4
"""More commands missed in a row are a silence of the radio: a signal that is kept would not get out
either. They do not count."""
MUCH_MISSED = RUN / MEMORY
"""Mean number of commands missed by all robots before one is sent out that one event explains."""
LN_MOST = 50.0  # ln of a factor that is as good as certain


@dataclass(frozen=True, slots=True)
class Hearing:
    """What the commands sent up to `until_s` [s] tell: the mean number `missed` by all robots
    before one is sent out, and the number of those missed `since` the last one sent out. Frames
    have `shown` whether the last one was sent out."""

    until_s: float = -math.inf
    missed: float = 0.0
    since: int = 0
    shown: bool = False

    @property
    def misses_many(self) -> bool:
        """Whether robots miss more than one event explains."""
        return self.missed > MUCH_MISSED

    def after(self, heard: Heard) -> "Hearing":
        """Return what is known with the commands of `heard` that are new."""
        hearing = self
        new = heard.sent_s > self.until_s
        for sent_s, ln_factors in zip(heard.sent_s[new], heard.ln_factors[new], strict=True):
            said = np.nan_to_num(ln_factors, nan=0.0)  # 0 where frames do not say
            hearing = hearing._with(float(sent_s), said.tolist())
        return hearing

    def _with(self, sent_s: float, ln_factors: Sequence[float]) -> "Hearing":
        """Return what is known with a command sent at `sent_s` [s], by ln e_i of each robot."""
        sent_out = factor_sent_out(ln_factors)
        if sent_out > SURE:
            return Hearing(sent_s, self._missed_before_one(), 0, shown=True)
        if sent_out < 1 / SURE:
            return Hearing(sent_s, self.missed, self.since + 1, shown=True)
        return replace(self, until_s=sent_s, shown=False)

    def _missed_before_one(self) -> float:
        """Return the mean with a command that was sent out. Those before it of which frames showed
        nothing, as where a signal is sent again, may all have been missed: then it is no news."""
        frames_said = self.shown or self.since > 0
        if not frames_said or self.since > RUN:
            return self.missed
        return self.missed + (self.since - self.missed) / MEMORY


def factor_sent_out(ln_factors: Sequence[float]) -> float:
    """Return L of a command, by ln e_i of each robot."""
    factors = [1 + math.exp(min(ln_factor, LN_MOST)) for ln_factor in ln_factors]
    return (math.prod(factors) - 1) / (2 ** len(factors) - 1)
