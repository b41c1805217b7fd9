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
Each comparison covers the time from one of the *moments* of about the last second until now.
Moments are times of consistent poses, at least MOMENT_SPACING_NS apart. A pose contradicts the
commands if the motion since any moment is out of its bounds. The motion up to such a pose is not
counted. Every other pose is *consistent*.

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
from tetractl.core.robot_step import PART_NAMES, RobotStep
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.spec.lab_section import UNTRACKED_STOP_S

INITIAL_CAPACITY = 256
"""Initial number of transmissions that a history has space for. It grows as needed."""
WATCHDOG_NS = SECOND // 4
"""Time without a transmission after which robots have stopped themselves [ns]."""
SLACK_S = 0.03
"""Slack of positions along and across the heading, as a time of driving at full speed [s]."""
SLACK_RAD = 0.08
"""Slack of the angle turned [rad]."""
COMPARED_MAX_NS = SECOND
"""Maximum age of the moments since which motion is compared with commands [ns]."""
MOMENT_SPACING_NS = SECOND // 20
"""Minimum time between two of these moments [ns]."""
STANDS_FRACTION = 0.3
"""Fraction of the commanded motion below which a robot counts as standing still."""
MEANT_FRACTION = 0.3
"""Minimum fraction of a motion that must be commanded for its direction to be wrong.

Below it, a disturbance moves the robot.
"""

POSE_REPEATS = (
    "its pose repeats to the last bit, although the robot is commanded to move: is the camera "
    "frozen?"
)
DOES_NOT_MOVE = (
    "does not move although it is commanded to: check its power, its link and its wheels, whether "
    "it lies on its back, and whether the camera is frozen"
)
MOVES_BACKWARD = "moves backward: is its heading offset wrong, or do its motors run backwards?"
TURNS_WRONG_WAY = (
    "turns the wrong way: are its left and right wheels swapped, or do its motors run backwards?"
)
MESSAGES_OF_CELLS = {
    DOES_NOT_MOVE: "does not swim: is it stuck or dead, or is the camera frozen?",
    MOVES_BACKWARD: (
        "moves backward: is its heading reversed, or does the camera track another cell in its "
        "place?"
    ),
    TURNS_WRONG_WAY: (
        "turns away from the field: is the camera's rotation or the field's sign wrong?"
    ),
}
"""Messages for robots without wheels, instead of those for robots on wheels."""
AS_NO_COMMAND = "in a way that no command explains"
PUSHED_QUESTION = ": was it pushed, or does the camera track another body as this robot?"
MOVES_UNEXPLAINED = f"moves {{}} {AS_NO_COMMAND}{PUSHED_QUESTION}"
"""Message about a motion that no command explains. The placeholder is for one of PARTS."""


class CommandHistory:
    """A history of commanded rates, each valid from its transmission until the next one.

    The rates of one transmission are an array of the given `shape`. Before the first transmission,
    all rates are 0.
    """

    def __init__(self, *shape: int) -> None:
        self._no_rates = np.zeros(shape)
        self._times: list[int] = []
        self._rates = np.zeros((INITIAL_CAPACITY, *shape))  # of which the first rows are used

    def add(self, now_ns: int, rates: Sequence[float] | Floats) -> None:
        """Add the rates of a transmission at `now_ns` [ns].

        Entries older than about 2 s may be dropped.
        """
        n_sent = len(self._times)
        if n_sent == len(self._rates):
            self._rates = np.concatenate([self._rates, np.zeros_like(self._rates)])
        self._rates[n_sent] = rates
        self._times.append(now_ns)
        n_outdated = bisect_right(self._times, now_ns - 2 * SECOND)
        if n_outdated > 64:  # old entries are removed occasionally, all at once
            self._rates[: n_sent + 2 - n_outdated] = self._rates[n_outdated - 1 : n_sent + 1].copy()
            del self._times[: n_outdated - 1]

    def find_acting(self, since_ns: int, until_ns: int) -> tuple[list[int], Floats]:
        """Return the transmissions that were in effect at some time between two times [ns].

        Returns:
            Their times (K,), oldest first, and their rates (K, ...) as a view.
        """
        first_index = max(0, bisect_right(self._times, since_ns) - 1)
        end_index = bisect_right(self._times, until_ns)
        return self._times[first_index:end_index], self._rates[first_index:end_index]

    def compute_mean(self, until_ns: int, dt_ns: int) -> Floats:
        """Compute the mean of the rates commanded during the `dt_ns` before `until_ns` [ns].

        Before the first transmission, rates are 0.
        """
        since_ns = until_ns - dt_ns
        latest_index = bisect_left(self._times, until_ns) - 1
        if latest_index >= 0 and self._times[latest_index] <= since_ns:  # the most frequent case
            return self._rates[latest_index] * dt_ns / dt_ns
        weighted_sum = self._no_rates
        while latest_index >= 0:
            begin_ns = max(self._times[latest_index], since_ns)
            weighted_sum = weighted_sum + self._rates[latest_index] * (until_ns - begin_ns)
            if begin_ns == since_ns:
                break
            until_ns = begin_ns
            latest_index = bisect_left(self._times, begin_ns) - 1
        return weighted_sum / dt_ns


class MotionSinceRest:
    """The motion of N robots since they last stood still, and the motion that commands allow.

    Attributes:
        travelled: Motion that consistent poses have measured, shape (N, 3).
        integrals: Integrals of the bounds until now, shape (2, N, 3): the minimum and the maximum
            motion that commands allow.
        integrals_at_change: The same integrals, until each robot's pose last changed.
        moments: Moments of each robot, oldest first. Each has a time [ns], and the motion and the
            integrals until then, shape (3, 3). Moments older than COMPARED_MAX_NS are dropped when
            a consistent pose is added. This happens after the comparison, so the first pose after a
            gap is also compared with older moments.
    """

    def __init__(self, n_robots: int) -> None:
        self.travelled = np.zeros((n_robots, 3))
        self.integrals = np.zeros((2, n_robots, 3))
        self.integrals_at_change = np.zeros((2, n_robots, 3))
        self.moments = [deque[tuple[int, Floats]]() for _ in range(n_robots)]


class MotionCheck(GuardCheck):
    """A check that refuses a pose if no command of the last `limits.delay` explains the motion.

    During a pause, the check reports each robot that has moved in this way for UNTRACKED_STOP_S.
    The stop may have been lost, so it is sent again.

    Args:
        rules: The rules of the guard.
        noise: Maximum error of a position [length unit]. The slack contains it once, although a
            motion has the errors of two positions.
        wheel_error: Relative error g of the wheels.
    """

    statistical = True

    def __init__(self, rules: GuardRules, noise: float, wheel_error: float) -> None:
        n_robots = len(rules.speeds)
        self._mm = rules.mm_per_unit
        self._delay_ns = round(rules.limits.delay * SECOND)
        self._radius = rules.wheel_radius
        self._wheel_error = wheel_error
        self._is_coarse = rules.sight.has_grid
        slack_distances = SLACK_S * np.array(rules.speeds)
        heading_error = rules.sight.largest_error_rad
        # by how much each part of a motion may be out of its bounds (N, 3)
        self._slack = np.column_stack(
            [
                slack_distances + noise,
                slack_distances + noise,
                np.full(n_robots, SLACK_RAD + 2 * heading_error),
            ]
        )
        # how far (N, 3) a robot may move while its pose on a grid repeats: the diagonal of the
        # grid's square, or a step of the heading, and the slack without the errors of poses
        grid_diagonal = math.sqrt(2) * rules.sight.grid_mm / rules.mm_per_unit
        grid_steps = np.array([grid_diagonal, grid_diagonal, rules.sight.grid_rad])
        self._visible_min = grid_steps + np.column_stack(
            [slack_distances, slack_distances, np.full(n_robots, SLACK_RAD)]
        )
        # times (N,) of the newest poses, 0 before the first frame: what is integrated from 0 to
        # that frame means nothing, as robots start from rest before anything is compared
        self._times = (0,) * n_robots
        # the rates that each transmission allows (2, N, 3)
        self._commanded = CommandHistory(2, n_robots, 3)
        # the bounds (2, N, 3) up to the newest frame
        self._bounds = np.zeros((2, n_robots, 3))
        # for how long (N,) [s] commands that exclude zero have been in force since the last pose
        # of each robot was taken
        self._driven_s = np.zeros(n_robots)
        self._since_rest = MotionSinceRest(n_robots)
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

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record a transmission; see `GuardCheck.record_transmission`."""
        speeds = np.array(speed)
        turning_rates = np.array(turning)
        speed_error = self._wheel_error * np.maximum(
            np.abs(speeds), np.abs(turning_rates) * self._radius
        )
        turning_error = (
            speed_error / self._radius
            if self._radius
            else self._wheel_error * np.abs(turning_rates)
        )
        commanded_rates = np.array([speeds, np.zeros_like(speeds), turning_rates]).T
        rate_errors = np.array([speed_error, speed_error, turning_error]).T
        self._commanded.add(
            now_ns, np.array([commanded_rates - rate_errors, commanded_rates + rate_errors])
        )

    # ---- a frame ----

    def record_exposures(self, times: tuple[int, ...]) -> None:
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
            self._integrate_bounds(slice(None), *intervals[0])
        else:
            for interval in distinct:
                robots = [i for i, own_interval in enumerate(intervals) if own_interval == interval]
                self._integrate_bounds(robots, *interval)
        self._times = times

    def _integrate_bounds(self, robots: slice | list[int], since_ns: int, until_ns: int) -> None:
        """Add up how far commands allow some robots to move between the times of two poses."""
        bounds = self._compute_bounds(since_ns, until_ns)[:, robots]
        self._bounds[:, robots] = bounds
        self._since_rest.integrals[:, robots] += bounds * ((until_ns - since_ns) / SECOND)
        self._driven_s[robots] += self._compute_driven_s(since_ns, until_ns)[robots]

    def _compute_bounds(self, since_ns: int, until_ns: int) -> Floats:
        """Compute between which rates each robot may move in a time span, given what was sent.

        A robot may obey any command that was sent recently, because it is unknown which
        transmissions it has received. The watchdog stops it only after a gap between transmissions.

        Returns:
            The minimum and maximum rates, shape (2, N, 3).
        """
        earliest_ns = since_ns - self._delay_ns
        times, rates = self._commanded.find_acting(earliest_ns, until_ns)
        gaps = (later - earlier for earlier, later in pairwise([*times, until_ns]))
        if not times or times[0] > earliest_ns or max(gaps) > WATCHDOG_NS:
            # robots may stand
            rates = np.concatenate([rates, np.zeros((1, *self._bounds.shape))])
        return np.array([rates[:, 0].min(axis=0), rates[:, 1].max(axis=0)])

    def _compute_driven_s(self, since_ns: int, until_ns: int) -> Floats:
        """Compute how long commands that must move a robot were in force between two times.

        Their bounds exclude zero. Each command counts from its transmission to the next, for at
        most WATCHDOG_NS. The result has shape (N,) [s].
        """
        times, rates = self._commanded.find_acting(since_ns, until_ns)
        driven_s = np.zeros(len(self._times))
        periods = pairwise([*times, until_ns])
        for (sent_ns, next_ns), bounds in zip(periods, rates, strict=True):
            begin_ns = max(sent_ns, since_ns)
            end_ns = min(next_ns, sent_ns + WATCHDOG_NS)
            if end_ns > begin_ns:
                driven_s[exclude_standstill(bounds)] += (end_ns - begin_ns) / SECOND
        return driven_s

    # ---- a pose ----

    def check_repeat(self, robot: int) -> Iterator[Finding]:
        """Refuse a repeated pose if its robot must have moved so far that the camera sees it.

        See "Repeats" in the module's docstring. Rule 1 uses the bounds of all commands together: if
        one drives forward and one backward, or one drives and one turns on the spot, these bounds
        do not exclude zero although each command moves the robot.
        """
        must_move_now = bool(exclude_standstill(self._bounds[:, robot]))
        has_driven_long = bool(self._driven_s[robot] > self._delay_ns / SECOND)
        if not must_move_now and not has_driven_long:
            return
        since_rest = self._since_rest
        minimum, maximum = (since_rest.integrals - since_rest.integrals_at_change)[:, robot]
        unseen_max = self._visible_min[robot]
        if not self._is_coarse or np.any((minimum > unseen_max) | (maximum < -unseen_max)):
            driven_s = float(self._driven_s[robot])
            yield Refuse(robot, POSE_REPEATS, Excess("frozen", driven_s, 0.0, "s", robot))

    def check_pose(self, robot: int, before: Pose, pose: Pose) -> Iterator[Finding]:
        """Refuse a pose that contradicts the commands; see `GuardCheck.check_pose`."""
        fault = self.compare_pose(robot, before, pose)
        if fault is not None:
            yield fault

    def check_pause(self, robot: int, before: Pose, pose: Pose, now_ns: int) -> Iterable[Finding]:
        """Report a robot that moves in a pause; see `GuardCheck.check_pause`."""
        standing_pose = self._straying.get(robot, TimedPose(now_ns, before))
        fault = self.compare_pose(robot, standing_pose.pose, pose)
        if fault is None:
            self._straying.pop(robot, None)
            return
        self._straying[robot] = standing_pose
        if now_ns - standing_pose.exposed_ns > UNTRACKED_STOP_S * SECOND:
            yield Moved(robot, fault.text)

    def compare_pose(self, robot: int, before: Pose, pose: Pose) -> Refuse | None:
        """Compare a new pose of a robot with the commands, and record it if it is consistent.

        The first pose after `start` or `replace` counts as consistent, and the motion up to it is
        not counted. Every pose counts as changed: repeated poses may be passed only during pauses.

        Args:
            robot: Index of the robot.
            before: Its last consistent pose.
            pose: Its new pose.

        Returns:
            How the pose contradicts the commands. None if it is consistent.
        """
        since_rest = self._since_rest
        moments = since_rest.moments[robot]
        integrals = since_rest.integrals[:, robot].copy()
        since_rest.integrals_at_change[:, robot] = integrals
        self._driven_s[robot] = 0.0
        travelled = since_rest.travelled[robot].copy()
        if moments:
            travelled += RobotStep.from_poses(before, pose).motion
        motion = np.array([travelled, *integrals])
        contradiction = self._find_contradiction(robot, motion)
        if contradiction is not None:
            slack = self._slack[robot]
            text = describe_fault(contradiction, slack, has_wheels=self._radius > 0)
            return Refuse(robot, text, compute_excess(contradiction, slack, self._mm, robot))
        since_rest.travelled[robot] = travelled
        now_ns = self._times[robot]
        if not moments or now_ns - moments[-1][0] >= MOMENT_SPACING_NS:
            moments.append((now_ns, motion))
        while now_ns - moments[0][0] > COMPARED_MAX_NS:  # the newest is younger: it stays
            moments.popleft()
        return None

    def _find_contradiction(self, robot: int, motion: Floats) -> Floats | None:
        """Find the newest moment since which a robot has moved as no command allows.

        Returns:
            The motion since then and its bounds (3, 3). None if there is no such moment.
        """
        moments = self._since_rest.moments[robot]
        if not moments:
            return None
        motion_since = motion - np.array([moment for _, moment in moments])
        contradicts = are_out_of_bounds(motion_since, self._slack[robot]).any(axis=1)
        if not contradicts.any():
            return None
        return motion_since[np.flatnonzero(contradicts)[-1]]


def exclude_standstill(bounds: Floats) -> Bools:
    """Check whether bounds (2, ..., 3) require that the robot moves, shape (...).

    They do if all rates along the heading, or all turning rates, have the same sign. The rates
    across the heading never do.
    """
    minimum, maximum = bounds
    return ((minimum > 0.0) | (maximum < 0.0)).any(axis=-1)


def are_out_of_bounds(motion: Floats, slack: Floats) -> Bools:
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


def describe_fault(motion: Floats, slack: Floats, has_wheels: bool) -> str:
    """Describe a motion that has a part out of its bounds.

    The command is taken as the middle of the bounds. A part *stands* if it is smaller than
    STANDS_FRACTION of the command. It is *against* the command if their signs differ and the
    command is larger than MEANT_FRACTION of it. The first row that holds is reported:

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
    along_is_out, across_is_out, around_is_out = are_out_of_bounds(motion, slack)
    travelled, minimum, maximum = motion
    commanded = (minimum + maximum) / 2
    is_still = np.abs(travelled) < STANDS_FRACTION * np.abs(commanded)
    is_meant = np.abs(commanded) > MEANT_FRACTION * np.abs(travelled)
    is_against = (travelled * commanded < 0.0) & is_meant
    is_still_along = along_is_out and is_still[0]
    is_still_around = around_is_out and is_still[2] and abs(travelled[0]) < slack[0]
    if is_still_along or is_still_around:
        return adapt_message(DOES_NOT_MOVE, has_wheels)
    if along_is_out and is_against[0]:
        return adapt_message(MOVES_BACKWARD, has_wheels)
    if around_is_out and is_against[2]:
        return adapt_message(TURNS_WRONG_WAY, has_wheels)
    if along_is_out:
        return MOVES_UNEXPLAINED.format(PART_NAMES[0])
    return MOVES_UNEXPLAINED.format(PART_NAMES[1] if across_is_out else PART_NAMES[2])


def compute_excess(motion: Floats, slack: Floats, mm_per_unit: float, robot: int) -> Excess:
    """Describe the part of a motion that is furthest out of its bounds.

    Args:
        motion: The motion and its bounds, shape (3, 3).
        slack: How much a part may exceed its bounds, shape (3,). The excess of
            each part is divided by its slack, so that the parts can be compared.
        mm_per_unit: Millimetres per length unit.
        robot: Index of the robot.
    """
    travelled, minimum, maximum = motion
    lower = minimum - slack
    upper = maximum + slack
    part = int((np.maximum(lower - travelled, travelled - upper) / slack).argmax())
    limit = lower[part] if travelled[part] < lower[part] else upper[part]
    unit, scale = ("rad", 1.0) if part == 2 else ("mm", mm_per_unit)
    return Excess("motion", float(travelled[part]) * scale, float(limit) * scale, unit, robot)


def adapt_message(fault: str, has_wheels: bool) -> str:
    """Return the message about a fault in the words for robots with or without wheels."""
    return fault if has_wheels else MESSAGES_OF_CELLS[fault]
