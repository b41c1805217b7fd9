"""The guard's checks of robots that stand still when they are stopped: each compares what the
camera shows with what was commanded. A device of other robots brings its own list.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Finding, Moved
from tetractl.core.poses import Pose
from tetractl.core.protocols import GuardCheck
from tetractl.experiment.lab_section import UNTRACKED_STOP_S
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_records import GuardRules
from tetractl.lab.motion_check import MotionCheck
from tetractl.lab.places import Keeps
from tetractl.lab.robot_track import TimedPose


@dataclass(frozen=True, slots=True)
class GuardChecks:
    """The checks of a kind of robots, in the order in which they are made. `drift` knows how the
    robots have moved over the trial: by it poses are carried on, and by it the guard says who is at
    fault. Robots that are stopped `together` share one signal: none of them can be held still while
    the others move."""

    checks: tuple[GuardCheck, ...]
    drift: DriftCheck
    together: bool = False


ChecksOf = Callable[[GuardRules], GuardChecks]
"""Makes the checks of a trial, which a device's section names."""


def robot_checks(rules: GuardRules) -> GuardChecks:
    """Return the checks of robots that stand still when they are stopped."""
    motion = MotionCheck(rules, rules.largest_error, rules.limits.wheel_error)
    drift = DriftCheck(rules, motion)
    return GuardChecks((motion, StandsInPauses(motion), drift, Keeps(rules)), drift)


class StandsInPauses(GuardCheck):
    """In a pause, a robot that has moved against its commands for UNTRACKED_STOP_S is noted: a stop
    may be lost and sent again."""

    def __init__(self, motion: MotionCheck) -> None:
        self._motion = motion
        # of robots that are seen to move: since when, and the pose where they stood
        self._straying: dict[int, TimedPose] = {}

    def start(self) -> None:
        """Forget what was seen before."""
        self._straying.clear()

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterator[Finding]:
        """Check a pose in a pause."""
        strays_since = self._straying.get(robot, TimedPose(now_ns, before))
        fault = self._motion.take_pose(robot, strays_since.pose, pose)
        if not fault:
            self._straying.pop(robot, None)
            return
        self._straying[robot] = strays_since
        if now_ns - strays_since.exposed_ns > UNTRACKED_STOP_S * SECOND:
            yield Moved(robot, fault)
