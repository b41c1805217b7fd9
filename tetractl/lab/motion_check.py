"""Checks whether robots move as commanded: compares a camera's poses with the transmissions.

A robot with two wheels, each at a distance r from the robot's centre, can only move along its
heading at a speed v and turn at a rate w. Which command acts at a time t is unknown: radio and
wheels delay commands, and some are lost. So v(t) and w(t) lie between the least and the greatest
values commanded in [t - DELAY_NS, t], widened by the errors that result if the speed of each wheel
is wrong by up to a fraction g:

    e = g max(|v|, |w| r),    v in [v - e, v + e],    w in [w - e / r, w + e / r].

From any time in the last COMPARED_NS until now, the displacement along the heading and the angle
turned must lie between the integrals of these bounds; the displacement across the heading must lie
within plus or minus the integral of e, as a rolling robot does not move sideways. A slack is added
to each bound. Each robot's integrals go to the time of its own pose.

A pose that repeats to the last bit is not accepted while every command that may act moves its
robot, nor once commands have moved it, between stops, for DELAY_NS in all since its pose changed;
with a camera that measures on a grid only if it must have gone further than a step of the grid.
Lengths are in the spec's length unit.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNSTATED, Bools, Floats, Pose, Sight
from tetractl.lab.command_history import CommandHistory

DELAY_NS = 3 * SECOND // 10
"""Longest delay by radio, wheels and some lost commands."""
WATCHDOG_NS = SECOND // 4
"""Robots that received nothing for this time have stopped themselves."""
COMPARED_NS = SECOND
"""Longest time over which motion is compared."""
SPACING_NS = SECOND // 20
"""Least time between two moments since which it is compared."""
SLACK_S = 0.03
"""Time of driving at full speed that is allowed as slack."""
SLACK_RAD = 0.08
"""Angle that is allowed as slack."""
ROUNDING = 1e-9
"""Share of the slack within which a bound is compared again, exactly."""
STANDS_SHARE = 0.3
"""A robot that makes less than this fraction of the commanded motion stands still."""

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
"""The same, of robots without wheels."""
AS_NO_COMMAND = "as no command does"
ANOTHER = (
    f"moves {{}} {AS_NO_COMMAND}: was it pushed, or does the camera track another body as "
    "this robot?"
)
KINDS = ("along its heading", "sideways", "around")


@dataclass(frozen=True, slots=True)
class MotionMoment:
    """A moment since which a robot's motion is compared.

    `ways` (3, 3) are, since the start: its motion by consistent poses, and the integrals of the
    least and of the greatest bounds; each along, across and around its heading.
    """

    at_ns: int
    ways: Floats


@dataclass(slots=True)
class MotionWindow:
    """The moments of the last COMPARED_NS of one robot, oldest first.

    `over_least` (3,) is by how much the motion up to a moment exceeds its least bound at most,
    `over_most` (3,) its greatest bound at least: no moment needs to be compared while these two do
    not contradict a pose.
    """

    moments: deque[MotionMoment] = field(default_factory=deque)
    over_least: list[float] = field(default_factory=list)
    over_most: list[float] = field(default_factory=list)

    def add(self, now_ns: int, ways: Floats) -> None:
        """Add a moment unless the last is too young, and drop those that are too old."""
        moments = self.moments
        changed = False
        if not moments or now_ns - moments[-1].at_ns >= SPACING_NS:
            moments.append(MotionMoment(now_ns, ways))
            changed = True
        while len(moments) > 1 and now_ns - moments[0].at_ns > COMPARED_NS:
            moments.popleft()
            changed = True
        if changed:
            rows = np.array([moment.ways for moment in moments])  # (K, 3, 3)
            self.over_least = (rows[:, 0] - rows[:, 1]).max(axis=0).tolist()
            self.over_most = (rows[:, 0] - rows[:, 2]).min(axis=0).tolist()


@dataclass(frozen=True, slots=True)
class MotionSlack:
    """How far motion may be beyond its bounds, and how far a camera cannot see: (N, 3), along,
    across and around the heading."""

    allowed: Floats
    """Slack that is added to each bound."""
    less: list[list[float]]
    """The same, less what numbers may be rounded by."""
    visible: Floats
    """Motion after which a pose on a grid must have changed."""

    @classmethod
    def of(cls, speeds: Sequence[float], noise: float, sight: Sight, mm: float) -> Self:
        """Return the slack of robots; arguments as of MotionCheck."""
        robots = len(speeds)
        drive = SLACK_S * np.array(speeds)
        way = drive + noise
        angle = np.full(robots, SLACK_RAD + 2 * sight.largest[1])
        allowed = np.array([way, way, angle]).T
        step = math.sqrt(2) * sight.grid_mm / mm
        grid = np.array([step, step, sight.grid_rad])
        visible = grid + np.column_stack([drive, drive, np.full(robots, SLACK_RAD)])
        return cls(allowed, ((1.0 - ROUNDING) * allowed).tolist(), visible)


class MotionSinceRest:
    """The motion of N robots since they started from rest.

    `travelled` (N, 3) is their motion by consistent poses, `allowed` (2, N, 3) are the integrals of
    the bounds, `at_change` those at the last pose of each that differs.
    """

    def __init__(self, robots: int) -> None:
        self.travelled = np.zeros((robots, 3))
        self.allowed = np.zeros((2, robots, 3))
        self.at_change = self.allowed.copy()
        self.windows = [MotionWindow() for _ in range(robots)]


class MotionCheck:
    """Compares the motion of N robots, with the speeds `speeds` (N,), with their commands.

    `radius` is r, 0 for robots without wheels; `noise` is the largest error of a position. Both are
    in the spec's length unit, which has `mm` millimetres. `sight` is what the camera can see.
    `times` (N,) are those of the newest poses [ns].

    For each frame call `take_frame`, then `take_pose` for each pose to compare.
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
        self._slack = MotionSlack.of(speeds, noise, sight, mm)
        # least and greatest rates of each transmission (2, N, 3): along, across, around
        self._commanded = CommandHistory(2, robots, 3)
        self._bounds = np.zeros((2, robots, 3))  # bounds in force now
        # time (N,) [s] for which commands have moved each robot since its pose changed
        self._driven_s = np.zeros(robots)
        self._since_rest = MotionSinceRest(robots)

    @property
    def travelled(self) -> Floats:
        """The motion (N, 3) since the start, by consistent poses."""
        return self._since_rest.travelled

    def restart(self) -> None:
        """Forget all motion; called when robots start from rest."""
        self._since_rest = MotionSinceRest(len(self.times))

    def forget(self, i: int) -> None:
        """Forget the motion of robot i, which is compared again from its next pose on."""
        self._since_rest.windows[i].moments.clear()

    def sent(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float], share: float
    ) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s], and
        the relative error g of the wheels as `share`.
        """
        v = np.array(speed)
        w = np.array(turning)
        error = share * np.maximum(np.abs(v), np.abs(w) * self._radius)
        error_w = error / self._radius if self._radius else share * np.abs(w)
        middle = np.array([v, np.zeros_like(v), w]).T
        spread = np.array([error, error, error_w]).T
        self._commanded.sent(now_ns, np.array([middle - spread, middle + spread]))

    def take_frame(self, times: tuple[int, ...]) -> None:
        """Take the times (N,) of a frame's poses, before `take_pose` is called for these."""
        spans = list(zip(self.times, times, strict=True))
        allowed = self._since_rest.allowed.copy()
        for span in set(spans):
            since_ns, until_ns = span
            robots = [i for i, span_of_robot in enumerate(spans) if span_of_robot == span]
            rows = slice(None) if len(robots) == len(spans) else robots  # which is faster
            bounds = self._bounds_between(since_ns, until_ns)[:, rows]
            self._bounds[:, rows] = bounds
            allowed[:, rows] += bounds * ((until_ns - since_ns) / SECOND)
            self._driven_s[rows] += self._driven_between(since_ns, until_ns)[rows]
        self._since_rest.allowed = allowed
        self.times = times

    def _bounds_between(self, since_ns: int, now_ns: int) -> Floats:
        """Return the bounds (2, N, 3) by all commands that may act between two times."""
        earliest_ns = since_ns - DELAY_NS
        times, rates = self._commanded.acting(earliest_ns, now_ns)
        gaps = (after - before for before, after in pairwise([*times, now_ns]))
        if not times or times[0] > earliest_ns or max(gaps) > WATCHDOG_NS:
            # before the first transmission, and after a silence, robots stand
            rates = np.concatenate([rates, np.zeros((1, *self._bounds.shape))])
        return np.array([rates[:, 0].min(axis=0), rates[:, 1].max(axis=0)])

    def _driven_between(self, since_ns: int, until_ns: int) -> Floats:
        """Return for how long (N,) [s] commands move the robots between two times: each until the
        next, or until the watchdog."""
        times, rates = self._commanded.acting(since_ns, until_ns)
        driven_s = np.zeros(len(self.times))
        spans = pairwise([*times, until_ns])
        for (sent_ns, next_ns), bounds in zip(spans, rates, strict=True):
            begins_ns = max(sent_ns, since_ns)
            ends_ns = min(next_ns, sent_ns + WATCHDOG_NS)
            if ends_ns > begins_ns:
                driven_s[_moves(bounds)] += (ends_ns - begins_ns) / SECOND
        return driven_s

    def must_have_moved(self, i: int) -> bool:
        """Return whether robot i, whose pose repeats, must have moved: every command that may act
        now moves it, or since its pose changed commands have moved it for longer than any is late;
        and it has gone further than a step of the grid and the slack."""
        moves_now = bool(_moves(self._bounds[:, i]))
        if not moves_now and self._driven_s[i] <= DELAY_NS / SECOND:
            return False
        since_rest = self._since_rest
        least_way, most_way = since_rest.allowed[:, i] - since_rest.at_change[:, i]
        visible = self._slack.visible[i]
        return not self._coarse or bool(np.any((least_way > visible) | (most_way < -visible)))

    def take_pose(self, i: int, before: Pose, pose: Pose) -> str:
        """Take a pose of robot i that differs from the last consistent one, `before`. Return how it
        contradicts the commands since then; "" if it does not: it is then the last consistent one.
        """
        since_rest = self._since_rest
        window = since_rest.windows[i]
        allowed = since_rest.allowed[:, i]
        since_rest.at_change[:, i] = allowed
        self._driven_s[i] = 0.0
        travelled = since_rest.travelled[i]
        if window.moments:
            travelled = travelled + motion(before, pose)
            fault = self._contradiction(i, np.array([travelled, *allowed]))
            if fault:
                return fault
        since_rest.travelled[i] = travelled
        window.add(self.times[i], np.array([travelled, *allowed]))
        return ""

    def _contradiction(self, i: int, ways: Floats) -> str:
        """Return how motion and bounds since the start, `ways` (3, 3), contradict each other since
        any moment; "" if they do not.
        """
        if not self._may_contradict(i, ways):
            return ""
        slack = self._slack.allowed[i]
        moments = self._since_rest.windows[i].moments
        since = ways - np.array([moment.ways for moment in moments])  # (K, 3, 3)
        way = since[:, 0]
        least = since[:, 1]
        most = since[:, 2]
        wrong = (way < least - slack) | (way > most + slack)
        wrong_since = np.flatnonzero(wrong.any(axis=1))
        if not len(wrong_since):
            return ""
        k = wrong_since[-1]
        fault = _diagnosis(way[k], least[k], most[k], slack)
        return fault if self._radius else OF_CELLS.get(fault, fault)

    def _may_contradict(self, i: int, ways: Floats) -> bool:
        """Return whether motion since any moment may be out of its bounds, but for rounding."""
        window = self._since_rest.windows[i]
        travelled, least, most = ways.tolist()
        for axis, slack in enumerate(self._slack.less[i]):
            over_least = travelled[axis] - least[axis] - window.over_least[axis]
            over_most = travelled[axis] - most[axis] - window.over_most[axis]
            if over_least < -slack or over_most > slack:
                return True
        return False


def _moves(bounds: Floats) -> Bools:
    """Return whether robots move by bounds (2, ..., 3), whatever their wheels are off: (...)."""
    least, most = bounds
    return ((least > 0.0) | (most < 0.0)).any(axis=-1)


def motion(before: Pose, pose: Pose) -> Floats:
    """Return the motion (3,) between two poses, on an arc: displacement along and across the
    heading, and angle turned.
    """
    turned = math.remainder(pose.heading - before.heading, math.tau)
    middle = before.heading + turned / 2
    dx = pose.x - before.x
    dy = pose.y - before.y
    along = dx * math.cos(middle) + dy * math.sin(middle)
    across = dy * math.cos(middle) - dx * math.sin(middle)
    return np.array([along / chord(turned), across, turned])


def chord(turned: float) -> float:
    """Return the chord of an arc on which a robot turns by an angle, as a share of its length."""
    half = math.pi * (turned / math.tau)
    return math.sin(half) / half if half else 1.0


def _diagnosis(way: Floats, least: Floats, most: Floats, slack: Floats) -> str:
    """Return the fault text for a motion `way` (3,), along, across and around, that is below
    `least` (3,) or above `most` (3,) by more than `slack` (3,).
    """
    along, across, around = (way < least - slack) | (way > most + slack)
    meant = (least + most) / 2
    small = abs(way) < STANDS_SHARE * abs(meant)
    if along and small[0]:
        return DOES_NOT_MOVE
    if around and small[2] and abs(way[0]) < slack[0]:
        return DOES_NOT_MOVE
    opposite = (way * meant < 0.0) & (abs(meant) > STANDS_SHARE * abs(way))
    if along and opposite[0]:
        return BACKWARD
    if around and opposite[2]:
        return WRONG_WAY
    if along:
        return ANOTHER.format(KINDS[0])
    return ANOTHER.format(KINDS[1] if across else KINDS[2])
