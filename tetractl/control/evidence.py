"""What a trial so far tells of the motion: intervals between frames, and the directions sent.

Not every interval tells something: neither the standing start, where the robots wait for the first
command to act, nor the gap of a square, which is driven under directions not known here, nor the
robots that were not tracked.
"""

import numpy as np

from tetractl.control.identify import Directions, Intervals
from tetractl.core.clock import SECOND
from tetractl.core.poses import Floats, Observation, wrap

KEPT = 400  # intervals, the latest
SHORTEST_S = 0.035  # of an interval: shorter ones are joined
DRIVING = 0.5  # share of the expected distance from which on a robot counts as driving


class Evidence:
    """The intervals of a trial of N robots, with speeds (N,) as the spec says.

    `settled_s` is how long after a first direction sent late the robots may still follow another.
    """

    def __init__(self, speed: Floats, period_s: float, settled_s: float) -> None:
        self._speed, self._period_s, self._settled_s = speed, period_s, settled_s
        count = len(speed)
        usable = np.empty((2 * KEPT, count), dtype=np.bool_)
        times, values = np.empty((2, 2 * KEPT)), np.empty((3, 2 * KEPT, count))
        self._kept = Intervals(*times, *values, usable=usable)
        self._size = 0
        self._sent = Directions(*np.empty((2, 2 * KEPT)))
        self._sent_size = 0
        self._driving = np.zeros(count, dtype=np.bool_)
        self._all_drive = False
        self._last: Observation | None = None
        self._settled_from = -np.inf

    def sent(self, sent_ns: int, u: float) -> None:
        """Add a direction u [rad] sent at a time [ns]."""
        if self._sent_size == 0 and self._last is not None:
            waited = (sent_ns - self._last.sampled_ns) / SECOND
            if waited > self._period_s:
                self._settled_from = sent_ns / SECOND + self._settled_s
        if self._sent_size == len(self._sent.when):
            for column in self._sent:
                column[:KEPT] = column[-KEPT:]
            self._sent_size = KEPT
        self._sent.when[self._sent_size], self._sent.u[self._sent_size] = sent_ns / SECOND, u
        self._sent_size += 1

    def seen(self, observation: Observation) -> bool:
        """Add a frame; return whether there is an interval more."""
        last = self._last
        if last is None:
            self._last = observation
            return False
        since, until = last.sampled_ns / SECOND, observation.sampled_ns / SECOND
        t = until - since
        if t < SHORTEST_S:
            return False
        self._last = observation
        turned = wrap(observation.poses.heading - last.poses.heading)
        travelled = np.hypot(observation.poses.x - last.poses.x, observation.poses.y - last.poses.y)
        tracked = last.valid & observation.valid
        usable = tracked & self._driving
        if not self._all_drive:
            chord = self._speed * t * np.sinc(turned / (2 * np.pi))
            self._driving = self._driving | (tracked & (travelled >= DRIVING * chord))
            self._all_drive = bool(self._driving.all())
        known = self._sent_size and since >= self._sent.when[0] and since >= self._settled_from
        if not known or not usable.any():
            return False
        if self._size == len(self._kept.since):
            for column in self._kept:
                column[:KEPT] = column[-KEPT:]
            self._size = KEPT
        values = (since, until, last.poses.heading, turned, travelled, usable)
        for column, value in zip(self._kept, values, strict=True):
            column[self._size] = value
        self._size += 1
        return True

    def intervals(self) -> Intervals:
        """Return the latest intervals, at most KEPT."""
        return self._kept.part(slice(max(0, self._size - KEPT), self._size))

    def directions(self) -> Directions:
        """Return the directions sent, oldest first."""
        return Directions(*(column[: self._sent_size] for column in self._sent))
