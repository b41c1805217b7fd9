"""The poses of robots when the next signal acts, predicted by their motion and what was sent."""

from collections import deque

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Sent
from tetractl.core.plan import Problem
from tetractl.core.poses import Observation, Poses
from tetractl.core.registries import MOTIONS


class Acting:
    """The signals sent to the robots of a `problem` with an intensity, each of which acts
    `dead_time_s` [s] after the exposure of the frame on which it was decided."""

    def __init__(self, problem: Problem, dead_time_s: float) -> None:
        self._problem, self._motion = problem, MOTIONS.load(problem.motion)
        self._delay_ns = round(dead_time_s * SECOND)
        self._acting = deque[tuple[int, Sent]]()  # from when on [ns]
        self._newest = 0, problem.poses  # of the last frame: when it was exposed [ns], and where

    def sent(self, command: Sent, sampled_ns: int) -> None:
        """Add a signal decided on a frame exposed at `sampled_ns`."""
        self._acting.append((sampled_ns + self._delay_ns, command))

    def ahead(self, observation: Observation) -> Poses:
        """Return the poses at which a signal decided on a frame begins to act; a robot that the
        frame does not show is predicted from the last that did."""
        now, seen = observation.sampled_ns, observation.poses.array()
        if not observation.valid.all():
            unseen = self._onwards(*self._newest, now).array()
            seen = np.where(observation.valid[:, None], seen, unseen)
        self._newest = now, Poses.of(seen)
        while len(self._acting) > 1 and self._acting[1][0] <= now:
            self._acting.popleft()
        return self._onwards(*self._newest, now + self._delay_ns)

    def _onwards(self, begin: int, poses: Poses, end: int) -> Poses:
        """Return the poses at `end` [ns] of robots that were at `poses` at `begin`."""
        until = [*(since for since, _ in self._acting), end][1:]
        for (since, command), next_ns in zip(self._acting, until, strict=False):
            seconds = (min(next_ns, end) - max(since, begin)) / SECOND
            if seconds > 0:
                poses = self._moved(poses, command, seconds)
        return poses

    def _moved(self, poses: Poses, command: Sent, seconds: float) -> Poses:
        problem, of = self._problem, self._problem.intensity
        assert of is not None
        if command.direction is None or command.intensity is None:
            return poses
        a, v = problem.a, problem.speed
        a, v = self._motion.under(np.array(command.intensity / of.reference), a, v)
        at = poses.x, poses.y, poses.heading
        return Poses(*self._motion.step(*at, np.array(command.direction), a, v, seconds))
