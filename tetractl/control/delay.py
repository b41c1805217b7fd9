"""Where the robots will be when a command acts: the state predicted over the dead time."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.problem import Problem
from tetractl.experiment.kinds import MOTIONS

Held = tuple[int, int, Floats]
"""Directions u (N,) [rad], NaN for a robot that stands, and the times from and until which they act
[ns]."""


@dataclass(slots=True)
class Sent:
    """A direction u [rad] sent to N robots at `sent_ns`; `arrived` (N,) is what is believed."""

    sent_ns: int
    u: float
    arrived: Bools


class Predictor:
    """The directions sent so far, each of which acts `dead_time_s` after it was sent.

    Before the first one acts the robots stand still. A robot that a direction did not arrive at
    follows the one before. `before` (N,) [rad] is what the robots held before the recent ones, NaN
    for one that stands.
    """

    def __init__(self, dead_time_s: float, count: int) -> None:
        self.dead_time_s = dead_time_s
        self.recent: deque[Sent] = deque()
        self.before = np.full(count, np.nan)
        self._count = count

    @property
    def delay_ns(self) -> int:
        """The dead time [ns]."""
        return round(self.dead_time_s * SECOND)

    def sent(self, sent_ns: int, u: float) -> None:
        """Add a direction, believed to arrive."""
        self.recent.append(Sent(sent_ns, u, np.ones(self._count, dtype=np.bool_)))

    def held(self, since: int, until: int) -> list[Held]:
        """Return the directions that act between two times [ns], oldest first."""
        found: list[Held] = []
        held, begin, delay = self.before, since, self.delay_ns
        for sent in self.recent:
            acts = min(sent.sent_ns + delay, until)
            if acts > begin:
                found.append((begin, acts, held))
                begin = acts
            held = np.where(sent.arrived, sent.u, held)
        if until > begin:
            found.append((begin, until, held))
        return found

    def forget(self, before: int) -> None:
        """Drop the directions that stopped acting before a time [ns]."""
        while len(self.recent) > 1 and self.recent[1].sent_ns + self.delay_ns <= before:
            dropped = self.recent.popleft()
            self.before = np.where(dropped.arrived, dropped.u, self.before)


def turned(problem: Problem, heading: Floats, held: list[Held], bias: Floats | float) -> Floats:
    """Return the headings (..., N) [rad] after the directions held (..., N); see `advance`."""
    headings = MOTIONS.load(problem.motion).headings
    for since, until, u in held:
        stands = np.isnan(u)
        seconds = np.where(stands, 0.0, (until - since) / SECOND)
        heading = headings(heading, np.where(stands, 0.0, u) + bias, problem.a, seconds)
    return heading


def advance(problem: Problem, poses: Poses, held: list[Held], bias: Floats | float = 0.0) -> Poses:
    """Return the poses after the directions held, by the problem's motion.

    `bias` (N,) [rad] is added to the direction that each robot turns towards.
    """
    step = MOTIONS.load(problem.motion).step
    x, y, heading = poses.x, poses.y, poses.heading
    for since, until, u in held:
        stands = np.isnan(u)
        seconds = np.where(stands, 0.0, (until - since) / SECOND)
        towards = np.where(stands, 0.0, u) + bias
        x, y, heading = step(x, y, heading, towards, problem.a, problem.speed, seconds)
    return Poses(x, y, heading)
