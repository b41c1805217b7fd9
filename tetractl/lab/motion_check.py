"""Checks whether robots move as commanded: compares a camera's poses with the transmissions.

A motion has three parts: the displacement along the robot's heading, that across it (positive to
the left), and the angle turned around. A command is a speed v and a turning rate w: a robot that
obeys it exactly has the rates v along, 0 across and w around.

Bounds. A robot has two wheels, each at a distance r from its centre. The sum of their speeds is 2 v
and the difference 2 w r. If each may be wrong by a fraction g of itself, v is wrong by up to
e = g max(|v|, |w| r), and w by up to e / r. So a command allows the rates

    along    v - e    to  v + e
    across     - e    to    + e      (a rolling robot does not move sideways: this is tolerance)
    around   w - e/r  to  w + e/r

For robots without wheels r is 0: then e = g |v|, and g |w| takes the place of e/r.

Which command a robot obeys is unknown: radio and wheels delay commands, and some are lost. From one
frame to the next, it may be any command that was the newest one at some time from DELAY_NS before
the one frame until the other. It may also be standing, with the rates 0, if this time begins before
the first transmission, or if a gap that reaches into it, between two transmissions or since the
last, is longer than WATCHDOG_NS. The *bounds* from one frame to the next are the least and the
greatest rates that any of these allows.

Comparison. The bounds are integrated over time, and the motion is added up from pose to pose; each
robot's integrals end at the time of its own pose. When a pose comes, each part of the motion must
lie between the integral of its least rate and that of its greatest, plus or minus a slack. This is
compared over several times: until now, since each moment that a `MotionWindow` keeps, of about the
last second. A pose that is out of bounds since any of them contradicts the commands; its motion is
not counted. Every other pose is *consistent*.

Repeats. A pose that equals the one before to the last bit may be that of a frozen picture. Let
bounds *exclude zero* if the rates along, or those around, are all positive or all negative. The
robot must have moved

    1. if the bounds up to the newest frame exclude zero, or
    2. if commands whose own bounds exclude zero have been in force for more than DELAY_NS in all
       since its pose changed: each from its transmission to the next, for WATCHDOG_NS at most.

The second rule finds a frozen picture though robots are stopped so often that they might always
stand by the first. If the camera measures on a grid, a pose may repeat while its robot moves: then,
in addition, the integrals since the pose changed must say that the robot has gone further than such
a camera may leave unseen (`MotionTolerance.unseen`).

Lengths are in the spec's length unit, angles rad, positive anticlockwise, times ns on the run's
clock. N is the number of robots. Arrays (..., 3) hold the parts along, across and around; arrays
(2, ...) the least and the greatest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNSTATED, Bools, Floats, Pose, Sight
from tetractl.lab.command_history import CommandHistory
from tetractl.lab.motion_faults import fault_of
from tetractl.lab.motion_window import BoundedMotion, MotionMoment, MotionWindow

DELAY_NS = 3 * SECOND // 10
"""Longest delay by radio, wheels and some lost commands."""
WATCHDOG_NS = SECOND // 4
"""Robots that received nothing for this time have stopped themselves."""
SLACK_S = 0.03
"""Time of driving at full speed that is allowed as slack, along and across."""
SLACK_RAD = 0.08
"""Angle that is allowed as slack."""


@dataclass(frozen=True, slots=True)
class MotionTolerance:
    """What is tolerated of each robot, for each part of its motion (N, 3)."""

    slack: Floats
    """By how much motion may be out of its bounds: along and across, what the robot drives at its
    greatest speed in SLACK_S, plus `noise`; around, SLACK_RAD plus twice the largest error of a
    heading."""
    unseen: Floats
    """How far a robot may move while its pose on a grid repeats: the diagonal of the grid's square,
    or a step of the heading, plus that slack without what it holds for errors of poses."""

    @classmethod
    def of(cls, speeds: Sequence[float], noise: float, sight: Sight, mm: float) -> Self:
        """Return the tolerance of robots; arguments as of MotionCheck."""
        robots = len(speeds)
        _, heading_error = sight.largest
        driven = SLACK_S * np.array(speeds)
        displaced = driven + noise
        turned = np.full(robots, SLACK_RAD + 2 * heading_error)
        slack = np.column_stack([displaced, displaced, turned])
        diagonal = math.sqrt(2) * sight.grid_mm / mm
        steps = np.array([diagonal, diagonal, sight.grid_rad])
        unseen = steps + np.column_stack([driven, driven, np.full(robots, SLACK_RAD)])
        return cls(slack, unseen)


class MotionSinceRest:
    """The motion of N robots since they started from rest: by consistent poses (N, 3), and the
    integrals of the bounds (2, N, 3), until now and until each robot's pose changed last. `slack`
    (N, 3) is by how much motion may be out of its bounds.
    """

    def __init__(self, slack: Floats) -> None:
        self.travelled = np.zeros_like(slack)
        self.integrals = np.zeros((2, *slack.shape))
        self.integrals_at_change = np.zeros((2, *slack.shape))
        self.windows = [MotionWindow(of_robot) for of_robot in slack]


class MotionCheck:
    """Compares the motion of N robots, whose greatest speeds are `speeds` (N,), with their
    commands.

    `radius` is r, 0 for robots without wheels. `noise` is the largest error of a position; the
    slack holds it once, though a motion has the errors of two. Both are in the spec's length unit,
    which has `mm` millimetres. `sight` is what the camera can see.

    `times` (N,) are those of the newest poses, 0 before the first frame. What is integrated from 0
    to that frame means nothing: the guard calls `restart` before it compares anything.

    For each frame call `take_frame`; then, for each pose, `take_pose` if its robot may have moved,
    or `must_have_moved` if the pose repeats.
    """

    def __init__(
        self,
        speeds: Sequence[float],
        radius: float,
        noise: float,
        sight: Sight = UNSTATED,
        mm: float = 1.0,
    ) -> None:
        robots = len(speeds)
        self.times = (0,) * robots
        self._radius = radius
        self._coarse = sight.coarse
        self._tolerance = MotionTolerance.of(speeds, noise, sight, mm)
        # the rates that each transmission allows (2, N, 3)
        self._commanded = CommandHistory(2, robots, 3)
        # the bounds (2, N, 3) up to the newest frame
        self._bounds = np.zeros((2, robots, 3))
        # for how long (N,) [s] commands that exclude zero have been in force since the last pose
        # of each robot was taken
        self._driven_s = np.zeros(robots)
        self._since_rest = MotionSinceRest(self._tolerance.slack)

    @property
    def travelled(self) -> Floats:
        """The motion (N, 3) since the robots started from rest, by consistent poses."""
        return self._since_rest.travelled

    def restart(self) -> None:
        """Forget the motion and its integrals; called when robots start from rest.

        A pose may repeat since before: what rule 2 counts is kept. The integrals since it changed,
        which a camera with a grid needs, begin at 0 again.
        """
        self._since_rest = MotionSinceRest(self._tolerance.slack)

    def forget(self, i: int) -> None:
        """Forget the moments of robot i: its next pose is taken as consistent, and the motion up to
        that is not counted. What is known of a repeated pose is kept."""
        self._since_rest.windows[i].clear()

    def sent(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float], share: float
    ) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s], and
        the relative error g of the wheels as `share`.
        """
        v = np.array(speed)
        w = np.array(turning)
        error = share * np.maximum(np.abs(v), np.abs(w) * self._radius)
        error_around = error / self._radius if self._radius else share * np.abs(w)
        exact = np.array([v, np.zeros_like(v), w]).T
        errors = np.array([error, error, error_around]).T
        self._commanded.sent(now_ns, np.array([exact - errors, exact + errors]))

    # ---- a frame ----

    def take_frame(self, times: tuple[int, ...]) -> None:
        """Take the times (N,) of a frame's poses, before `take_pose` is called for these.

        A robot that measures its own pose may have an earlier time than before: that of its last
        accepted pose, if a later one was refused and now none comes. Integrating backward then
        takes back what was added while the commands did not change. More than DELAY_NS back it does
        not: no command is found, and what follows is counted twice, as it always is by rule 2.
        """
        intervals = list(zip(self.times, times, strict=True))
        distinct = set(intervals)
        if len(distinct) == 1:  # all poses are of one exposure: no rows need be picked
            self._integrate(slice(None), *intervals[0])
        else:
            for interval in distinct:
                robots = [i for i, own in enumerate(intervals) if own == interval]
                self._integrate(robots, *interval)
        self.times = times

    def _integrate(self, robots: slice | list[int], since_ns: int, until_ns: int) -> None:
        """Integrate what commands allow some of the robots between the times of two poses."""
        bounds = self._bounds_between(since_ns, until_ns)[:, robots]
        self._bounds[:, robots] = bounds
        self._since_rest.integrals[:, robots] += bounds * ((until_ns - since_ns) / SECOND)
        self._driven_s[robots] += self._driven_between(since_ns, until_ns)[robots]

    def _bounds_between(self, since_ns: int, until_ns: int) -> Floats:
        """Return the bounds (2, N, 3) between two times, by all that robots may obey then.

        Gaps are those between transmissions; whether a robot received these is not known.
        """
        earliest_ns = since_ns - DELAY_NS
        times, rates = self._commanded.acting(earliest_ns, until_ns)
        gaps = (after - before for before, after in pairwise([*times, until_ns]))
        if not times or times[0] > earliest_ns or max(gaps) > WATCHDOG_NS:
            # robots may stand
            rates = np.concatenate([rates, np.zeros((1, *self._bounds.shape))])
        return np.array([rates[:, 0].min(axis=0), rates[:, 1].max(axis=0)])

    def _driven_between(self, since_ns: int, until_ns: int) -> Floats:
        """Return for how long (N,) [s] commands that exclude zero were in force between two times:
        each from its transmission to the next, for WATCHDOG_NS at most."""
        times, rates = self._commanded.acting(since_ns, until_ns)
        driven_s = np.zeros(len(self.times))
        in_force = pairwise([*times, until_ns])
        for (sent_ns, next_ns), bounds in zip(in_force, rates, strict=True):
            begins_ns = max(sent_ns, since_ns)
            ends_ns = min(next_ns, sent_ns + WATCHDOG_NS)
            if ends_ns > begins_ns:
                driven_s[exclude_zero(bounds)] += (ends_ns - begins_ns) / SECOND
        return driven_s

    # ---- a pose ----

    def must_have_moved(self, i: int) -> bool:
        """Return whether robot i, whose pose repeats, must have moved, and by as much as the camera
        can see: "Repeats" in the head of this module.

        Rule 1 asks the bounds of all commands together: if one drives forward and one backward, or
        one drives and one turns on the spot, these do not exclude zero though each moves the robot.
        """
        moves_now = bool(exclude_zero(self._bounds[:, i]))
        moved_long = bool(self._driven_s[i] > DELAY_NS / SECOND)
        if not moves_now and not moved_long:
            return False
        if not self._coarse:
            return True
        since_rest = self._since_rest
        least, most = since_rest.integrals[:, i] - since_rest.integrals_at_change[:, i]
        unseen = self._tolerance.unseen[i]
        return bool(np.any((least > unseen) | (most < -unseen)))

    def take_pose(self, i: int, before: Pose, pose: Pose) -> str:
        """Take a pose of robot i in the newest frame; `before` is the last consistent one. Return
        how it contradicts the commands, "" if it is consistent.

        The first pose after `restart` or `forget` is taken as consistent, and the motion up to it
        is not counted. Every pose counts as changed: repeats are only to be passed in pauses.
        """
        since_rest = self._since_rest
        window = since_rest.windows[i]
        integrals = since_rest.integrals[:, i].copy()
        since_rest.integrals_at_change[:, i] = integrals
        self._driven_s[i] = 0.0
        travelled = since_rest.travelled[i].copy()
        if not window.empty:
            travelled += motion(before, pose)
        now = MotionMoment.of(self.times[i], BoundedMotion(travelled, *integrals))
        contradiction = window.contradiction(now)
        if contradiction is not None:
            return fault_of(contradiction, self._tolerance.slack[i], has_wheels=self._radius > 0)
        since_rest.travelled[i] = travelled
        window.add(now)
        return ""


def exclude_zero(bounds: Floats) -> Bools:
    """Return whether bounds (2, ..., 3) exclude zero (...): whether the rates of a part are all
    positive or all negative. Those across never are."""
    least, most = bounds
    return ((least > 0.0) | (most < 0.0)).any(axis=-1)


def motion(before: Pose, pose: Pose) -> Floats:
    """Return the motion (3,) between two poses, on an arc: its length, the displacement across the
    heading halfway, and the angle turned. Of more than half a turn, as may be made in a long gap,
    the shorter way round is returned, which is wrong.
    """
    turned = math.remainder(pose.heading - before.heading, math.tau)
    middle = before.heading + turned / 2
    dx = pose.x - before.x
    dy = pose.y - before.y
    along = dx * math.cos(middle) + dy * math.sin(middle)
    across = dy * math.cos(middle) - dx * math.sin(middle)
    return np.array([along / chord(turned), across, turned])


def chord(turned: float) -> float:
    """Return the chord of an arc on which a robot turns by an angle, as a share of its length:
    sin(h) / h, where h is half the angle."""
    half = math.pi * (turned / math.tau)  # in this order, as numpy.sinc did for earlier logs
    return math.sin(half) / half if half else 1.0
