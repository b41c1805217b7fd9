"""Count the time of a trial in control periods, to compare it with the time limit."""

import math

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.poses import Observation


class TrialTime:
    """A clock that counts the time of one trial from its first command, up to `limit_s`.

    A step begins one control period `period_s` after the last command, or later, after a turn or a
    pause. Its frame is somewhat older, or much older if frames are lost. A time that is at most
    half a period short of the next full period counts as this period. After a pause of 3.5 periods,
    the time is exactly half a period short. So times are compared in whole nanoseconds, without
    rounding.
    """

    def __init__(self, limit_s: float, period_s: float) -> None:
        self._limit_ns = math.inf if math.isinf(limit_s) else round(limit_s * SECOND)
        self._period_ns = round(period_s * SECOND)
        self._start_ns: int | None = None
        self._elapsed_ns = 0

    def add_step(self, observation: Observation, last_command: Command | None) -> None:
        """Update the time with a step's frame and the command of the previous step.

        The time starts with the first command. Before it, with `last_command` None, it stays 0.
        """
        now_ns = observation.sampled_ns
        if last_command is not None:
            self._start_ns = last_command.sent_ns if self._start_ns is None else self._start_ns
            now_ns = max(now_ns, last_command.sent_ns + self._period_ns)
        if self._start_ns is not None:
            self._elapsed_ns = now_ns - self._start_ns

    @property
    def elapsed_s(self) -> float:
        """The time that has passed since the first command of the trial [s]."""
        return self._elapsed_ns / SECOND

    @property
    def periods_left(self) -> float:
        """The remaining time in control periods, plus half a period.

        Its integer part is the number of steps until the limit.
        """
        left_ns = self._limit_ns - self._elapsed_ns + self._period_ns // 2
        return left_ns / self._period_ns

    @property
    def is_over(self) -> bool:
        """Whether the time limit is reached: less than half a control period is left."""
        return self.periods_left < 1.0
