"""Where robots must not drive: out of the arena, into obstacles, and into each other.

Obstacles are grown by the radius of a body, so that they are compared with centres. Lengths are in
the spec's length unit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tetractl.core.guard_findings import Abort, Finding, RobotPlace
from tetractl.core.poses import Pose
from tetractl.core.protocols import GuardCheck
from tetractl.core.setup import Bounds
from tetractl.lab.guard_rules import GuardRules
from tetractl.model.motion.rolling import rolled


class Keeps(GuardCheck):
    """A check that aborts a run before a robot leaves the arena, hits an obstacle or another robot.

    A lost robot counts as standing at its last pose.
    """

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules
        self._largest_error = rules.largest_error
        self._speeds: Sequence[float] = (0.0,) * len(rules.names)  # of the last transmission
        self._turning: Sequence[float] = (0.0,) * len(rules.names)
        self._least: dict[int, float] = {}  # each robot's least depth in obstacles so far

    def start(self) -> None:
        """Forget where the robots were."""
        self._least.clear()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take note of a transmission; see `GuardCheck.sent`."""
        self._speeds = speed
        self._turning = turning

    def tick(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Check where the robots are."""
        arena = self._rules.arena
        now: dict[str, Pose] = {}
        then: dict[str, Pose] = {}
        for i, robot in enumerate(robots):
            name = self._rules.names[i]
            pose = robot.pose
            if pose is None:
                continue
            now[name] = pose
            then[name] = driven(pose, robot.way)
            if outside(arena, then[name]) > outside(arena, pose):
                yield Abort(f"{name} is about to leave the arena")
            if self.enters(i, pose):
                yield Abort(f"{name} is about to enter an obstacle")
        yield from too_close(now, then, self._rules)

    def enters(self, i: int, pose: Pose) -> bool:
        """Check whether robot i is in an obstacle, or will be after its reaction time.

        The prediction uses the rates of the last transmission. A robot that has touched an obstacle
        since the run started may leave it, but not go deeper.
        """
        noise = self._largest_error
        depth = self._depth(pose.x, pose.y)
        least = self._least[i] = min(depth, self._least.get(i, depth))
        if least > -noise:
            return depth > max(least, 0.0) + noise
        if depth > 0.0:
            return True
        reaction_s = self._rules.limits.reaction
        turned = self._turning[i] * reaction_s
        dx, dy = rolled(pose.heading, turned, self._speeds[i] * reaction_s)
        return self._depth(pose.x + dx, pose.y + dy) > 0.0

    def _depth(self, x: float, y: float) -> float:
        """Return how deep a centre is in an obstacle. Negative outside, -inf if none is near."""
        deepest = -math.inf
        near = self._largest_error
        for shape in self._rules.obstacles:
            left, bottom, right, top = shape.box
            if left - near <= x <= right + near and bottom - near <= y <= top + near:
                distance = shape.distance(np.array(x), np.array(y))
                deepest = max(deepest, -float(distance))
        return deepest


def outside(arena: Bounds, pose: Pose) -> float:
    """Return a pose's distance from the arena, 0 inside."""
    return math.hypot(
        max(arena.left - pose.x, 0.0, pose.x - arena.right),
        max(arena.bottom - pose.y, 0.0, pose.y - arena.top),
    )


def driven(pose: Pose, way: float) -> Pose:
    """Return a pose moved along its heading by `way`."""
    dx = way * math.cos(pose.heading)
    dy = way * math.sin(pose.heading)
    return Pose(pose.x + dx, pose.y + dy, pose.heading)


def too_close(
    now: Mapping[str, Pose], then: Mapping[str, Pose], rules: GuardRules
) -> Iterator[Finding]:
    """Find pairs of robots that come closer than the minimum distance.

    Args:
        now: Present poses, by robot.
        then: Poses when the robots could be stopped, by robot.
        rules: The limits.

    Yields:
        An abort for each pair.
    """
    names = list(now)
    for i, name in enumerate(names):
        for neighbour in names[:i]:
            gap = now[name].distance_to(now[neighbour])
            gap_then = then[name].distance_to(then[neighbour])
            if gap_then <= gap and gap_then * rules.mm < rules.limits.separation_mm:
                yield Abort(f"{neighbour} and {name} are too close: {gap * rules.mm:.0f} mm")
