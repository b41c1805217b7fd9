"""Detect poses that drift away from their robots slowly, over the whole trial.

The check compares the motion that a camera shows with the motion that the wheels can have made. The
short window of `motion_check` must allow for every command that may be acting, so it cannot see a
slow drift. Here, a model of each robot is fitted by least squares over the whole trial, to the
motion along, across and around the heading in each block of BLOCK_NS. A robot with the wheel
distance r that is commanded a speed v and a turning rate w moves by

    along:   (1 + s) v + d w r + l w,   across: b v + f w,   around:  (1 + s + k) w + d v / r.

Here, s is the mean error of its wheels, d half the difference between their errors, k the error of
1 / r, b the error of its heading, and (f, l) the point at which its pose is measured. Each of these
is unknown but constant, and has a normal prior. A command acts after a delay between those in
TAPS_NS, so weights of the earlier and later commands are fitted too. The check then looks for a
motion that no command explains, beginning at some moment of the trial:

    one robot:   a constant velocity along, across and around its heading,
    the camera:  one shift, turn and growth of the whole image, for all robots.

For each moment of a grid, the statistic is the decrease of the sum of squares by the best such
motion. (This is a generalised likelihood ratio over the time of a change. A cumulative sum is the
special case of known parameters.) The grid begins with the trial. Therefore a drift that was there
from the start is also found, if no error of a wheel explains it. A lost packet matters more if
successive commands differ more. The uncertainty of a block grows by this difference, and the
uncertainty of blocks up to a quarter of a second later grows by a fifth of it. Lengths are in mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tetractl.core import elementwise
from tetractl.core.clock import SECOND
from tetractl.core.guard_check import GuardCheck
from tetractl.core.guard_findings import Abort, Excess
from tetractl.core.linear import inverse, product, solve
from tetractl.core.poses import Floats, Pose
from tetractl.core.robot_step import PART_NAMES, ZERO_VARIANCE, RobotStep
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import (
    MOVES_UNEXPLAINED,
    WATCHDOG_NS,
    CommandHistory,
    MotionCheck,
)
from tetractl.model.motion.wheel_equations import arc_displacement

BLOCK_NS = SECOND // 20
"""Duration of a block, over which motion is compared with commands [ns]."""
TAPS_NS = (SECOND // 20, 0, 3 * SECOND // 25, SECOND // 4)
"""Delays between which a command acts [ns], the nominal one first."""
COMMAND_DELAYS_NS = (*TAPS_NS, 37 * SECOND // 200)
"""The delays TAPS_NS, and one between the last two, which has no weight in the fit [ns]."""
POSE_NOISE = np.array([0.4, 0.4, 0.005])
"""Standard deviation of a measured pose: x, y, heading [mm, mm, rad]."""
COMPARED_DELAYS = 3
"""Number of delays among which commands are compared, to estimate the effect of a lost packet."""
SLIP_WALK = np.array([1.5, 1.5, 0.02])
"""Random walk of a robot along, across and around its heading [mm, mm, rad, each per sqrt(s)]."""
LOSS_ERROR = np.array([0.15, 0.0, 0.15])
"""Error of a block's motion, as a fraction of the difference between successive commands."""
LATER_ERROR = LOSS_ERROR / 5
"""The part of LOSS_ERROR that remains 0.13 s later, for wheels with a lag of 80 ms."""
CLIP_SIGMAS = 1.7
"""Number of standard deviations to which a residual is limited."""


class DriftColumn:
    """Column indices of the regression matrix that the drift check fits to a robot's motion.

    Column 0 is the motion to be explained: what nominal wheels do not explain. Each further column
    belongs to one unknown, such as the mean error s of the wheels. They follow the order of the
    unknowns in the equations at the head of this module.
    """

    residual = 0
    """The motion that wheels without errors do not explain."""
    speed = 1  # s
    radius = 2  # k
    difference = 3  # d
    heading = 4  # b
    forward = 5  # f
    aside = 6  # l
    taps_along = slice(7, 10)
    """Weights of the delays with which commanded speeds act, without the nominal delay."""
    taps_around = slice(10, 13)
    """Weights of the delays with which commanded turning rates act, without the nominal delay."""
    constants = slice(1, 13)
    """All unknowns that are constant over a trial."""
    velocity = slice(13, 16)
    """A constant velocity of one robot along, across and around its heading."""
    image = slice(16, 20)
    """Shift, turn and growth of the whole camera image."""
    motion = slice(13, 20)
    """The columns `velocity` and `picture` together."""
    width = 20


PRIOR_STD = np.array([0.04, 0.05, 0.04, 0.06, 5.0, 1.0, *[0.2] * 6])
"""Prior standard deviations of s, k, d, b, f, l (see the module) and of the weights of delays."""
ERRORS_OF_CONSTANTS = np.zeros((3, len(PRIOR_STD)))
"""Converts the constants to errors of the left wheel, the right wheel and the heading, (3, 12)."""
ERRORS_OF_CONSTANTS[:, DriftColumn.speed - 1] = (1, 1, 0)
ERRORS_OF_CONSTANTS[:, DriftColumn.difference - 1] = (-1, 1, 0)
ERRORS_OF_CONSTANTS[:, DriftColumn.heading - 1] = (0, 0, 1)
INVERSE_LARGEST = 1 / np.square([500.0, 500.0, 5.0, 500.0, 500.0, 5.0, 5.0])
"""Inverse prior variances of the columns `DriftColumn.motion`, for the largest plausible motion."""
CHANGE_BLOCKS_MIN = 12
"""Minimum number of blocks since the beginning of a change before it is judged here.

Younger changes are left to `motion_check`, because a lost packet makes 7 blocks wrong in the same
way.
"""
MOMENT_SPACING = 5
"""Number of blocks between two moments of the grid."""
MOMENTS_MAX = 32
"""Maximum number of moments of the grid. Beyond it, old moments are thinned out."""
STEADY_ERROR_MAX = 0.25
"""Maximum relative error of wheels for which this check works.

The check assumes a constant error. A dead zone causes a larger one.
"""
SURE_ERRORS = 3.0
"""Number of standard errors by which an estimate must exceed its limit."""
KNOWN_FRACTION_MIN = 0.01
"""Fraction of the prior's variance that a trial must explain for a turning rate to be known."""
DRIFT_TOGETHER = "all robots drift together: has the camera, its origin or its scale moved?"
TURNS_TEXT = (
    "robots turn by themselves while they drive. Either their wheels differ, or their poses "
    "have been false since the start; this trial alone cannot distinguish the two: {}"
)
WRONG_WHEELS = (
    "{}'s left wheel is {:+.0%} off its commanded speed, and its right wheel is {:+.0%} off: "
    "calibrate the robot, and check that the camera does not track another body as this robot"
)


@dataclass(frozen=True, slots=True)
class MeasuredPose:
    """The last accepted pose of a robot, at the beginning or the end of a block of time.

    Attributes:
        pose: The pose.
        exposed_ns: Its time [ns].
        travelled: The robot's motion from its last standstill until then, shape (3,) [mm, mm, rad].
    """

    pose: Pose
    exposed_ns: int
    travelled: Floats


@dataclass(frozen=True, slots=True)
class UnexplainedMotion:
    """The part of the robots' motion that the fitted constants do not explain.

    It is computed for the time since each of G moments.

    Attributes:
        squares: Sums of products of the possible motions with themselves, shape (G, N, 7, 7).
        pulls: Sums of their products with the unexplained motion, shape (G, N, 7).
        noise: Noise of each robot relative to what is expected, at least 1, shape (N, 1).
    """

    squares: Floats
    pulls: Floats
    noise: Floats


class DriftCheck(GuardCheck):
    """A check that aborts a run if robots drift in a way that their wheels cannot cause.

    The check uses the whole trial.

    Args:
        rules: The rules of the guard, for N robots.
        motion: The check that adds up the robots' motion from pose to pose.

    Attributes:
        commands: The commanded speeds [mm/s] and turning rates [rad/s].
        worst_statistic: The statistic at the worst moment of the grid.
        block_count: Number of fitted blocks.
    """

    statistical = True

    def __init__(self, rules: GuardRules, motion: MotionCheck) -> None:
        n_robots = len(rules.names)
        self._names = rules.names
        self._mm = rules.mm_per_unit
        self._wheel_error_max = rules.limits.wheel_error
        self._drift_max = rules.limits.drift
        self._motion = motion
        self._radius = rules.wheel_radius * rules.mm_per_unit
        # variance of a step between two poses: along, across, around
        self._pose_variance = 2 * np.square(elementwise.hypot(POSE_NOISE, rules.sight.pose_std))
        self._is_coarse = rules.sight.has_grid
        self.commands = CommandHistory(2, n_robots)  # speeds [mm/s] and turning rates [rad/s]
        self.worst_statistic = 0.0
        self.block_count = 0
        self._speed_max_mm_s = np.zeros(n_robots)  # greatest speeds commanded [mm/s]
        # the fit: sums of products of the columns, the constants and their covariance
        self._sums = np.zeros((n_robots, DriftColumn.width, DriftColumn.width))
        self._fit = np.zeros((n_robots, len(PRIOR_STD)))
        self._covariance = np.array([np.diag(np.square(PRIOR_STD))] * n_robots)
        # the grid: `_sums` at each moment since which a change is looked for. The keys are the
        # numbers of blocks before the moments.
        self._sums_at = {0: self._sums.copy()}
        # Motion that was clipped from each robot's last block, and that its next block counts. A
        # clipped turn is not kept, because a lost packet may have caused it.
        self._clipped_motion = np.zeros((n_robots, 3))
        # the last accepted poses of the newest frame, and their times
        self._poses: Sequence[Pose | None] = (None,) * n_robots
        self._pose_times: Sequence[int] = (0,) * n_robots
        self.start()

    # ---- observations ----

    def start(self) -> None:
        """Ignore the motion between the last pose and the next one, but keep the fit."""
        self._block_began_ns = 0  # when the block began
        self._block_starts: list[MeasuredPose | None] = [None] * len(self._names)
        self._clipped_motion[:] = 0.0

    def record_transmission(
        self, now_ns: int, speed: Sequence[float], turning: Sequence[float]
    ) -> None:
        """Record a transmission; see `GuardCheck.record_transmission`."""
        speeds = np.array(speed) * self._mm
        self._speed_max_mm_s = np.maximum(self._speed_max_mm_s, speeds)
        self.commands.add(now_ns, np.array([speeds, turning]))

    def check_frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> tuple[Abort, ...]:
        """Check the motion up to a frame; see `GuardCheck.check_frame`.

        Repeated poses are left out. Before a calibration, the relative error of wheels may exceed
        STEADY_ERROR_MAX. Such wheels would explain any drift, so nothing is checked then.
        """
        poses_before = self._poses
        times_before = self._pose_times
        self._poses = poses
        self._pose_times = times
        dt_ns = now_ns - self._block_began_ns
        if dt_ns < BLOCK_NS or self._wheel_error_max > STEADY_ERROR_MAX:
            return ()
        travelled = self._motion.travelled * (self._mm, self._mm, 1.0)
        end_poses: list[MeasuredPose | None] = []
        for i, pose in enumerate(poses):
            # no new measurement, though it has another time
            repeats = (
                pose == poses_before[i] and times[i] != times_before[i] and not self._is_coarse
            )
            if pose is None or repeats:
                end_poses.append(None)
            else:
                end_poses.append(MeasuredPose(pose, times[i], travelled[i]))
        if dt_ns < WATCHDOG_NS:
            self._add_blocks(pair_measured_poses(self._block_starts, end_poses))
            self.block_count += 1
        self._block_began_ns = now_ns
        self._block_starts = end_poses
        abort = self._fit_and_check() if self.block_count % 2 == 0 else None
        return () if abort is None else (abort,)

    # ---- estimates ----

    def predict_pose(self, i: int, pose: Pose, exposed_ns: int, ahead_ns: int) -> Pose:
        """Predict the pose of a robot a short time later, from the commands that were sent.

        Args:
            i: Index of the robot.
            pose: Its pose.
            exposed_ns: The time of the pose [ns].
            ahead_ns: How much later the prediction is [ns].
        """
        acting_until_ns = exposed_ns + ahead_ns - TAPS_NS[0]
        commanded = self.commands.compute_mean(acting_until_ns, ahead_ns)
        speed_mm_s, turning_rad_s = commanded[:, i]
        distance = speed_mm_s / self._mm * ahead_ns / SECOND
        turned = turning_rad_s * ahead_ns / SECOND
        dx, dy = arc_displacement(pose.heading, turned, distance)
        return replace(pose, x=pose.x + dx, y=pose.y + dy, heading=pose.heading + turned)

    def describe_turning(self) -> str:
        """Describe which robots turn off course while they drive.

        A robot counts if it turns by more than SURE_ERRORS standard errors. Either its wheels
        differ, or its poses have been wrong from the start. One trial cannot show which. The
        message is empty if no robot counts.
        """
        descriptions = [
            f"{name} {rate:+.2f} ± {error:.2f} rad/s"
            for name, rate, error in zip(self._names, *self.estimate_turning(), strict=False)
            if abs(rate) > SURE_ERRORS * error
        ]
        return TURNS_TEXT.format(", ".join(descriptions)) if descriptions else ""

    def estimate_turning(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Estimate how fast each robot turns off course when it drives at its highest speed.

        The prior of d is removed, so that trials of one robot can be compared. If d is known to be
        m with the variance q, and its prior variance is p, the rate is v / r m / (1 - q / p) and
        its variance (v / r)^2 q / (1 - q / p).

        Returns:
            The rates and their standard errors [rad/s], N entries each. The error is inf for robots
            that did not drive. Both are empty if no rate is known.
        """
        column = DriftColumn.difference - 1
        rate_per_error = (
            self._speed_max_mm_s / self._radius if self._radius else 0.0 * self._speed_max_mm_s
        )
        variance = self._covariance[:, column, column]
        explained = 1.0 - variance / PRIOR_STD[column] ** 2
        is_known = (explained > KNOWN_FRACTION_MIN) & (rate_per_error > 0.0)
        if not is_known.any():
            return (), ()
        explained = np.where(is_known, explained, 1.0)
        rates = np.where(is_known, rate_per_error * self._fit[:, column] / explained, 0.0)
        errors = np.where(is_known, rate_per_error * np.sqrt(variance / explained), np.inf)
        return tuple(rates.tolist()), tuple(errors.tolist())

    def compute_residual(self, i: int, poses: Sequence[TimedPose]) -> tuple[Floats, Floats]:
        """Compute the part of a robot's motion that commands and wheels do not explain.

        Args:
            i: Index of the robot.
            poses: Its poses, oldest first.

        Returns:
            z (3,), in standard deviations, and its regressors on a shift, turn and growth of the
            image (3, 4) [mm/s, mm/s, rad/s, 1/s].
        """
        columns = np.zeros((3, DriftColumn.width))
        variance = self._pose_variance
        for earlier, later in pairwise(poses):
            dt_ns = later.exposed_ns - earlier.exposed_ns
            step = RobotStep.from_poses(
                earlier.pose, later.pose, dt_ns=dt_ns, until_ns=later.exposed_ns, robot=i
            )
            step_columns, step_variance = self._build_columns(
                [step], step.motion[None] * (self._mm, self._mm, 1.0)
            )
            columns = columns + step_columns[0]
            variance = variance + step_variance[0]
        regressors = columns[:, DriftColumn.constants]
        variance = variance + np.einsum("rp,pq,rq->r", regressors, self._covariance[i], regressors)
        deviation = np.sqrt(variance)
        residual = columns[:, DriftColumn.residual] - np.einsum("rp,p->r", regressors, self._fit[i])
        return residual / deviation, columns[:, DriftColumn.image] / deviation[:, None]

    # ---- the fit ----

    def _find_commands(self, block: RobotStep) -> Floats:
        """Return the speed and turning rate commanded over a block, shape (5, 2).

        There is one row for each delay of COMMAND_DELAYS_NS.
        """
        commands = [
            self.commands.compute_mean(block.until_ns - tap_ns, block.dt_ns)
            for tap_ns in COMMAND_DELAYS_NS
        ]
        return np.array(commands)[:, :, block.robot]

    def _build_columns(self, blocks: Sequence[RobotStep], motions: Floats) -> tuple[Floats, Floats]:
        """Compute the columns of the regression matrix for some blocks of motion.

        Args:
            blocks: The blocks.
            motions: The robots' motions in the blocks, shape (K, 3) [mm, mm, rad].

        Returns:
            Residuals and regressors, shape (K, 3, 20), and variances of the motions, shape (K, 3).
        """
        commanded = np.array([self._find_commands(block) for block in blocks])  # (K, 5, 2)
        commanded_at_taps = commanded[:, : len(TAPS_NS)]
        dt_s = np.array([block.dt_ns / SECOND for block in blocks])
        speed, turning = commanded_at_taps[:, 0].T * dt_s
        radius = self._radius
        delay_effects = (commanded_at_taps[:, 1:] - commanded_at_taps[:, :1]) * dt_s[:, None, None]
        along = 0
        across = 1
        around = 2
        columns = np.zeros((len(blocks), 3, DriftColumn.width))
        columns[:, :, DriftColumn.residual] = motions
        columns[:, along, DriftColumn.residual] -= speed
        columns[:, around, DriftColumn.residual] -= turning
        columns[:, along, DriftColumn.speed] = speed
        columns[:, along, DriftColumn.difference] = turning * radius
        columns[:, along, DriftColumn.aside] = turning
        columns[:, along, DriftColumn.taps_along] = delay_effects[:, :, 0]
        columns[:, across, DriftColumn.heading] = speed
        columns[:, across, DriftColumn.forward] = turning
        columns[:, around, DriftColumn.speed] = turning
        columns[:, around, DriftColumn.radius] = turning
        columns[:, around, DriftColumn.difference] = speed / radius if radius else 0.0
        columns[:, around, DriftColumn.taps_around] = delay_effects[:, :, 1]
        columns[:, :, DriftColumn.velocity] = np.eye(3) * dt_s[:, None, None]
        columns[:, :2, DriftColumn.image] = self._compute_image_motion(
            [block.start_pose for block in blocks], dt_s
        )
        columns[:, around, DriftColumn.image.start + 2] = dt_s
        command_spread = np.ptp(commanded_at_taps[:, :COMPARED_DELAYS], axis=1)
        command_spread = command_spread[:, [0, 0, 1]] * dt_s[:, None]
        later_command_spread = np.abs(
            commanded[:, COMPARED_DELAYS:] - commanded_at_taps[:, :1]
        ).max(axis=1)
        later_command_spread = later_command_spread[:, [0, 0, 1]] * dt_s[:, None]
        variances = (
            SLIP_WALK * SLIP_WALK * dt_s[:, None]
            + (LOSS_ERROR * command_spread) ** 2
            + (LATER_ERROR * later_command_spread) ** 2
        )
        return columns, variances

    def _compute_image_motion(self, poses: Sequence[Pose | None], dt_s: Floats) -> Floats:
        """Compute how poses seem to move if the camera's image shifts, turns and grows.

        Returns:
            The motion along and across the headings, shape (K, 2, 4).
        """
        px, py, heading = np.array([(pose.x, pose.y, pose.heading) for pose in poses if pose]).T
        px = px * self._mm
        py = py * self._mm
        cos = elementwise.cos(heading)
        sin = elementwise.sin(heading)
        ones = np.ones_like(px)
        zero = np.zeros_like(px)
        moves = np.array([[ones, zero, -py, px], [zero, ones, px, py]])
        axes = np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1)
        return product(axes, moves.transpose(2, 0, 1)) * dt_s[:, None, None]

    def _add_blocks(self, blocks: Sequence[RobotStep]) -> None:
        """Add blocks of different robots to the sums.

        Each block is clipped to the range that is expected for it.
        """
        if not blocks:
            return
        robots = [block.robot for block in blocks]
        motions = np.array([block.motion for block in blocks]) + self._clipped_motion[robots]
        columns, variances = self._build_columns(blocks, motions)
        deviations = np.sqrt(self._pose_variance + variances)
        columns /= deviations[:, :, None]
        regressors = columns[:, :, DriftColumn.constants]
        expected = product(regressors, self._fit[robots, :, None])[..., 0]
        fit_variances = product(regressors, self._covariance[robots]) * regressors
        bound = CLIP_SIGMAS * np.sqrt(1 + fit_variances.sum(axis=2))
        residual = columns[:, :, DriftColumn.residual].copy()
        columns[:, :, DriftColumn.residual] = np.clip(residual, expected - bound, expected + bound)
        self._clipped_motion[robots, :2] = (
            (residual - columns[:, :, DriftColumn.residual]) * deviations
        )[:, :2]
        self._sums[robots] += product(columns.swapaxes(1, 2), columns)

    def _fit_and_check(self) -> Abort | None:
        """Repeat the fit, and return the abort of the run if it shows a fault, else None.

        From time to time, a moment is added to the grid.
        """
        sums = self._sums
        self._covariance = inverse(
            sums[:, DriftColumn.constants, DriftColumn.constants]
            + np.diag(1 / np.square(PRIOR_STD))
        )
        self._fit = np.einsum(
            "npq,nq->np", self._covariance, sums[:, DriftColumn.constants, DriftColumn.residual]
        )
        self.worst_statistic = 0.0
        change = self._find_worst_change()
        if self.block_count - max(self._sums_at) >= MOMENT_SPACING:
            self._sums_at[self.block_count] = sums.copy()
            if len(self._sums_at) > MOMENTS_MAX:  # old moments are kept less densely
                for block_count in list(self._sums_at)[1 : 3 * MOMENTS_MAX // 4 : 2]:
                    del self._sums_at[block_count]
        return change if self.worst_statistic > self._drift_max else self._check_wheels()

    # ---- changes ----

    def _find_worst_change(self) -> Abort | None:
        """Find the unexplained motion, and its beginning, that reduce the residuals most.

        It may be the motion of one robot or of the whole image. `worst_statistic` is set to the
        reduction. The result is None while no moment is old enough.
        """
        last_judged_block = self.block_count - CHANGE_BLOCKS_MIN
        sums_at_moments = [
            sums_then for blocks, sums_then in self._sums_at.items() if blocks <= last_judged_block
        ]
        if not sums_at_moments:
            return None
        sums = self._sums
        explained = np.einsum(
            "np,np->n", self._fit, sums[:, DriftColumn.constants, DriftColumn.residual]
        )
        # what is left unexplained in all, shape (N,)
        residual_squares = sums[:, DriftColumn.residual, DriftColumn.residual] - explained
        n_residuals = 3.0 * max(self.block_count, 1)
        changes = self._compute_changes(np.array(sums_at_moments), residual_squares, n_residuals)
        own_columns = slice(0, 3)
        pulls = changes.pulls[..., own_columns]
        own_squares = changes.squares[..., own_columns, own_columns] + np.diag(
            INVERSE_LARGEST[own_columns]
        )
        velocity = solve(own_squares, pulls[..., None])[..., 0]
        gains_of_robots = (pulls * velocity).sum(axis=2)  # (G, N)
        # noise above that assumed
        gains_of_robots /= np.maximum(1.0, (residual_squares - gains_of_robots) / n_residuals)
        image_motion, gain_of_image = self._fit_image_motion(changes)
        gain_of_one_robot = gains_of_robots.max(axis=1)
        worst_moment = int(np.maximum(gain_of_one_robot, gain_of_image).argmax())
        self.worst_statistic = float(
            max(gain_of_one_robot[worst_moment], gain_of_image[worst_moment])
        )
        excess = Excess("drift", self.worst_statistic, self._drift_max)
        i = int(gains_of_robots[worst_moment].argmax())
        if gain_of_image[worst_moment] > gain_of_one_robot[worst_moment]:
            gains = self._compute_gains(changes, worst_moment, image_motion[worst_moment])
            i = int(gains.argmax())
            # the motion of the image explains the motion of the other robots as well
            if gains.sum() - gains[i] > self._drift_max / 4:
                all_robots = range(len(self._names))
                return Abort(DRIFT_TOGETHER, tuple(all_robots), excess=excess)
        strongest = int((pulls[worst_moment, i] * velocity[worst_moment, i]).argmax())
        message = f"{self._names[i]} {MOVES_UNEXPLAINED.format(PART_NAMES[strongest])}"
        return Abort(message, (i,), suspect=i, excess=replace(excess, robot=i))

    def _compute_changes(
        self, sums_at_moments: Floats, residual_squares: Floats, n_residuals: float
    ) -> UnexplainedMotion:
        """Compute the motion that the fitted constants do not explain, since some moments.

        Args:
            sums_at_moments: The sums of products at these moments, shape (G, N, 20, 20).
            residual_squares: Sum of each robot's remaining squared residuals, shape (N,).
            n_residuals: Number of these residuals.
        """
        sums_since = self._sums - sums_at_moments
        cross_sums = sums_since[..., DriftColumn.constants, DriftColumn.motion]
        explained = product(product(cross_sums.swapaxes(2, 3), self._covariance), cross_sums)
        unexplained = sums_since[..., DriftColumn.motion, DriftColumn.motion] - explained
        pulls = (
            sums_since[..., DriftColumn.motion, DriftColumn.residual]
            - product(self._fit[:, None], cross_sums)[..., 0, :]
        )
        noise = np.maximum(1.0, residual_squares / n_residuals)[:, None]
        return UnexplainedMotion(unexplained, pulls, noise)

    def _fit_image_motion(self, changes: UnexplainedMotion) -> tuple[Floats, Floats]:
        """Find, for each moment, the image motion that best explains the motion of all robots.

        The results are the motion (G, 4) and the reduction of the residuals (G,). The reduction is
        0 if there is only one robot.
        """
        image_columns = slice(3, 7)
        total_pulls = (changes.pulls[..., image_columns] / changes.noise).sum(axis=1)
        squares = (
            changes.squares[..., image_columns, image_columns] / changes.noise[..., None]
        ).sum(axis=1)
        squares = squares + np.diag(INVERSE_LARGEST[image_columns])
        image_motion = solve(squares, total_pulls[..., None])[..., 0]
        if len(self._names) == 1:
            return image_motion, np.zeros(len(image_motion))
        return image_motion, (total_pulls * image_motion).sum(axis=1)

    def _compute_gains(
        self, changes: UnexplainedMotion, moment: int, image_motion: Floats
    ) -> Floats:
        """Compute how much a motion of the image since moment g reduces each robot's residuals.

        The motion has shape (4,), the result (N,).
        """
        image_columns = slice(3, 7)
        pulls = changes.pulls[moment][:, image_columns]
        squares = changes.squares[moment][:, image_columns, image_columns]
        margin = 2 * pulls - np.einsum("npq,q->np", squares, image_motion)
        return np.einsum("np,p->n", margin, image_motion) / changes.noise[:, 0]

    # ---- wheels ----

    def _check_wheels(self) -> Abort | None:
        """Return an abort if a robot's wheels or heading are surely too wrong, else None."""
        errors = product(self._fit, ERRORS_OF_CONSTANTS.T)  # (N, 3)
        variances = np.einsum(
            "ep,npq,eq->ne", ERRORS_OF_CONSTANTS, self._covariance, ERRORS_OF_CONSTANTS
        )
        sure_errors = np.abs(errors) - SURE_ERRORS * np.sqrt(variances)
        is_beyond = sure_errors > self._wheel_error_max
        for i, name in enumerate(self._names):
            if not is_beyond[i].any():
                continue
            *_, heading_is_wrong = is_beyond[i]
            excess = Excess("wheels", float(sure_errors[i].max()), self._wheel_error_max, robot=i)
            if heading_is_wrong:
                return Abort(f"{name} {MOVES_UNEXPLAINED.format(PART_NAMES[1])}", excess=excess)
            left_error, right_error, _ = errors[i]
            return Abort(WRONG_WHEELS.format(name, left_error, right_error), excess=excess)
        return None


def pair_measured_poses(
    starts: Sequence[MeasuredPose | None], ends: Sequence[MeasuredPose | None]
) -> list[RobotStep]:
    """Compute the motion of each robot that has poses at both ends of a block of time.

    Args:
        starts: Poses at the beginning of the block, shape (N,).
        ends: Poses at its end, shape (N,).
    """
    blocks: list[RobotStep] = []
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if start is not None and end is not None and end.exposed_ns > start.exposed_ns:
            motion = end.travelled - start.travelled
            dt_ns = end.exposed_ns - start.exposed_ns
            blocks.append(RobotStep(motion, ZERO_VARIANCE, dt_ns, end.exposed_ns, i, start.pose))
    return blocks
