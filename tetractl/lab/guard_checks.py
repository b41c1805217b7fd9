"""The guard's checks of robots that stand still when they are stopped: each compares what the
camera shows with what was commanded. A device of other robots brings its own list.

Lengths are in the spec's length unit, times ns on the run's clock.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Abort, Finding, Moved, Refuse, RobotPlace
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
    """The checks of a kind of robots, in the order in which they are made, and the two that the
    guard itself asks about motion. Robots that are stopped `together` share one signal: none of
    them can be held still while the others move."""

    checks: tuple[GuardCheck, ...]
    motion: MotionCheck
    drift: DriftCheck
    together: bool = False


ChecksOf = Callable[[GuardRules], GuardChecks]
"""Makes the checks of a trial, which a device's section names."""


def robot_checks(rules: GuardRules) -> GuardChecks:
    """Return the checks of robots that stand still when they are stopped."""
    noise = largest_error(rules)
    motion = MotionCheck(rules.speeds, rules.wheel_radius, noise, rules.sight, rules.mm)
    drift = drift_of(rules)
    checks = (
        Obeys(motion, rules),
        StandsInPauses(motion),
        DrivesSteadily(motion, drift),
        Keeps(rules),
    )
    return GuardChecks(checks, motion, drift)


def largest_error(rules: GuardRules) -> float:
    """Return the largest error of a position [length unit]."""
    return (NOISE_MM + rules.sight.largest[0]) / rules.mm


def drift_of(rules: GuardRules) -> DriftCheck:
    """Return the check of motion over the whole trial."""
    error = rules.limits.wheel_error
    return DriftCheck(rules.names, rules.wheel_radius, rules.mm, error, rules.sight)


def places_of(rules: GuardRules) -> Places:
    """Return where the robots must not drive."""
    return Places(rules.arena, rules.obstacles, rules.limits.reaction, largest_error(rules))


class Check:
    """A check that finds nothing; each check below answers some of its questions, which are those
    of `tetractl.core.protocols.GuardCheck`."""

    def start(self) -> None:
        """Forget what was seen before."""

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission."""

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Check a pose in a run."""
        yield from ()

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterator[Finding]:
        """Check a pose in a pause."""
        yield from ()

    def frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> Iterator[Finding]:
        """Check the accepted poses of a frame."""
        yield from ()

    def tick(self, robots: Sequence[RobotPlace]) -> Iterator[Finding]:
        """Check where the robots are at a tick."""
        yield from ()


class Obeys(Check):
    """A pose is refused if it moves as no command of the last 0.3 s does."""

    def __init__(self, motion: MotionCheck, rules: GuardRules) -> None:
        self._motion = motion
        self._wheel_error = rules.limits.wheel_error

    def start(self) -> None:
        """Forget what was seen before."""
        self._motion.restart()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission."""
        self._motion.sent(now_ns, speed, turning, self._wheel_error)

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Check a pose in a run."""
        fault = self._motion.take_pose(robot, before, pose)
        if fault:
            yield Refuse(robot, fault)


@dataclass(frozen=True, slots=True)
class Straying:
    """Since when a robot has been seen to move in a pause [ns], and its last pose before."""

    since_ns: int
    before: Pose


class StandsInPauses(Check):
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


class DrivesSteadily(Check):
    """The run is aborted if motion over the whole trial is none that wheels can make."""

    def __init__(self, motion: MotionCheck, drift: DriftCheck) -> None:
        self._motion = motion
        self._drift = drift

    def start(self) -> None:
        """Forget what was seen before."""
        self._drift.rest()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission."""
        self._drift.sent(now_ns, speed, turning)

    def frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> Iterator[Finding]:
        """Check the accepted poses of a frame."""
        fault = self._drift.frame(now_ns, times, poses, self._motion.travelled)
        if fault.text:
            suspect = fault.false[0] if len(fault.false) == 1 else None
            yield Abort(fault.text, fault.false, suspect)


class Keeps(Check):
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
