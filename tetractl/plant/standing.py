"""Finds simulated robots that do not move though commanded to, as the lab's motion check does.

The lab's check aborts a run; a simulation may be made to hold its robots, so it only says so. As
disturbances make robots stop and commands late, a robot must stand for longer than in the lab.
"""

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import STOOD, Note
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup
from tetractl.lab.motion_check import DELAY_NS, STANDS

STRIDE_S = 0.25  # least time between two poses that are compared
LEAST_S = 3.0  # time after which a robot that stands is reported


class StandingCheck:
    """Compares camera frames with the commands that were sent.

    A robot stands if it makes less than the fraction `STANDS` of the way that it drives at its
    speed. `dead_time_s` is the plant's dead time [s].
    """

    def __init__(self, setup: Setup, dead_time_s: float) -> None:
        self._setup, self._delay_ns = setup, DELAY_NS + round(dead_time_s * SECOND)
        self._since_ns: int | None = None  # since when all robots are commanded to drive
        self._last: Observation | None = None
        self._stood_s = self._longest_s = np.zeros(len(setup.names))  # how long each robot stands

    def sent(self, now_ns: int, drives: bool) -> None:
        """Take a command sent `now_ns`, by which the robots drive or not."""
        if not drives:
            self._since_ns = self._last = None
        elif self._since_ns is None:
            self._since_ns = now_ns

    def see(self, seen: Observation) -> list[Note]:
        """Take a camera frame; return a warning if robots are found to stand, one for each robot
        in a trial."""
        if self._since_ns is None or seen.sampled_ns < self._since_ns + self._delay_ns:
            return []
        last = self._last = self._last or seen
        seconds = (seen.sampled_ns - last.sampled_ns) / SECOND
        if seconds < STRIDE_S:
            return []
        self._last = seen
        slow = seen.poses.distances(last.poses.xy) < STANDS * self._setup.speed * seconds
        stands = slow & seen.valid & last.valid
        self._stood_s = np.where(stands, self._stood_s + seconds, 0.0)
        new = np.flatnonzero((self._stood_s >= LEAST_S) & (self._longest_s < LEAST_S))
        self._longest_s = np.maximum(self._longest_s, self._stood_s)
        names = ", ".join(self._setup.names[i] for i in new)
        text = f"{names} {'does' if len(new) == 1 else 'do'} not move though commanded to"
        return [Note(seen.received_ns, "warning", text)] * (new.size > 0)

    @property
    def found(self) -> str:
        """The robots that stood, with the longest time of each; "" if there are none."""
        stood = zip(self._setup.names, self._longest_s.tolist(), strict=True)
        each = [f"{name} stood for {long_s:.0f} s" for name, long_s in stood if long_s >= LEAST_S]
        return f"{', '.join(each)} {STOOD}" if each else ""
