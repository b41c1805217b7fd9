"""Where the robots will be when a command acts: the state predicted over the dead time."""

from collections import deque

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Poses
from tetractl.core.problem import Problem
from tetractl.experiment.kinds import MOTIONS

Held = tuple[int, int, float]
"""A direction u [rad] and the times from and until which it acts [ns]."""


class Predictor:
    """The directions sent so far, each of which acts `dead_time` [s] after the frame it answers.

    Before the first one acts the robots stand still.
    """

    def __init__(self, dead_time: float) -> None:
        self.delay = round(dead_time * SECOND)
        self._acting: deque[tuple[int, float]] = deque()  # (from when it acts [ns], u [rad])

    def sent(self, sampled_ns: int, direction: float) -> None:
        """Add a direction u [rad] sent in answer to the frame exposed at `sampled_ns`."""
        self._acting.append((sampled_ns + self.delay, direction))

    def held(self, since: int, until: int) -> list[Held]:
        """Return the directions that act between two times [ns], oldest first."""
        ends = [when for when, _ in self._acting][1:]
        spans = zip(self._acting, [*ends, until], strict=False)
        found = ((max(start, since), min(end, until), u) for (start, u), end in spans)
        return [(start, end, u) for start, end, u in found if end > start]

    def ahead(self, problem: Problem, sampled_ns: int) -> Poses:
        """Return the predicted poses at the time when a direction decided on this frame acts."""
        return advance(problem, problem.poses, self.held(sampled_ns, sampled_ns + self.delay))

    def forget(self, before: int) -> None:
        """Drop the directions that stopped acting before a time [ns]."""
        while len(self._acting) > 1 and self._acting[1][0] <= before:
            self._acting.popleft()


def advance(problem: Problem, poses: Poses, held: list[Held]) -> Poses:
    """Return the poses after the directions held, by the problem's motion."""
    step = MOTIONS.load(problem.motion).step
    x, y, heading = poses.x, poses.y, poses.heading
    for since, until, direction in held:
        seconds = (until - since) / SECOND
        u = np.array(direction)
        x, y, heading = step(x, y, heading, u, problem.a, problem.speed, seconds)
    return Poses(x, y, heading)
