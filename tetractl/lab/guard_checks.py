"""The list of the guard's checks: a device of other robots brings its own."""

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
