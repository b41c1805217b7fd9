"""Predicts the robots' poses over the dead time, to the moment when a command acts."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.plan import Problem
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.registries import MOTIONS

Held = tuple[int, int, Floats]
"""The start and end [ns] of an interval, and the direction u (N,) [rad] that each robot follows in
it, NaN for a robot that stands still."""


@dataclass(slots=True)
class Sent:
    """A direction u [rad] sent to N robots at `sent_ns`; `arrived` (N,) is True for those that are
    inferred to have received it.
    """

    sent_ns: int
    u: float
    arrived: Bools


class Predictor:
    """The directions sent so far, each of which acts `dead_time_s` after it was sent.

    Before the first direction acts the robots stand still. A robot that did not receive a direction
    follows the previous one. `recent` holds the latest directions, and `before` (N,) [rad] the
    direction that each robot followed before the first of them, NaN for a robot that stood still.
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
        """Add a direction, assuming that every robot receives it."""
        self.recent.append(Sent(sent_ns, u, np.ones(self._count, dtype=np.bool_)))

    def held(self, since: int, until: int) -> list[Held]:
        """Return the directions that act from `since` to `until` [ns], oldest first."""
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
        """Drop the directions that stopped acting before the time `before` [ns]."""
        while len(self.recent) > 1 and self.recent[1].sent_ns + self.delay_ns <= before:
            dropped = self.recent.popleft()
            self.before = np.where(dropped.arrived, dropped.u, self.before)


def advance(problem: Problem, poses: Poses, held: list[Held]) -> Poses:
    """Return the poses of robots that start at `poses` and follow the directions `held`, by the
    problem's motion, bias and flow."""
    x, y, heading = poses.x, poses.y, poses.heading
    for since, until, u in held:
        seconds = (until - since) / SECOND
        x, y, heading = driven(problem, Poses(x, y, heading), u, seconds)
    return Poses(x, y, heading)


def driven(
    problem: Problem, start: Poses, direction: Floats, seconds: Floats | float
) -> tuple[Floats, Floats, Floats]:
    """Return x, y and heading (..., N) of robots that start at `start` and drive for `seconds`.

    `seconds` [s] is a number or an array (..., 1). Robots follow `direction` (N,) [rad], NaN for a
    robot that stands still.
    """
    stands = np.isnan(direction)
    moving = np.where(stands, 0.0, seconds)
    towards = np.where(stands, 0.0, direction)
    if problem.bias is not None:
        towards = towards + problem.bias
    step = MOTIONS.load(problem.motion).step
    x, y, heading = step(start.x, start.y, start.heading, towards, problem.a, problem.speed, moving)
    if problem.flow is not None:
        x, y = x + moving * problem.flow[:, 0], y + moving * problem.flow[:, 1]
    return x, y, heading
