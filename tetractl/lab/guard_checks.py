"""The list of the guard's checks, and what each of them may find.

A device for other robots brings its own list.

    MotionCheck   may a pose be its robot's, by the commands of the last `delay`?  Refuse, Moved
    DriftCheck    may the motion over the whole trial be that of its wheels?      Abort
    Places        does a robot leave the arena, enter an obstacle, touch another? Abort

`Places` belongs to the guard's kernel (`lab.kernel`), the other two are statistical. The guard
itself checks with its `RobotTrack` whether a body is lifted, or jumps.
"""

from collections.abc import Callable
from dataclasses import dataclass

from tetractl.core.guard_check import GuardCheck
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.kernel import Places
from tetractl.lab.motion_check import MotionCheck


@dataclass(frozen=True, slots=True)
class GuardChecks:
    """The checks for a kind of robots.

    Attributes:
        checks: The checks, in the order in which they are made.
        drift: Knows how the robots have moved over the trial. It predicts poses, and the guard uses
            it to find the cause of an abort.
        together: Whether robots share one signal, so that none can be held still while the others
            move.
    """

    checks: tuple[GuardCheck, ...]
    drift: DriftCheck
    together: bool = False


ChecksOf = Callable[[GuardRules], GuardChecks]
"""Makes the checks of a trial, which a device's section names."""


def robot_checks(rules: GuardRules) -> GuardChecks:
    """Return the checks of robots that stand still when they are stopped."""
    motion = MotionCheck(rules, rules.largest_error, rules.limits.wheel_error)
    drift = DriftCheck(rules, motion)
    return GuardChecks((motion, drift, Places(rules)), drift)
