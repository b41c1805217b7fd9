"""Checks whether robots move as commanded: compares a camera's poses with the transmissions.

A robot with two wheels, each at a distance r from the robot's centre, can only move along its
heading at a speed v and turn at a rate w. Which command acts at a time t is unknown: radio and
wheels delay commands, and some are lost. So v(t) and w(t) lie between the least and the greatest
values commanded in [t - DELAY_NS, t], widened by the errors that result if the speed of each wheel
is wrong by up to a fraction g:

    e = g max(|v|, |w| r),    v in [v - e, v + e],    w in [w - e / r, w + e / r].

From any time in the last WINDOW_NS until now, the displacement along the heading and the angle
turned must lie between the integrals of these bounds; the displacement across the heading must lie
within plus or minus the integral of e, as a rolling robot does not move sideways. A slack is added
to each bound. Each robot's integrals go to the time of its own pose.

A pose that repeats to the last bit while every command moves its robot is not accepted, with a
camera that measures on a grid only once the robot must have gone further than a step of the grid.
Lengths are in the spec's length unit.
"""

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import UNSTATED, Floats, Pose, Sight
from tetractl.lab.command_history import CommandHistory

DELAY_NS = 3 * SECOND // 10  # delay by radio, wheels and some lost commands
WATCHDOG_NS = SECOND // 4  # robots that received nothing for this time have stopped themselves
WINDOW_NS = SECOND
SLACK_S = 0.03  # time of driving at full speed that is allowed as slack
SLACK_RAD = 0.08
NEAR = 1e-9  # share of the slack within which a bound is compared again, exactly
STANDS = 0.3  # a robot that makes less than this fraction of the commanded motion stands still

REPEATS = "its pose repeats to the last bit though it is commanded to move: is the camera frozen?"
STILL = (
    "does not move though commanded to: is a wheel stuck, is the robot on its back or "
    "without power or link, or is the camera frozen?"
)
BACKWARD = "moves backward: is its heading offset wrong, or its drive inverted?"
WRONG_WAY = "turns the wrong way: is its drive swapped or inverted?"
OF_CELLS = {
    STILL: "does not swim: is it stuck or dead, or is the camera frozen?",
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


class MotionCheck:
    """Compares the motion of N robots, with the speeds `speeds` (N,), with their commands.

    `radius` is r, 0 for robots without wheels; `noise` is the largest error of a position. Both are
    in the spec's length unit, which has `mm` millimetres. `sight` is what the camera can see.
    """

    def __init__(
        self,
        speeds: Sequence[float],
        radius: float,
        noise: float,
        sight: Sight = UNSTATED,
        mm: float = 1.0,
    ) -> None:
        n = len(speeds)
        self._radius = radius
        way = SLACK_S * np.array(speeds) + noise
        around = np.full(n, SLACK_RAD + 2 * sight.largest[1])
        self._slack = np.array([way, way, around]).T  # (N, 3)
        steps = np.array([math.sqrt(2) * sight.grid_mm / mm] * 2 + [sight.grid_rad])
        late = np.column_stack([SLACK_S * np.array(speeds)] * 2 + [np.full(n, SLACK_RAD)])
        self._coarse, self._step = sight.coarse, steps + late  # (N, 3)
        self._nearly = ((1.0 - NEAR) * self._slack).tolist()
        # least and most of each transmission: along, across, around
        self._sent = CommandHistory(2, n, 3)
        self.times = (0,) * n  # of the newest poses [ns]
        self._bounds = np.zeros((2, n, 3))  # bounds in force now
        self.restart()

    def restart(self) -> None:
        """Forget all motion; called when robots start from rest."""
        n = len(self._slack)
        self.seen = np.zeros((n, 3))  # motion since the start, by consistent poses
        self._allowed = np.zeros((2, n, 3))  # integrals of the bounds since the start
        # per robot: times [ns], and the motion and integrals of both bounds up to then, (3, 3)
        self._past: list[deque[tuple[int, Floats]]] = [deque() for _ in range(n)]
        # per robot: by how much the motion up to a kept time exceeds its least bound at most, and
        # its greatest bound at least, (2, 3)
        self._beyond: list[list[list[float]]] = [[] for _ in range(n)]
        self._changed = self._allowed.copy()  # at each robot's last pose that differs

    def forget(self, i: int) -> None:
        """Forget the motion of robot i, which is compared again from its next pose on."""
        self._past[i].clear()

    def sent(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float], share: float
    ) -> None:
        """Take a transmission: the robots' speeds [length unit/s] and turning rates [rad/s], and
        the relative error g of the wheels as `share`.
        """
        v, w = np.array(speed), np.array(turning)
        off = share * np.maximum(np.abs(v), np.abs(w) * self._radius)
        around = off / self._radius if self._radius else share * np.abs(w)
        middle, spread = np.array([v, 0 * v, w]).T, np.array([off, off, around]).T
        self._sent.sent(now_ns, np.array([middle - spread, middle + spread]))

    def frame(self, times: tuple[int, ...]) -> None:
        """Take the times (N,) of a frame's poses, before `disagrees` is called for these."""
        spans = list(zip(self.times, times, strict=True))
        self._allowed = self._allowed.copy()
        for span in set(spans):
            bounds, robots = self._between(*span), [one == span for one in spans]
            own = slice(None) if all(robots) else robots  # which is faster
            self._bounds[:, own] = bounds[:, own]
            self._allowed[:, own] += bounds[:, own] * ((span[1] - span[0]) / SECOND)
        self.times = times

    def _between(self, since_ns: int, now_ns: int) -> Floats:
        """Return the bounds (2, N, 3) by all commands that may act between two times."""
        since_ns -= DELAY_NS
        times, sent = self._sent.acting(since_ns, now_ns)
        gaps = (after - before for before, after in pairwise([*times, now_ns]))
        if not times or times[0] > since_ns or max(gaps) > WATCHDOG_NS:
            # before the first transmission, and after a silence
            sent = np.concatenate([sent, np.zeros((1, *self._bounds.shape))])
        return np.array([sent[:, 0].min(axis=0), sent[:, 1].max(axis=0)])

    def stays(self, i: int) -> bool:
        """Return whether robot i, whose pose repeats, must have moved: every command that may act
        now moves it, and since its pose changed it has gone further than a step of the grid and
        the slack."""
        least, most = self._bounds[:, i]
        gone, most_gone = self._allowed[:, i] - self._changed[:, i]
        moves = np.any((least > 0.0) | (most < 0.0))
        step = self._step[i]
        far = not self._coarse or np.any((gone > step) | (most_gone < -step))
        return bool(moves and far)

    def disagrees(self, i: int, before: Pose, pose: Pose) -> str:
        """Return how robot i disobeyed its commands since its last consistent pose; "" if it
        obeyed, and the new pose is then the last consistent one.
        """
        past, allowed, now_ns = self._past[i], self._allowed[:, i], self.times[i]
        self._changed[:, i] = allowed
        seen = self.seen[i] + motion(before, pose) if past else self.seen[i]
        if past and self._may_disagree(i, seen, allowed):
            moved = np.array([seen, *allowed]) - np.array([row for _, row in past])  # (K, 3, 3)
            slack = self._slack[i]
            below, above = moved[:, 1] - slack, moved[:, 2] + slack
            wrong = (moved[:, 0] < below) | (moved[:, 0] > above)
            if len(found := np.flatnonzero(wrong)):
                way, least, most = moved[found[-1] // 3]
                why = _diagnosis(way, least, most, slack)
                return why if self._radius else OF_CELLS.get(why, why)
        self.seen[i] = seen
        kept = len(past)
        if not past or now_ns - past[-1][0] >= SECOND // 20:
            past.append((now_ns, np.array([seen, *allowed])))
            kept = -1
        while len(past) > 1 and now_ns - past[0][0] > WINDOW_NS:
            past.popleft()
        if len(past) != kept:
            rows = np.array([row for _, row in past])  # (K, 3, 3)
            over = rows[:, :1] - rows[:, 1:]
            self._beyond[i] = [over[:, 0].max(axis=0).tolist(), over[:, 1].min(axis=0).tolist()]
        return ""

    def _may_disagree(self, i: int, seen: Floats, allowed: Floats) -> bool:
        """Return whether motion since any kept time may be out of its bounds, but for rounding."""
        ways = zip(seen.tolist(), *allowed.tolist(), *self._beyond[i], self._nearly[i], strict=True)
        return any(
            way - least - over_least < -slack or way - most - over_most > slack
            for way, least, most, over_least, over_most, slack in ways
        )


def motion(before: Pose, pose: Pose) -> Floats:
    """Return the motion (3,) between two poses, on an arc: displacement along and across the
    heading, and angle turned.
    """
    turned = math.remainder(pose.heading - before.heading, math.tau)
    dx, dy, middle = pose.x - before.x, pose.y - before.y, before.heading + turned / 2
    along, across = (
        dx * math.cos(middle) + dy * math.sin(middle),
        dy * math.cos(middle) - dx * math.sin(middle),
    )
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
    if along and abs(way[0]) < STANDS * abs(meant[0]):
        return STILL
    opposite = (way * meant < 0.0) & (abs(meant) > STANDS * abs(way))
    if along and opposite[0]:
        return BACKWARD
    if around and opposite[2]:
        return WRONG_WAY
    return ANOTHER.format(KINDS[0 if along else 1 if across else 2])
