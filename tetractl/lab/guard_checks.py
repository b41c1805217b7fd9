"""The guard's checks of robots that stand still when they are stopped: each compares what the
camera shows with what was commanded. A device of other robots brings its own list.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Abort, Finding, Moved, RobotPlace
from tetractl.core.poses import Pose
from tetractl.core.protocols import GuardCheck
from tetractl.experiment.lab_section import UNTRACKED_STOP_S
from tetractl.lab.drift_check import DriftCheck
from tetractl.lab.guard_records import GuardRules
from tetractl.lab.motion_check import MotionCheck
from tetractl.lab.places import Places

NOISE_MM = 2.0
"""Largest error of a pose [mm], in addition to that which the camera's section states."""


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
    wheel_error = rules.limits.wheel_error
    noise = largest_error(rules)
    motion = MotionCheck(
        rules.speeds, rules.wheel_radius, noise, wheel_error, rules.sight, rules.mm
    )
    drift = drift_of(rules, motion)
    return GuardChecks((motion, StandsInPauses(motion), drift, Keeps(rules)), drift)


def largest_error(rules: GuardRules) -> float:
    """Return the largest error of a position [length unit]."""
    return (NOISE_MM + rules.sight.largest[0]) / rules.mm


def drift_of(rules: GuardRules, motion: MotionCheck) -> DriftCheck:
    """Return the check of motion over the whole trial."""
    error = rules.limits.wheel_error
    return DriftCheck(rules.names, rules.wheel_radius, rules.mm, error, motion, rules.sight)


def places_of(rules: GuardRules) -> Places:
    """Return where the robots must not drive."""
    return Places(rules.arena, rules.obstacles, rules.limits.reaction, largest_error(rules))


@dataclass(frozen=True, slots=True)
class Straying:
    """Since when a robot has been seen to move in a pause [ns], and its last pose before."""

    since_ns: int
    before: Pose


class StandsInPauses(GuardCheck):
    """In a pause, a robot that has moved against its commands for UNTRACKED_STOP_S is noted: a stop
    may be lost and sent again."""

    def __init__(self, motion: MotionCheck) -> None:
        self._motion = motion
        self._straying: dict[int, Straying] = {}

    def start(self) -> None:
        """Forget what was seen before."""
        self._straying.clear()

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterator[Finding]:
        """Check a pose in a pause."""
        straying = self._straying.get(robot, Straying(now_ns, before))
        fault = self._motion.take_pose(robot, straying.before, pose)
        if not fault:
            self._straying.pop(robot, None)
            return
        self._straying[robot] = straying
        if now_ns - straying.since_ns > UNTRACKED_STOP_S * SECOND:
            yield Moved(robot, fault)


class Keeps(GuardCheck):
    """The run is aborted before a robot leaves the arena, enters an obstacle or touches another;
    one that was lost stands at its last pose."""

    def __init__(self, rules: GuardRules) -> None:
        self._rules = rules
        self._places = places_of(rules)

    def start(self) -> None:
        """Forget what was seen before."""
        self._places.restart()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission."""
        self._places.sent(speed, turning)

    def tick(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Check where the robots are."""
        coming: list[Coming] = []
        for i, robot in enumerate(robots):
            name = self._rules.names[i]
            pose = robot.last if robot.lost else robot.pose
            if pose is None:
                continue
            then = driven(pose, robot.way)
            if self._places.outside(then) > self._places.outside(pose):
                yield Abort(f"{name} is about to leave the arena")
            if self._places.enters(i, pose):
                yield Abort(f"{name} is about to enter an obstacle")
            coming.append(Coming(name, pose, then))
        yield from too_close(coming, self._rules)


@dataclass(frozen=True, slots=True)
class Coming:
    """A robot where it is now, and where it will be when it can be stopped."""

    name: str
    now: Pose
    then: Pose


def driven(pose: Pose, way: float) -> Pose:
    """Return a pose moved along its heading by `way`."""
    dx = way * math.cos(pose.heading)
    dy = way * math.sin(pose.heading)
    return Pose(pose.x + dx, pose.y + dy, pose.heading)


def too_close(coming: Sequence[Coming], rules: GuardRules) -> Iterator[Finding]:
    """Yield an abort for each two robots that come nearer than the least distance."""
    for i, robot in enumerate(coming):
        for neighbour in coming[:i]:
            now = distance(robot.now, neighbour.now)
            then = distance(robot.then, neighbour.then)
            if then <= now and then * rules.mm < rules.limits.separation_mm:
                yield Abort(
                    f"{neighbour.name} and {robot.name} are too close: {now * rules.mm:.0f} mm"
                )


def distance(first: Pose, second: Pose) -> float:
    """Return the distance of two poses."""
    return math.hypot(first.x - second.x, first.y - second.y)
