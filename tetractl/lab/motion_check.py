"""Check whether robots move as commanded, by comparing camera poses with transmissions.

A motion has three parts: the displacement along the robot's heading, the displacement across it
(positive to the left), and the angle turned around. A command is a speed v and a turning rate w. A
robot that obeys it exactly has the rates v along, 0 across and w around.

Bounds. A robot has two wheels, each at a distance r from its centre. The sum of their speeds is 2 v
and the difference 2 w r. If each may be wrong by a fraction g of itself, v is wrong by up to e = g
max(|v|, |w| r), and w by up to e / r. So a command allows the rates

    along    v - e    to  v + e
    across     - e    to    + e      (a rolling robot does not move sideways: this is tolerance)
    around   w - e/r  to  w + e/r

For robots without wheels, r is 0: then e = g |v|, and g |w| replaces e/r.

It is unknown which command a robot obeys: radio and wheels delay commands, and some are lost. From
one frame to the next, it may be any command that was the newest one at some time between
`limits.delay` before the first frame and the second frame. The robot may also be standing still,
with the rates 0, if this time begins before the first transmission, or if a gap between two
transmissions, or since the last, that reaches into it is longer than WATCHDOG_NS. The *bounds* from
one frame to the next are the minimum and the maximum of all these possible rates.

Comparison. The bounds are integrated over time, and the motion is added up from pose to pose; each
robot's integrals end at the time of its own pose. When a pose arrives, each part of the motion must
lie between the integral of its minimum rate and that of its maximum rate, plus or minus a slack.
This is compared over several times: until now, since each of the *moments* of about the last
second. Moments are times of consistent poses at least SPACING_NS apart. A pose that is out of
bounds since any of them contradicts the commands, and its motion is not counted. Every other pose
is *consistent*.

Repeats. A pose that equals the previous one to the last bit may come from a frozen image. Let
bounds *exclude zero* if the rates along, or those around, are all positive or all negative. The
robot must have moved

    1. if the bounds up to the newest frame exclude zero, or
    2. if commands whose own bounds exclude zero have been in force for more than `limits.delay` in
       all since its pose changed: each from its transmission to the next, for WATCHDOG_NS at most.

The second rule finds a frozen image even if robots are stopped so often that, by the first rule,
they might always stand still. If the camera measures on a grid, a pose may repeat while its robot
moves. Then, in addition, the integrals since the pose changed must say that the robot has gone
further than such a camera may leave unseen.

Lengths are in the spec's length unit, angles in rad, positive anticlockwise, times in ns on the
run's clock. N is the number of robots. Arrays (..., 3) hold the parts along, across and around.
Arrays (2, ...) hold the minimum and the maximum. In arrays (3, 3), the rows are the motion, the
minimum and the maximum.
"""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Excess, Finding, Moved, Refuse
from tetractl.core.poses import Bools, Floats, Pose
from tetractl.core.robot_step import PARTS, RobotStep
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import UNTRACKED_STOP_S

ROOM = 256
"""Initial number of transmissions that a history has space for. It grows as needed."""
WATCHDOG_NS = SECOND // 4
"""Time without a transmission after which robots have stopped themselves [ns]."""
SLACK_S = 0.03
"""Slack of positions along and across the heading, as a time of driving at full speed [s]."""
SLACK_RAD = 0.08
"""Slack of the angle turned [rad]."""
COMPARED_NS = SECOND
"""Maximum age of the moments since which motion is compared with commands [ns]."""
SPACING_NS = SECOND // 20
"""Minimum time between two of these moments [ns]."""
STANDS_SHARE = 0.3
"""Fraction of the commanded motion below which a robot counts as standing still."""
MEANT_SHARE = 0.3
"""Minimum fraction of a motion that must be commanded for its direction to be wrong.

Below it, a disturbance moves the robot.
"""

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
"""Messages for robots without wheels, instead of those for robots on wheels."""
AS_NO_COMMAND = "as no command does"
PUSHED = ": was it pushed, or does the camera track another body as this robot?"
ANOTHER = f"moves {{}} {AS_NO_COMMAND}{PUSHED}"
"""Message about a motion that no command explains. The placeholder is for one of PARTS."""


class CommandHistory:
    """A history of commanded rates, each valid from its transmission until the next one.

    The rates of one transmission are an array of a `shape`.

    Before the first transmission, the rates are 0.
    """

    def __init__(self, *shape: int) -> None:
        self._none = np.zeros(shape)
        self._times: list[int] = []
        self._sent = np.zeros((ROOM, *shape))  # of which the first rows are used

    def sent(self, now_ns: int, rates: Sequence[float] | Floats) -> None:
        """Add the rates of a transmission at `now_ns` [ns].

        Entries older than about 2 s may be dropped.
        """
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
        """Return the transmissions that were in effect at some time between two times [ns].

        Returns:
            Their times (K,), oldest first, and their rates (K, ...) as a view.
        """
        first = max(0, bisect_right(self._times, since_ns) - 1)
        last = bisect_right(self._times, until_ns)
        return self._times[first:last], self._sent[first:last]

    def mean(self, until_ns: int, dt_ns: int) -> Floats:
        """Compute the mean of the rates commanded during the `dt_ns` before `until_ns` [ns].

        Before the first transmission, rates are 0.
        """
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
    """The motion of N robots since they last stood still, and what commands allow.

    It contains the motion measured by consistent poses (N, 3). It also contains the integrals of
    the bounds (2, N, 3), which commands allow, until now and until each robot's pose last changed.
    `moments` are each robot's moments, oldest first: a time, and the motion and integrals (3, 3)
    until then. Moments older than COMPARED_NS are dropped when a consistent pose is added. This
    happens after the comparison, so the first pose after a gap is also compared with older moments.
    """

    def __init__(self, robots: int) -> None:
        self.travelled = np.zeros((robots, 3))
        self.integrals = np.zeros((2, robots, 3))
        self.integrals_at_change = np.zeros((2, robots, 3))
        self.moments = [deque[tuple[int, Floats]]() for _ in range(robots)]


class MotionCheck(GuardCheck):
    """A check that refuses a pose if no command of the last `limits.delay` explains the motion.

    During a pause, the check reports each robot that has moved in this way for UNTRACKED_STOP_S.
    The stop may have been lost, so it is sent again.

    Args:
        rules: The rules of the guard.
        noise: Maximum error of a position [length unit]. The slack contains it once, although a
            motion has the errors of two positions.
        share: Relative error g of the wheels.
    """

    statistical = True

    def __init__(self, rules: GuardRules, noise: float, share: float) -> None:
        robots = len(rules.speeds)
        self._mm = rules.mm
        self._delay_ns = round(rules.limits.delay * SECOND)
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
        """The motion of each robot since its last standstill, from consistent poses, (N, 3).

        The parts are along and across the heading [length unit], and the angle turned [rad].
        """
        return self._since_rest.travelled

    def start(self) -> None:
        """Forget the motion and its bounds, because robots start from standstill.

        A pose may have repeated since before the start. Rule 2 therefore keeps its count. The
        integrals since the pose changed, which a camera with a grid needs, begin at 0 again.
        """
        self._since_rest = MotionSinceRest(len(self._times))
        self._straying.clear()

    def replace(self, robot: int) -> None:
        """Forget the moments of a robot; see `GuardCheck.replace`.

        Its next pose counts as consistent, and the motion up to that pose is not counted. What is
        known of a repeated pose is kept.
        """
        self._since_rest.moments[robot].clear()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Record that an action was transmitted to the robots; see `GuardCheck.sent`."""
        v = np.array(speed)
        w = np.array(turning)
        error = self._share * np.maximum(np.abs(v), np.abs(w) * self._radius)
        error_around = error / self._radius if self._radius else self._share * np.abs(w)
        exact = np.array([v, np.zeros_like(v), w]).T
        errors = np.array([error, error, error_around]).T
        self._commanded.sent(now_ns, np.array([exact - errors, exact + errors]))

    # ---- a frame ----

    def exposed(self, times: tuple[int, ...]) -> None:
        """Record the times (N,) of a frame's poses, before the poses are compared.

        The time of a robot that measures its own pose may go back: if a later pose was refused and
        none arrives now, the time is the one of its last accepted pose. Integrating backward then
        removes what was added, provided that the commands have not changed in between. If the time
        goes back by more than `limits.delay`, this fails, because no command is found. What follows
        is then counted twice, as rule 2 always does.
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
        """Add up how far commands allow some robots to move between the times of two poses."""
        bounds = self._bounds_between(since_ns, until_ns)[:, robots]
        self._bounds[:, robots] = bounds
        self._since_rest.integrals[:, robots] += bounds * ((until_ns - since_ns) / SECOND)
        self._driven_s[robots] += self._driven_between(since_ns, until_ns)[robots]

    def _bounds_between(self, since_ns: int, until_ns: int) -> Floats:
        """Return the bounds (2, N, 3) between two times, for all commands that robots may obey.

        Only gaps between transmissions count, because nobody knows which of them a robot received.
        """
        earliest_ns = since_ns - self._delay_ns
        times, rates = self._commanded.acting(earliest_ns, until_ns)
        gaps = (after - before for before, after in pairwise([*times, until_ns]))
        if not times or times[0] > earliest_ns or max(gaps) > WATCHDOG_NS:
            # robots may stand
            rates = np.concatenate([rates, np.zeros((1, *self._bounds.shape))])
        return np.array([rates[:, 0].min(axis=0), rates[:, 1].max(axis=0)])

    def _driven_between(self, since_ns: int, until_ns: int) -> Floats:
        """Compute how long commands that must move a robot were in force between two times.

        Their bounds exclude zero. Each command counts from its transmission to the next, for at
        most WATCHDOG_NS. The result has shape (N,) [s].
        """
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
        """Refuse a repeated pose if its robot must have moved, and visibly to the camera.

        See "Repeats" in the module's docstring. Rule 1 uses the bounds of all commands together: if
        one drives forward and one backward, or one drives and one turns on the spot, these bounds
        do not exclude zero although each command moves the robot.
        """
        moves_now = bool(exclude_zero(self._bounds[:, robot]))
        moved_long = bool(self._driven_s[robot] > self._delay_ns / SECOND)
        if not moves_now and not moved_long:
            return
        since_rest = self._since_rest
        least, most = (since_rest.integrals - since_rest.integrals_at_change)[:, robot]
        unseen = self._unseen[robot]
        if not self._coarse or np.any((least > unseen) | (most < -unseen)):
            driven_s = float(self._driven_s[robot])
            yield Refuse(robot, REPEATS, Excess("frozen", driven_s, 0.0, "s", robot))

    def pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Refuse a pose that contradicts the commands; see `GuardCheck.pose`."""
        fault = self.take_pose(robot, before, pose)
        if fault is not None:
            yield fault

    def pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Report a robot that moves although it should stand still; see `GuardCheck.pause`."""
        stood = self._straying.get(robot, TimedPose(now_ns, before))
        fault = self.take_pose(robot, stood.pose, pose)
        if fault is None:
            self._straying.pop(robot, None)
            return
        self._straying[robot] = stood
        if now_ns - stood.exposed_ns > UNTRACKED_STOP_S * SECOND:
            yield Moved(robot, fault.text)

    def take_pose(self, i: int, before: Pose, pose: Pose) -> Refuse | None:
        """Compare a new pose of a robot with the commands, and record it if it is consistent.

        The first pose after `start` or `replace` counts as consistent, and the motion up to it is
        not counted. Every pose counts as changed: repeated poses may be passed only during pauses.

        Args:
            i: Index of the robot.
            before: Its last consistent pose.
            pose: Its new pose.

        Returns:
            How the pose contradicts the commands. None if it is consistent.
        """
        since_rest = self._since_rest
        moments = since_rest.moments[i]
        integrals = since_rest.integrals[:, i].copy()
        since_rest.integrals_at_change[:, i] = integrals
        self._driven_s[i] = 0.0
        travelled = since_rest.travelled[i].copy()
        if moments:
            travelled += RobotStep.between(before, pose).way
        now = np.array([travelled, *integrals])
        contradiction = self._contradiction(i, now)
        if contradiction is not None:
            slack = self._slack[i]
            text = fault_of(contradiction, slack, has_wheels=self._radius > 0)
            return Refuse(i, text, excess_of(contradiction, slack, self._mm, i))
        since_rest.travelled[i] = travelled
        now_ns = self._times[i]
        if not moments or now_ns - moments[-1][0] >= SPACING_NS:
            moments.append((now_ns, now))
        while now_ns - moments[0][0] > COMPARED_NS:  # the newest is younger: it stays
            moments.popleft()
        return None

    def _contradiction(self, i: int, now: Floats) -> Floats | None:
        """Find the newest moment since which robot i moved as no command of it allows.

        Returns:
            The motion since then and its bounds (3, 3). None if there is no such moment.
        """
        moments = self._since_rest.moments[i]
        if not moments:
            return None
        since = now - np.array([moment for _, moment in moments])
        contradicts = out_of_bounds(since, self._slack[i]).any(axis=1)
        if not contradicts.any():
            return None
        return since[np.flatnonzero(contradicts)[-1]]


def exclude_zero(bounds: Floats) -> Bools:
    """Check whether bounds (2, ..., 3) require that the robot moves, shape (...).

    They do if all rates along the heading, or all turning rates, have the same sign. The rates
    across the heading never do.
    """
    least, most = bounds
    return ((least > 0.0) | (most < 0.0)).any(axis=-1)


def out_of_bounds(motion: Floats, slack: Floats) -> Bools:
    """Check which parts of motions are out of their bounds.

    The parts are the distance along the heading, the distance across it, and the angle turned.

    Args:
        motion: The measured parts, their lower and their upper bounds, shape (..., 3, 3), with one
            row for each of these and one column for each part [mm, mm, rad].
        slack: By how much each part may exceed its bounds, shape (3,).

    Returns:
        Whether each part is out of its bounds, shape (..., 3).
    """
    travelled = motion[..., 0, :]
    return (travelled < motion[..., 1, :] - slack) | (travelled > motion[..., 2, :] + slack)


def fault_of(motion: Floats, slack: Floats, has_wheels: bool) -> str:
    """Describe a motion that has a part out of its bounds.

    The command is taken as the middle of the bounds. A part *stands* if it is smaller than
    STANDS_SHARE of the command. It is *against* the command if their signs differ and the command
    is larger than MEANT_SHARE of it. The first row that holds is reported:

        it does not move             along is out of bounds and stands; or around is out of bounds
                                     and stands, and along is smaller than its slack
        it moves backward            along is out of bounds, and against the command
        it turns the wrong way       around is out of bounds, and against the command
        it moves as no command does  otherwise; the first part out of bounds is reported

    Args:
        motion: The motion and its bounds, shape (3, 3).
        slack: How much a part may exceed its bounds, shape (3,).
        has_wheels: Whether the robot has wheels.
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
        return ANOTHER.format(PARTS[0])
    return ANOTHER.format(PARTS[1] if across else PARTS[2])


def excess_of(motion: Floats, slack: Floats, mm: float, robot: int) -> Excess:
    """Return the part of a motion that is furthest out of its bounds, and that bound.

    Args:
        motion: The motion and its bounds, shape (3, 3).
        slack: How much a part may exceed its bounds, shape (3,). Parts are compared by it.
        mm: Millimetres per length unit.
        robot: Index of the robot.
    """
    travelled, least, most = motion
    low = least - slack
    high = most + slack
    k = int((np.maximum(low - travelled, travelled - high) / slack).argmax())
    limit = low[k] if travelled[k] < low[k] else high[k]
    unit, scale = ("rad", 1.0) if k == 2 else ("mm", mm)
    return Excess("motion", float(travelled[k]) * scale, float(limit) * scale, unit, robot)


def of_kind(fault: str, has_wheels: bool) -> str:
    """Return the message about a fault in the words for robots with or without wheels."""
    return fault if has_wheels else OF_CELLS[fault]
