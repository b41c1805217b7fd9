"""The list of the guard's checks: what each is asked, and what it may find. A device of other
robots brings a list of its own.

    MotionCheck   may a pose be its robot's, by the commands of the last 0.3 s?   Refuse, Moved
    DriftCheck    may the motion over the whole trial be that of its wheels?      Abort
    Keeps         does a robot leave the arena, enter an obstacle, touch another? Abort

That a body is lifted, or jumps, the guard itself asks of its `RobotTrack`.
"""

from collections.abc import Callable
from dataclasses import dataclass

from tetractl.core.protocols import GuardCheck
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import MotionCheck
from tetractl.lab.places import Keeps


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
    return GuardChecks((motion, drift, Keeps(rules)), drift)
