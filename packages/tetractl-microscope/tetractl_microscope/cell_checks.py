"""The guard's checks of cells, which share one field, swim on without it and wander.

A cell cannot be stopped: one that does not swim as commanded is warned of, one that leaves is lost,
and one that meets an obstacle swims on. Two cells that come too close end the run.
"""

from collections.abc import Iterator, Sequence

from tetractl.core.guard_findings import Finding, Lose, RobotPlace, Warn
from tetractl.core.poses import Pose
from tetractl.lab.guard_checks import (
    Check,
    Coming,
    GuardChecks,
    drift_of,
    driven,
    places_of,
    too_close,
)
from tetractl.lab.guard_records import GuardRules
from tetractl.lab.motion_check import MotionCheck

WANDERS = 0.7
"""Relative error of a cell's speed and turning rate: cells wander, by far more than wheels slip."""
NOISE = 0.0
"""Error of a cell's position [length unit], of which the slack of WANDERS is a multiple."""


def cell_checks(rules: GuardRules) -> GuardChecks:
    """Return the checks of cells."""
    motion = MotionCheck(rules.speeds, rules.wheel_radius, NOISE, rules.sight, rules.mm)
    checks = Swims(motion, rules), Stays(rules)
    return GuardChecks(checks, motion, drift_of(rules), together=True)


class Swims(Check):
    """The operator is warned of a cell that moves as no command does, and it is compared again."""

    def __init__(self, motion: MotionCheck, rules: GuardRules) -> None:
        self._motion = motion
        self._names = rules.names

    def start(self) -> None:
        """Forget what was seen before."""
        self._motion.restart()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission."""
        self._motion.sent(now_ns, speed, turning, WANDERS)

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Check a pose in a run."""
        fault = self._motion.take_pose(robot, before, pose)
        if fault:
            self._motion.forget(robot)
            yield Warn(f"{self._names[robot]} {fault}")


class Stays(Check):
    """A cell that leaves the arena is lost; the run is aborted if two come too close."""

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules
        self._places = places_of(rules)

    def tick(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Check where the robots are."""
        coming: list[Coming] = []
        for i, robot in enumerate(robots):
            if robot.pose is None:
                continue
            name = self._rules.names[i]
            then = driven(robot.pose, robot.way)
            if self._places.outside(then) > self._places.outside(robot.pose):
                yield Lose(i, f"{name} is about to leave the arena")
            coming.append(Coming(name, robot.pose, then))
        yield from too_close(coming, self._rules)
