"""The time of a trial, which controllers compare with its limit."""

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.poses import Observation


class TrialTime:
    """Counts the time of one trial up to `limit_s`, from its first command.

    A step begins a control period `period_s` after the last command, or later, after a turn or a
    rest; its frame is somewhat older, or much older if frames are lost. A time is taken for the
    next full period if it is less than half a period short of it.
    """

    def __init__(self, limit_s: float, period_s: float) -> None:
        self.limit_s = limit_s
        self._period_s = period_s
        self._period_ns = round(period_s * SECOND)
        self._began_ns: int | None = None
        self.passed_s = 0.0

    def seen(self, observation: Observation, last_command: Command | None) -> None:
        """Take the time of a control step from its frame and the command before it; the first
        command begins the trial."""
        now_ns = observation.sampled_ns
        if last_command is not None:
            self._began_ns = last_command.sent_ns if self._began_ns is None else self._began_ns
            now_ns = max(now_ns, last_command.sent_ns + self._period_ns)
        if self._began_ns is not None:
            self.passed_s = (now_ns - self._began_ns) / SECOND

    @property
    def left_s(self) -> float:
        """The time left [s], rounded up by at most half a control period."""
        return self.limit_s - self.passed_s + self._period_s / 2

    @property
    def over(self) -> bool:
        """Whether less than half a control period is left."""
        return self.left_s < self._period_s
