"""Find out why a robot did not move as commanded, after the run was aborted.

The robot itself may be the cause, but so may the camera, the radio, or two robots with swapped
numbers. The search uses the last frames, and runs once, after the robots were stopped.

For each robot j, z_j (3,) is the difference between its motion in the last RECENT_NS and its
commands, in standard deviations. Three explanations are compared. The smaller the sum, the better:

    one robot i:  the others follow their commands,    sum of |z_j|^2 over j != i
    the camera:   its image shifts, turns and grows,   minimum of sum |z_j - G_j g|^2 + |g|^2
    the radio:    all follow their commands later,     sum of |z_j|^2 with delayed commands

G_j g is the motion of pose j if the image moves at g, in units of LIKELY_RATES. The camera or the
radio is named only if its sum is smaller than the sum for one robot by CLEAR_DIFFERENCE. The radio
has to meet two more conditions. Its value must be below CLEAR_DIFFERENCE for each robot, because a
robot that is carried moves in a way that was never commanded. And it must be better than usual
delays, because the other robots are also late. For the camera, motion is compared as in
`drift_check`. For the radio, commands are integrated with each delay up to DELAY_MAX_NS, and the
explanation by one robot may use any delay up to `limits.delay`.

Robots i and j have swapped numbers or bodies if each moves as the other is commanded. This is
assumed if |z_i|^2 + |z_j|^2 is below CLEAR_DIFFERENCE with swapped commands, and larger by
CLEAR_DIFFERENCE with their own. Each motion may have any delay up to `limits.delay`. The program
does not test whether only i moves as j is commanded, because a push of a few millimetres explains
that as well. Lengths are in mm.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, CameraFrame, Floats, Pose
from tetractl.lab.drift_check import BLOCK_NS, DriftCheck
from tetractl.lab.frames import AcceptedFrame, TimedPose, accept_all_poses, collect_timed_poses
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import AS_NO_COMMAND, DOES_NOT_MOVE

RECENT_NS = SECOND // 2
"""Time before the abort over which motion is compared with commands [ns]."""
STEP_NS = SECOND // 40
"""Time step of the integration of commands, and step between two assumed delays [ns]."""
DELAY_MAX_NS = SECOND
"""Maximum delay that is assumed for a slow radio [ns]."""
LIKELY_RATES = np.array([100.0, 100.0, 0.1, 0.1])
"""Standard deviations of the image's shift, turn and growth [mm/s, mm/s, rad/s, 1/s]."""
POSE_DIFFERENCE_STD = np.array([2.0, 2.0, 0.02])
"""Standard deviation of a difference of poses: along, across, around the heading [mm, mm, rad]."""
MOTION_ERROR = np.array([0.08, 0.04, 0.1])
"""Additional error of a commanded motion, as a fraction of it: along, across, around."""
CLEAR_DIFFERENCE = 9.0
"""Difference between two sums of squares from which the smaller explanation counts as better."""
CAMERA_MOVED = (
    "all robots are seen to move in a way that no command explains: has the camera or its "
    "origin moved, or does another program drive the robots?"
)
RADIO_SLOW = "all robots move as they were commanded {:.1f} s earlier: is the radio slow?"
NUMBERS_SWAPPED = (
    "{} and {} follow each other's commands: are their numbers or bodies swapped in the spec?"
)


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
        self._frames = [accept_all_poses(frame) for frame in frames]
        self._usual_delays = round(rules.limits.delay * SECOND) // STEP_NS

    def explain(self, suspect: int, reason: str) -> str:
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
        end_poses = zip(self._frames[0].poses, self._frames[-1].poses, strict=True)
        robots = [i for i, first_and_last in enumerate(end_poses) if None not in first_and_last]
        if len(robots) < 2 or suspect not in robots or DOES_NOT_MOVE in reason:
            return ""
        if AS_NO_COMMAND in reason:
            message = self._explain_by_swapped_numbers(suspect, robots)
            if message:
                return message
        return self._explain_by_common_cause(suspect, robots)

    def _explain_by_common_cause(self, suspect: int, robots: Sequence[int]) -> str:
        """Return a message that names the camera or the radio, if it explains the motion best.

        The message is empty if one robot explains the motion as well.
        """
        is_other = np.array(robots) != suspect
        camera, one_robot = self._compare_with_camera(robots, is_other)
        radio, one_robot_late, delay_ns = self._compare_with_radio(robots, is_other)
        radio_explains = radio < min(CLEAR_DIFFERENCE * len(robots), one_robot_late)
        if radio_explains and radio + CLEAR_DIFFERENCE < max(
            one_robot_late, min(camera, one_robot)
        ):
            return RADIO_SLOW.format(delay_ns / SECOND)
        return CAMERA_MOVED if camera + CLEAR_DIFFERENCE < one_robot else ""

    def _explain_by_swapped_numbers(self, suspect: int, robots: Sequence[int]) -> str:
        """Return a message that names the robot whose number is swapped with the suspect's.

        The message is empty if there is none.
        """
        misfit_by_robot = dict(zip(robots, self._compute_misfits(robots, robots), strict=True))
        for robot in robots:
            if robot == suspect:
                continue
            swapped_misfit = sum(self._compute_misfits([suspect, robot], [robot, suspect]))
            if swapped_misfit < min(
                CLEAR_DIFFERENCE,
                misfit_by_robot[suspect] + misfit_by_robot[robot] - CLEAR_DIFFERENCE,
            ):
                lower_index, higher_index = sorted((suspect, robot))
                return NUMBERS_SWAPPED.format(
                    self._rules.names[lower_index], self._rules.names[higher_index]
                )
        return ""

    def _compute_misfits(self, robots: Sequence[int], commanded: Sequence[int]) -> Floats:
        """Compute how badly the motions of robots fit the commands of the robots `commanded`.

        Returns:
            |z|^2 of each robot, shape (K,), at the usual delay that fits best.
        """
        return self._compute_squares_by_delay(robots, commanded, self._usual_delays).min(axis=0)

    def _compare_with_camera(self, robots: Sequence[int], is_other: Bools) -> tuple[float, float]:
        """Compare two explanations of the motion: the camera image moves, or one robot does.

        Returns:
            The sum of squared residuals under each explanation. The smaller one fits better.
        """
        residuals_and_regressors = [
            self._drift.compute_residual(i, select_spaced_poses(self._frames, i)) for i in robots
        ]
        residuals = np.array([residual for residual, _ in residuals_and_regressors])
        regressors = (
            np.vstack([image_regressor for _, image_regressor in residuals_and_regressors])
            * LIKELY_RATES
        )
        stacked_residuals = residuals.ravel()
        image_motion = np.linalg.solve(
            regressors.T @ regressors + np.eye(4), regressors.T @ stacked_residuals
        )
        camera = (
            (stacked_residuals - regressors @ image_motion) ** 2
        ).sum() + image_motion @ image_motion
        return camera, (residuals[is_other] ** 2).sum()

    def _compare_with_radio(
        self, robots: Sequence[int], is_other: Bools
    ) -> tuple[float, float, int]:
        """Compare two explanations of the motion: a slow radio, or one robot.

        Returns:
            The sum of squares under each explanation, and the delay of the radio that fits best
            [ns].
        """
        n_usual_delays = self._usual_delays
        n_delays = max(DELAY_MAX_NS // STEP_NS, n_usual_delays + 1)
        squares = self._compute_squares_by_delay(robots, robots, n_delays)
        radio = squares.sum(axis=1)
        delay = n_usual_delays + int(radio[n_usual_delays:].argmin())
        one_robot = squares[:n_usual_delays, is_other].sum(axis=1).min()
        return radio[delay], one_robot, delay * STEP_NS

    def _compute_squares_by_delay(
        self, robots: Sequence[int], commanded: Sequence[int], n_delays: int
    ) -> Floats:
        """Compute |z|^2 of robots for the commands of the robots `commanded`, at several delays.

        Returns:
            The values, shape (delays, K). Commands act later by 0, 1, ... steps of STEP_NS.
        """
        first_poses = self._stack_poses(self._frames[0].poses, robots)
        last_poses = self._stack_poses(self._frames[-1].poses, robots)
        end_ns_by_robot = {i: self._frames[-1].pose_time_ns(i) for i in robots}
        spans_ns = [end_ns_by_robot[i] - self._frames[0].pose_time_ns(i) for i in robots]
        # steps between each robot's own two poses
        own_steps = np.array([max(1, round(span_ns / STEP_NS)) for span_ns in spans_ns])
        steps_max = int(own_steps.max())
        is_own_step = (np.arange(steps_max)[:, None] < own_steps)[:, None]
        # speeds and turning rates (T, 2, N) in steps before each end, the newest first
        commands = self._drift.commands
        rates_by_end_ns: dict[int, Floats] = {}
        for end_ns in set(end_ns_by_robot.values()):
            rates = [
                commands.compute_mean(end_ns - k * STEP_NS, STEP_NS)
                for k in range(n_delays + steps_max)
            ]
            rates_by_end_ns[end_ns] = np.array(rates)
        columns = [
            rates_by_end_ns[end_ns_by_robot[i]][:, :, column]
            for i, column in zip(robots, commanded, strict=True)
        ]
        commanded_motion = np.stack(columns, axis=-1)
        commanded_motion *= STEP_NS / SECOND
        squares: list[Floats] = []
        for delay in range(n_delays):
            newest_first = commanded_motion[delay : delay + steps_max] * is_own_step
            squares.append(compute_squares(first_poses, last_poses, newest_first[::-1]))
        return np.array(squares)

    def _stack_poses(self, poses: Sequence[Pose | None], robots: Sequence[int]) -> Floats:
        """Return the poses of tracked robots as an array (K, 3) [mm, mm, rad]."""
        pose_rows: list[tuple[float, float, float]] = []
        for i in robots:
            pose = poses[i]
            if pose is not None:
                mm_per_unit = self._rules.mm_per_unit
                pose_rows.append((pose.x * mm_per_unit, pose.y * mm_per_unit, pose.heading))
        return np.array(pose_rows)


def select_spaced_poses(frames: Sequence[AcceptedFrame], robot: int) -> list[TimedPose]:
    """Select poses of robot i that are at least BLOCK_NS apart, the first pose included."""
    selected: list[TimedPose] = []
    for timed in collect_timed_poses(frames, robot):
        if not selected or timed.exposed_ns - selected[-1].exposed_ns >= BLOCK_NS:
            selected.append(timed)
    return selected


def compute_squares(first_poses: Floats, last_poses: Floats, commanded: Floats) -> Floats:
    """Compute the squared size (n,) of the motion between two poses, in standard deviations.

    Args:
        first_poses: Poses before, shape (n, 3).
        last_poses: Poses afterwards, shape (n, 3).
        commanded: Distances and angles that were commanded in between, shape (T, 2, n).
    """
    distances = commanded[:, 0]
    turns = commanded[:, 1]
    distance = distances.sum(0)
    headings = first_poses[:, 2] + np.cumsum(turns, axis=0) - turns / 2
    measured_motion = last_poses - first_poses
    dx = measured_motion[:, 0] - (distances * np.cos(headings)).sum(0)
    dy = measured_motion[:, 1] - (distances * np.sin(headings)).sum(0)
    turn_difference = measured_motion[:, 2] - turns.sum(0)
    cos = np.cos(last_poses[:, 2])
    sin = np.sin(last_poses[:, 2])
    difference = np.column_stack(
        [cos * dx + sin * dy, cos * dy - sin * dx, np.angle(np.exp(1j * turn_difference))]
    )
    size = np.column_stack([distance, distance, abs(turns).sum(0)])
    return ((difference / (POSE_DIFFERENCE_STD + MOTION_ERROR * size)) ** 2).sum(axis=1)
