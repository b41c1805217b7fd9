"""The guard's checks of cells, which share one field, swim on without it and wander.

A cell cannot be stopped: one that does not swim as commanded is warned of, one that leaves is lost,
and one that meets an obstacle swims on. Two cells that come too close end the run.
"""

from collections.abc import Iterator, Sequence

from tetractl.core.guard_findings import Finding, Lose, RobotPlace, Warn
from tetractl.core.poses import Pose
from tetractl.core.protocols import GuardCheck
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_checks import GuardChecks
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import MotionCheck
from tetractl.lab.places import driven, outside, too_close

WANDERS = 0.7
"""Relative error of a cell's speed and turning rate: cells wander, by far more than wheels slip."""
NOISE = 0.0
"""Error of a cell's position [length unit], of which the slack of WANDERS is a multiple."""


def cell_checks(rules: GuardRules) -> GuardChecks:
    """Return the checks of cells."""
    swims = Swims(rules)
    return GuardChecks((swims, Stays(rules)), DriftCheck(rules, swims), together=True)


class Swims(MotionCheck):
    """The operator is warned of a cell that moves as no command does, and it is compared again."""

    def __init__(self, rules: GuardRules) -> None:
        super().__init__(rules, NOISE, WANDERS)
        self._names = rules.names

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Check a pose in a run."""
        fault = self.take_pose(robot, before, pose)
        if fault:
            self.replace(robot)
            yield Warn(f"{self._names[robot]} {fault}")

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> tuple[Finding, ...]:
        """Find nothing: cells swim on."""
        return ()


class Stays(GuardCheck):
    """A cell that leaves the arena is lost; the run is aborted if two come too close."""

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules

    def tick(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Check where the robots are."""
        now: dict[str, Pose] = {}
        then: dict[str, Pose] = {}
        for i, robot in enumerate(robots):
            if robot.pose is None or robot.lost:
                continue
            name = self._rules.names[i]
            now[name] = robot.pose
            then[name] = driven(robot.pose, robot.way)
            if outside(self._rules.arena, then[name]) > outside(self._rules.arena, robot.pose):
                yield Lose(i, f"{name} is about to leave the arena")
        yield from too_close(now, then, self._rules)
