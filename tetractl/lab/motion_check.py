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
compared over several times: until now, since each of the *moments* of about the last second, which
are those of consistent poses, SPACING_NS apart or more. A pose that is out of bounds since any of
them contradicts the commands; its motion is not counted. Every other pose is *consistent*.

Repeats. A pose that equals the one before to the last bit may be that of a frozen picture. Let
bounds *exclude zero* if the rates along, or those around, are all positive or all negative. The
robot must have moved

    1. if the bounds up to the newest frame exclude zero, or
    2. if commands whose own bounds exclude zero have been in force for more than DELAY_NS in all
       since its pose changed: each from its transmission to the next, for WATCHDOG_NS at most.

The second rule finds a frozen picture though robots are stopped so often that they might always
stand by the first. If the camera measures on a grid, a pose may repeat while its robot moves: then,
in addition, the integrals since the pose changed must say that the robot has gone further than such
a camera may leave unseen.

Lengths are in the spec's length unit, angles rad, positive anticlockwise, times ns on the run's
clock. N is the number of robots. Arrays (..., 3) hold the parts along, across and around; arrays
(2, ...) the least and the greatest; of arrays (3, 3) the rows are the motion, the least and the
greatest.
"""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.guard_findings import Finding, Moved, Refuse
from tetractl.core.poses import Bools, Floats, Pose
from tetractl.core.protocols import GuardCheck
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import UNTRACKED_STOP_S

ROOM = 256
"""Transmissions for which a history has room at first."""
DELAY_NS = 3 * SECOND // 10
"""Longest delay by radio, wheels and some lost commands."""
WATCHDOG_NS = SECOND // 4
"""Robots that received nothing for this time have stopped themselves."""
SLACK_S = 0.03
"""Time of driving at full speed that is allowed as slack, along and across."""
SLACK_RAD = 0.08
"""Angle that is allowed as slack."""
COMPARED_NS = SECOND
"""Age up to which a moment is kept."""
SPACING_NS = SECOND // 20
"""Least time between two moments."""
STANDS_SHARE = 0.3
"""A robot that makes less than this share of the commanded motion stands still."""
MEANT_SHARE = 0.3
"""If less than this share of the motion is commanded, its direction is not wrong: a disturbance
moves the robot."""

REPEATS = "its pose repeats to the last bit though it is commanded to move: is the camera frozen?"
DOES_NOT_MOVE = (
    "does not move though commanded to: is a wheel stuck, is the robot on its back or "
    "without power or link, or is the camera frozen?"
)
BACKWARD = "moves backward: is its heading offset wrong, or its drive inverted?"
WRONG_WAY = "turns the wrong way: is its drive swapped or inverted?"
OF_CELLS = {
    DOES_NOT_MOVE: "does not swim: is it stuck or dead, or is the camera frozen?",
    BACKWARD: "moves backward: is its heading reversed, or another cell tracked in its place?",
    WRONG_WAY: "turns away from the field: is the camera's rotation or the field's sign wrong?",
}
"""What is said instead of robots without wheels."""
AS_NO_COMMAND = "as no command does"
PUSHED = ": was it pushed, or does the camera track another body as this robot?"
ANOTHER = f"moves {{}} {AS_NO_COMMAND}{PUSHED}"
"""Holds a place for one of KINDS."""
KINDS = ("along its heading", "sideways", "around")
"""The names of a motion's three parts."""


class CommandHistory:
    """Rates in arrays of a `shape`, each commanded from its transmission until the next; 0 before
    the first.
    """

    def __init__(self, *shape: int) -> None:
        self._none = np.zeros(shape)
        self._times: list[int] = []
        self._sent = np.zeros((ROOM, *shape))  # of which the first rows are used

    def sent(self, now_ns: int, rates: Sequence[float] | Floats) -> None:
        """Take the rates of a transmission."""
        count = len(self._times)
        if count == len(self._sent):
            self._sent = np.concatenate([self._sent, np.zeros_like(self._sent)])
        self._sent[count] = rates
        self._times.append(now_ns)
        old = bisect_right(self._times, now_ns - 2 * SECOND)
        if old > 64:  # old entries are removed occasionally, all at once
            self._sent[: count + 2 - old] = self._sent[old - 1 : count + 1].copy()
            del self._times[: old - 1]

    def acting(self, since_ns: int, until_ns: int) -> tuple[list[int], Floats]:
        """Return the transmissions of which one acted between two times: times (K,), and rates (K,
        ...), a view."""
        first = max(0, bisect_right(self._times, since_ns) - 1)
        last = bisect_right(self._times, until_ns)
        return self._times[first:last], self._sent[first:last]

    def mean(self, until_ns: int, dt_ns: int) -> Floats:
        """Return the mean of the rates commanded during the `dt_ns` before a time."""
        first = until_ns - dt_ns
        k = bisect_left(self._times, until_ns) - 1
        if k >= 0 and self._times[k] <= first:  # the most frequent case
            return self._sent[k] * dt_ns / dt_ns
        total = self._none
        while k >= 0:
            since = max(self._times[k], first)
            total = total + self._sent[k] * (until_ns - since)
            if since == first:
                break
            until_ns = since
            k = bisect_left(self._times, since) - 1
        return total / dt_ns


class MotionSinceRest:
    """The motion of N robots since they started from rest: by consistent poses (N, 3), and the
    integrals of the bounds (2, N, 3), until now and until each robot's pose changed last.

    `moments` are each robot's, oldest first: a time, and the motion and integrals (3, 3) until
    then. Those older than COMPARED_NS are dropped when a consistent pose is added. This is after it
    was compared: the first pose after a gap is compared with older moments too.
    """

    def __init__(self, robots: int) -> None:
        self.travelled = np.zeros((robots, 3))
        self.integrals = np.zeros((2, robots, 3))
        self.integrals_at_change = np.zeros((2, robots, 3))
        self.moments = [deque[tuple[int, Floats]]() for _ in range(robots)]


class MotionCheck(GuardCheck):
    """Refuses a pose if it moves as no command of the last 0.3 s does, of the N robots of `rules`;
    in a pause, says which robot has moved so for UNTRACKED_STOP_S: a stop may be lost and sent
    again.

    `share` is the relative error g of the wheels. `noise` is the largest error of a position
    [length unit]; the slack holds it once, though a motion has the errors of two.
    """

    def __init__(self, rules: GuardRules, noise: float, share: float) -> None:
        robots = len(rules.speeds)
        self._radius = rules.wheel_radius
        self._share = share
        self._coarse = rules.sight.coarse
        driven = SLACK_S * np.array(rules.speeds)
        heading_error = rules.sight.largest_error_rad
        # by how much each part of a motion may be out of its bounds (N, 3)
        self._slack = np.column_stack(
            [driven + noise, driven + noise, np.full(robots, SLACK_RAD + 2 * heading_error)]
        )
        # how far (N, 3) a robot may move while its pose on a grid repeats: the diagonal of the
        # grid's square, or a step of the heading, and the slack without the errors of poses
        diagonal = math.sqrt(2) * rules.sight.grid_mm / rules.mm
        steps = np.array([diagonal, diagonal, rules.sight.grid_rad])
        self._unseen = steps + np.column_stack([driven, driven, np.full(robots, SLACK_RAD)])
        # times (N,) of the newest poses, 0 before the first frame: what is integrated from 0 to
        # that frame means nothing, as robots start from rest before anything is compared
        self._times = (0,) * robots
        # the rates that each transmission allows (2, N, 3)
        self._commanded = CommandHistory(2, robots, 3)
        # the bounds (2, N, 3) up to the newest frame
        self._bounds = np.zeros((2, robots, 3))
        # for how long (N,) [s] commands that exclude zero have been in force since the last pose
        # of each robot was taken
        self._driven_s = np.zeros(robots)
        self._since_rest = MotionSinceRest(robots)
        # of robots that are seen to move in a pause: since when, and the pose where they stood
        self._straying: dict[int, TimedPose] = {}

    @property
    def travelled(self) -> Floats:
        """The motion (N, 3) since the robots started from rest, by consistent poses."""
        return self._since_rest.travelled

    def start(self) -> None:
        """Forget the motion and its integrals: robots start from rest.

        A pose may repeat since before: what rule 2 counts is kept. The integrals since it changed,
        which a camera with a grid needs, begin at 0 again.
        """
        self._since_rest = MotionSinceRest(len(self._times))
        self._straying.clear()

    def replace(self, robot: int) -> None:
        """Forget the moments of a robot: its next pose is taken as consistent, and the motion up to
        that is not counted. What is known of a repeated pose is kept."""
        self._since_rest.moments[robot].clear()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s]."""
        v = np.array(speed)
        w = np.array(turning)
        error = self._share * np.maximum(np.abs(v), np.abs(w) * self._radius)
        error_around = error / self._radius if self._radius else self._share * np.abs(w)
        exact = np.array([v, np.zeros_like(v), w]).T
        errors = np.array([error, error, error_around]).T
        self._commanded.sent(now_ns, np.array([exact - errors, exact + errors]))

    # ---- a frame ----

    def exposed(self, times: tuple[int, ...]) -> None:
        """Take the times (N,) of a frame's poses, before these are compared.

        A robot that measures its own pose may have an earlier time than before: that of its last
        accepted pose, if a later one was refused and now none comes. Integrating backward then
        takes back what was added while the commands did not change. More than DELAY_NS back it does
        not: no command is found, and what follows is counted twice, as it always is by rule 2.
        """
        intervals = list(zip(self._times, times, strict=True))
        distinct = set(intervals)
        if len(distinct) == 1:  # all poses are of one exposure: no rows need be picked
            self._integrate(slice(None), *intervals[0])
        else:
            for interval in distinct:
                robots = [i for i, of_robot in enumerate(intervals) if of_robot == interval]
                self._integrate(robots, *interval)
        self._times = times

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
        driven_s = np.zeros(len(self._times))
        in_force = pairwise([*times, until_ns])
        for (sent_ns, next_ns), bounds in zip(in_force, rates, strict=True):
            begins_ns = max(sent_ns, since_ns)
            ends_ns = min(next_ns, sent_ns + WATCHDOG_NS)
            if ends_ns > begins_ns:
                driven_s[exclude_zero(bounds)] += (ends_ns - begins_ns) / SECOND
        return driven_s

    # ---- a pose ----

    def repeat(self, robot: int) -> Iterator[Finding]:
        """Refuse a pose that repeats if its robot must have moved, and by as much as the camera can
        see: "Repeats" in the head of this module.

        Rule 1 asks the bounds of all commands together: if one drives forward and one backward, or
        one drives and one turns on the spot, these do not exclude zero though each moves the robot.
        """
        moves_now = bool(exclude_zero(self._bounds[:, robot]))
        moved_long = bool(self._driven_s[robot] > DELAY_NS / SECOND)
        if not moves_now and not moved_long:
            return
        since_rest = self._since_rest
        least, most = (since_rest.integrals - since_rest.integrals_at_change)[:, robot]
        unseen = self._unseen[robot]
        if not self._coarse or np.any((least > unseen) | (most < -unseen)):
            yield Refuse(robot, REPEATS)

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Refuse a pose that contradicts the commands."""
        fault = self.take_pose(robot, before, pose)
        if fault:
            yield Refuse(robot, fault)

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Note a robot that has moved for long against its commands, which are to stand."""
        stood = self._straying.get(robot, TimedPose(now_ns, before))
        fault = self.take_pose(robot, stood.pose, pose)
        if not fault:
            self._straying.pop(robot, None)
            return
        self._straying[robot] = stood
        if now_ns - stood.exposed_ns > UNTRACKED_STOP_S * SECOND:
            yield Moved(robot, fault)

    def take_pose(self, i: int, before: Pose, pose: Pose) -> str:
        """Take a pose of robot i in the newest frame; `before` is the last consistent one. Return
        how it contradicts the commands, "" if it is consistent.

        The first pose after `start` or `replace` is taken as consistent, and the motion up to it is
        not counted. Every pose counts as changed: repeats are only to be passed in pauses.
        """
        since_rest = self._since_rest
        moments = since_rest.moments[i]
        integrals = since_rest.integrals[:, i].copy()
        since_rest.integrals_at_change[:, i] = integrals
        self._driven_s[i] = 0.0
        travelled = since_rest.travelled[i].copy()
        if moments:
            travelled += motion(before, pose)
        now = np.array([travelled, *integrals])
        contradiction = self._contradiction(i, now)
        if contradiction is not None:
            return fault_of(contradiction, self._slack[i], has_wheels=self._radius > 0)
        since_rest.travelled[i] = travelled
        now_ns = self._times[i]
        if not moments or now_ns - moments[-1][0] >= SPACING_NS:
            moments.append((now_ns, now))
        while now_ns - moments[0][0] > COMPARED_NS:  # the newest is younger: it stays
            moments.popleft()
        return ""

    def _contradiction(self, i: int, now: Floats) -> Floats | None:
        """Return the motion of robot i and its bounds (3, 3) since the newest moment since which it
        is out of these by more than the slack; None if there is no such moment."""
        moments = self._since_rest.moments[i]
        if not moments:
            return None
        since = now - np.array([moment for _, moment in moments])
        contradicts = out_of_bounds(since, self._slack[i]).any(axis=1)
        if not contradicts.any():
            return None
        return since[np.flatnonzero(contradicts)[-1]]


def exclude_zero(bounds: Floats) -> Bools:
    """Return whether bounds (2, ..., 3) exclude zero (...): whether the rates of a part are all
    positive or all negative. Those across never are."""
    least, most = bounds
    return ((least > 0.0) | (most < 0.0)).any(axis=-1)


def out_of_bounds(motion: Floats, slack: Floats) -> Bools:
    """Return which parts (..., 3) of motions (..., 3, 3) are out of their bounds by more than
    `slack` (3,)."""
    travelled = motion[..., 0, :]
    return (travelled < motion[..., 1, :] - slack) | (travelled > motion[..., 2, :] + slack)


def motion(before: Pose, pose: Pose) -> Floats:
    """Return the motion (3,) between two poses, on an arc: its length, the displacement across the
    heading halfway, and the angle turned. Of more than half a turn, as may be made in a long gap,
    the shorter way round is returned, which is wrong.

    The displacement along the heading halfway is the chord of the arc: sin(h) / h of its length,
    where h is half the angle turned.
    """
    turned = math.remainder(pose.heading - before.heading, math.tau)
    middle = before.heading + turned / 2
    dx = pose.x - before.x
    dy = pose.y - before.y
    along = dx * math.cos(middle) + dy * math.sin(middle)
    across = dy * math.cos(middle) - dx * math.sin(middle)
    half = math.pi * (turned / math.tau)  # in this order, as numpy.sinc did for earlier logs
    chord = math.sin(half) / half if half else 1.0
    return np.array([along / chord, across, turned])


def fault_of(motion: Floats, slack: Floats, has_wheels: bool) -> str:
    """Return what is said of a motion (3, 3) of which a part is out of its bounds by more than
    `slack` (3,).

    What is commanded is the middle of the bounds. A part *stands* if it is smaller than
    STANDS_SHARE of what is commanded. It is *against* the command if their signs differ and what is
    commanded is greater than MEANT_SHARE of it. The first row that holds is said:

        it does not move             along is out of bounds and stands; or around is out of bounds
                                     and stands, and along is smaller than its slack
        it moves backward            along is out of bounds, and against the command
        it turns the wrong way       around is out of bounds, and against the command
        it moves as no command does  of along, across and around, the first that is out of bounds
    """
    along, across, around = out_of_bounds(motion, slack)
    travelled, least, most = motion
    commanded = (least + most) / 2
    stands = np.abs(travelled) < STANDS_SHARE * np.abs(commanded)
    is_meant = np.abs(commanded) > MEANT_SHARE * np.abs(travelled)
    is_against = (travelled * commanded < 0.0) & is_meant
    stands_along = along and stands[0]
    stands_around = around and stands[2] and abs(travelled[0]) < slack[0]
    if stands_along or stands_around:
        return of_kind(DOES_NOT_MOVE, has_wheels)
    if along and is_against[0]:
        return of_kind(BACKWARD, has_wheels)
    if around and is_against[2]:
        return of_kind(WRONG_WAY, has_wheels)
    if along:
        return ANOTHER.format(KINDS[0])
    return ANOTHER.format(KINDS[1] if across else KINDS[2])


def of_kind(fault: str, has_wheels: bool) -> str:
    """Return how a fault is said of a robot with wheels or without."""
    return fault if has_wheels else OF_CELLS[fault]
