"""Where robots must not drive: out of the arena, and into obstacles.

Obstacles are grown by the radius of a body, so that they are compared with centres. Lengths are in
the spec's length unit.
"""

import math
from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Pose
from tetractl.core.setup import Bounds
from tetractl.core.shape import Shape
from tetractl.lab.motion_check import chord


class Places:
    """The arena and the grown obstacles. Robots are predicted over `reaction` [s]; `noise` is the
    largest error of a position."""

    def __init__(
        self, arena: Bounds, obstacles: Sequence[Shape], reaction: float, noise: float
    ) -> None:
        self._arena = arena
        self._obstacles = obstacles
        self._reaction = reaction
        self._noise = noise
        self._rates: tuple[Sequence[float], Sequence[float]] | None = None
        self._least: dict[int, float] = {}  # each robot's least depth in obstacles so far

    def restart(self) -> None:
        """Forget where the robots were; called when a run starts."""
        self._least.clear()

    def sent(self, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s]."""
        self._rates = speed, turning

    def outside(self, pose: Pose) -> float:
        """Return a pose's distance from the arena, 0 inside."""
        arena = self._arena
        return math.hypot(
            max(arena.left - pose.x, 0.0, pose.x - arena.right),
            max(arena.bottom - pose.y, 0.0, pose.y - arena.top),
        )

    def enters(self, i: int, pose: Pose) -> bool:
        """Return whether robot i is in an obstacle or will be after its reaction, at the rates of
        the last transmission. A robot that has touched one since the run started may leave it, but
        not go deeper.
        """
        depth = self._depth(pose.x, pose.y)
        least = self._least[i] = min(depth, self._least.get(i, depth))
        if least > -self._noise:
            return depth > max(least, 0.0) + self._noise
        return depth > 0.0 or self._depth(*self._ahead(i, pose)) > 0.0

    def _ahead(self, i: int, pose: Pose) -> tuple[float, float]:
        if self._rates is None:
            return pose.x, pose.y
        way, turned = (rate[i] * self._reaction for rate in self._rates)
        gone = way * chord(turned)
        course = pose.heading + turned / 2
        return pose.x + gone * math.cos(course), pose.y + gone * math.sin(course)

    def _depth(self, x: float, y: float) -> float:
        """Return how deep a centre is in an obstacle, negative outside; -inf if none is near."""
        deepest = -math.inf
        near = self._noise
        for shape in self._obstacles:
            left, bottom, right, top = shape.box
            if left - near <= x <= right + near and bottom - near <= y <= top + near:
                distance = shape.distance(np.array(x), np.array(y))
                deepest = max(deepest, -float(distance))
        return deepest
