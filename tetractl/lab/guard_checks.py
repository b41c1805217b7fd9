"""The list of checks that the guard makes, and the findings that each of them may report.

A device for other kinds of robots brings its own list.

    MotionCheck   do the commands of the last `delay` explain a pose?              Refuse, Moved
    DriftCheck    can wheels have caused the motion over the whole trial?          Abort
    PlaceCheck    does a robot leave the arena, enter an obstacle, touch another?  Abort

`PlaceCheck` belongs to the guard's kernel (`lab.kernel`). The other two are statistical. In
addition, the guard's `RobotTrack` checks whether a body is lifted, or jumps.
"""

from collections.abc import Callable
from dataclasses import dataclass

from tetractl.core.guard_check import GuardCheck
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import PlaceCheck
from tetractl.lab.motion_check import MotionCheck


@dataclass(frozen=True, slots=True)
class GuardChecks:
    """All checks that the guard makes for one kind of robots, such as robots on wheels.

    Attributes:
        checks: The checks, in the order in which they are made.
        drift: Follows how the robots move over the trial. It predicts poses, and the guard uses it
            to find the cause of an abort.
        together: Whether robots share one signal, so that no robot can be stopped while the others
            move.
    """

    checks: tuple[GuardCheck, ...]
    drift: DriftCheck
    together: bool = False


ChecksOf = Callable[[GuardRules], GuardChecks]
"""A function that creates the checks of a trial. The section of a device names it."""


def robot_checks(rules: GuardRules) -> GuardChecks:
    """Create the checks for robots on wheels, which stand still when they are stopped.

    Args:
        rules: The rules of the guard.
    """
    motion = MotionCheck(rules, rules.position_error_max, rules.limits.wheel_error)
    drift = DriftCheck(rules, motion)
    return GuardChecks((motion, drift, PlaceCheck(rules)), drift)
