"""Find out why a robot did not move as commanded, after the run was aborted.

The robot itself may be the cause, but so may the camera, the radio, or two robots with swapped
numbers. The search uses the last frames, and runs once, after the robots were stopped.

For each robot j, z_j (3,) is the difference between its motion in the last RECENT_NS and its
commands, in standard deviations. Three explanations are compared. The smaller the sum, the better:

    one robot i:  the others follow their commands,    sum of |z_j|^2 over j != i
    the camera:   its image shifts, turns and grows,   minimum of sum |z_j - G_j g|^2 + |g|^2
    the radio:    all follow their commands later,     sum of |z_j|^2 with delayed commands

G_j g is the motion of pose j if the image moves at g, in units of LIKELY_RATES. The camera or the
radio is named only if its sum is smaller than the sum for one robot by CLEAR. The radio has to meet
two more conditions. Its value must be below CLEAR for each robot, because a robot that is carried
moves in a way that was never commanded. And it must be better than usual delays, because the other
robots are also late. For the camera, motion is compared as in `drift_check`. For the radio,
commands are integrated with each delay up to LATEST_NS, and the explanation by one robot may use
any delay up to `limits.delay`.

Robots i and j have swapped numbers or bodies if each moves as the other is commanded. This is
assumed if |z_i|^2 + |z_j|^2 is below CLEAR with swapped commands, and larger by CLEAR with their
own. Each motion may have any delay up to `limits.delay`. The program does not test whether only i
moves as j is commanded, because a push of a few millimetres explains that as well. Lengths are in
mm.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, CameraFrame, Floats, Pose
from tetractl.lab.drift_check import BLOCK_NS, DriftCheck
from tetractl.lab.frames import AcceptedFrame, TimedPose, as_shown, timed_poses
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import AS_NO_COMMAND, DOES_NOT_MOVE

RECENT_NS = SECOND // 2
"""Time before the abort over which motion is compared with commands [ns]."""
STEP_NS = SECOND // 40
"""Time step of the integration of commands, and step between two assumed delays [ns]."""
LATEST_NS = SECOND
"""Maximum delay that is assumed for a slow radio [ns]."""
LIKELY_RATES = np.array([100.0, 100.0, 0.1, 0.1])
"""Standard deviations of the image's shift, turn and growth [mm/s, mm/s, rad/s, 1/s]."""
MISFIT_NOISE = np.array([2.0, 2.0, 0.02])
"""Standard deviation of a difference of poses: along, across, around the heading [mm, mm, rad]."""
SHARE = np.array([0.08, 0.04, 0.1])
"""Additional error of a commanded motion, as a fraction of it: along, across, around."""
CLEAR = 9.0
"""Difference between two sums of squares from which the smaller explanation counts as better."""
CAMERA = (
    "all robots are seen to move in a way that no command explains: has the camera or its "
    "origin moved, or does another program drive the robots?"
)
RADIO = "all robots move as they were commanded {:.1f} s earlier: is the radio slow?"
SWAPPED = "{} and {} move as the other is commanded: are their numbers or bodies swapped?"


class AbortCause:
    """The search for the reason why a robot did not move as commanded.

    All poses that the camera reports count, even those that the guard refused.

    Args:
        rules: The rules of the guard, for N robots.
        drift: The check that follows the robots' motion.
        frames: Frames of the last RECENT_NS, oldest first. There is at least one.
    """

    def __init__(self, rules: GuardRules, drift: DriftCheck, frames: Sequence[CameraFrame]) -> None:
        self._rules = rules
        self._drift = drift
        self._frames = [as_shown(frame) for frame in frames]
        self._usual_delays = round(rules.limits.delay * SECOND) // STEP_NS

    def why(self, suspect: int, reason: str) -> str:
        """Name the cause if it is the camera, the radio, or two swapped robot numbers.

        A robot that does not move is itself the cause, because its link, power or wheels have
        failed. Swapped numbers are considered only if the robot moved in a way that no command
        explains. Swapped wheels look different, and have a message of their own.

        Args:
            suspect: Index of the suspected robot.
            reason: The reason of the abort.

        Returns:
            A message for the operator. Empty if the suspected robot itself is the cause, or if
            fewer than two robots were tracked throughout.
        """
        ends = zip(self._frames[0].poses, self._frames[-1].poses, strict=True)
        robots = [i for i, pair in enumerate(ends) if None not in pair]  # shown throughout
        if len(robots) < 2 or suspect not in robots or DOES_NOT_MOVE in reason:
            return ""
        if AS_NO_COMMAND in reason:
            swapped = self._swapped(suspect, robots)
            if swapped:
                return swapped
        return self._common_cause(suspect, robots)

    def _common_cause(self, suspect: int, robots: Sequence[int]) -> str:
        """Return a message that names the camera or the radio, if it explains the motion best.

        The message is empty if one robot explains the motion as well.
        """
        others = np.array(robots) != suspect
        camera, one_robot = self._camera(robots, others)
        radio, one_robot_late, delay_ns = self._radio(robots, others)
        late = radio < min(CLEAR * len(robots), one_robot_late)
        if late and radio + CLEAR < max(one_robot_late, min(camera, one_robot)):
            return RADIO.format(delay_ns / SECOND)
        return CAMERA if camera + CLEAR < one_robot else ""

    def _swapped(self, suspect: int, robots: Sequence[int]) -> str:
        """Return a message that names the robot whose number is swapped with the suspect's.

        The message is empty if there is none.
        """
        as_own = dict(zip(robots, self._misfits(robots, robots), strict=True))
        for robot in robots:
            if robot == suspect:
                continue
            exchanged = sum(self._misfits([suspect, robot], [robot, suspect]))
            if exchanged < min(CLEAR, as_own[suspect] + as_own[robot] - CLEAR):
                first, second = sorted((suspect, robot))
                return SWAPPED.format(self._rules.names[first], self._rules.names[second])
        return ""

    def _misfits(self, robots: Sequence[int], commanded: Sequence[int]) -> Floats:
        """Compute how badly the motions of robots fit the commands of the robots `commanded`.

        Returns:
            |z|^2 of each robot, shape (K,), at the usual delay that fits best.
        """
        return self._squares_by_delay(robots, commanded, self._usual_delays).min(axis=0)

    def _camera(self, robots: Sequence[int], others: Bools) -> tuple[float, float]:
        """Compare two explanations of the motion: the camera image moves, or one robot does.

        Returns:
            The sum of squared residuals under each explanation. The smaller one fits better.
        """
        left_over = [self._drift.left_over(i, ends_of_blocks(self._frames, i)) for i in robots]
        z = np.array([residual for residual, _ in left_over])
        moves = np.vstack([picture for _, picture in left_over]) * LIKELY_RATES
        flat = z.ravel()
        g = np.linalg.solve(moves.T @ moves + np.eye(4), moves.T @ flat)
        camera = ((flat - moves @ g) ** 2).sum() + g @ g
        return camera, (z[others] ** 2).sum()

    def _radio(self, robots: Sequence[int], others: Bools) -> tuple[float, float, int]:
        """Compare two explanations of the motion: a slow radio, or one robot.

        Returns:
            The sum of squares under each explanation, and the delay of the radio that fits best
            [ns].
        """
        nominal = self._usual_delays
        delays = max(LATEST_NS // STEP_NS, nominal + 1)
        squares = self._squares_by_delay(robots, robots, delays)
        radio = squares.sum(axis=1)
        delay = nominal + int(radio[nominal:].argmin())
        one_robot = squares[:nominal, others].sum(axis=1).min()
        return radio[delay], one_robot, delay * STEP_NS

    def _squares_by_delay(
        self, robots: Sequence[int], commanded: Sequence[int], delays: int
    ) -> Floats:
        """Compute |z|^2 of robots for the commands of the robots `commanded`, at several delays.

        Returns:
            The values, shape (delays, K). Commands act later by 0, 1, ... steps of STEP_NS.
        """
        then = self._array(self._frames[0].poses, robots)
        now = self._array(self._frames[-1].poses, robots)
        ended_ns = {i: self._frames[-1].exposed(i) for i in robots}
        spans_ns = [ended_ns[i] - self._frames[0].exposed(i) for i in robots]
        # steps between each robot's own two poses
        own_steps = np.array([max(1, round(span_ns / STEP_NS)) for span_ns in spans_ns])
        steps = int(own_steps.max())
        in_own = (np.arange(steps)[:, None] < own_steps)[:, None]
        # speeds and turning rates (T, 2, N) in steps before each end, the newest first
        commands = self._drift.commands
        sent_before: dict[int, Floats] = {}
        for end_ns in set(ended_ns.values()):
            means = [commands.mean(end_ns - k * STEP_NS, STEP_NS) for k in range(delays + steps)]
            sent_before[end_ns] = np.array(means)
        columns = [
            sent_before[ended_ns[i]][:, :, column]
            for i, column in zip(robots, commanded, strict=True)
        ]
        sent = np.stack(columns, axis=-1)
        sent *= STEP_NS / SECOND
        rows: list[Floats] = []
        for delay in range(delays):
            in_own_span = (sent[delay : delay + steps] * in_own)[::-1]  # oldest first
            rows.append(squares_of(then, now, in_own_span))
        return np.array(rows)

    def _array(self, poses: Sequence[Pose | None], robots: Sequence[int]) -> Floats:
        """Return the poses of tracked robots as an array (K, 3) [mm, mm, rad]."""
        rows: list[tuple[float, float, float]] = []
        for i in robots:
            pose = poses[i]
            if pose is not None:
                mm = self._rules.mm
                rows.append((pose.x * mm, pose.y * mm, pose.heading))
        return np.array(rows)


def ends_of_blocks(frames: Sequence[AcceptedFrame], i: int) -> list[TimedPose]:
    """Select poses of robot i that are at least BLOCK_NS apart, the first pose included."""
    ends: list[TimedPose] = []
    for timed in timed_poses(frames, i):
        if not ends or timed.exposed_ns - ends[-1].exposed_ns >= BLOCK_NS:
            ends.append(timed)
    return ends


def squares_of(then: Floats, now: Floats, sent: Floats) -> Floats:
    """Compute the squared size (n,) of the motion between two poses, in standard deviations.

    Args:
        then: Poses before, shape (n, 3).
        now: Poses afterwards, shape (n, 3).
        sent: Distances and angles that were commanded in between, shape (T, 2, n).
    """
    ways = sent[:, 0]
    turns = sent[:, 1]
    way = ways.sum(0)
    course = then[:, 2] + np.cumsum(turns, axis=0) - turns / 2
    moved = now - then
    dx = moved[:, 0] - (ways * np.cos(course)).sum(0)
    dy = moved[:, 1] - (ways * np.sin(course)).sum(0)
    around = moved[:, 2] - turns.sum(0)
    cos = np.cos(now[:, 2])
    sin = np.sin(now[:, 2])
    off = np.column_stack([cos * dx + sin * dy, cos * dy - sin * dx, np.angle(np.exp(1j * around))])
    size = np.column_stack([way, way, abs(turns).sum(0)])
    return ((off / (MISFIT_NOISE + SHARE * size)) ** 2).sum(axis=1)
