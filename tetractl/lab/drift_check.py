"""Detect poses that drift away from their robots slowly, over the whole trial.

The check compares the motion that a camera shows with the motion that the wheels can have made. The
short window of `motion_check` must allow for every command that may be acting, so it cannot see a
slow drift. Here, a model of each robot is fitted by least squares over the whole trial, to the
motion along, across and around the heading in each block of BLOCK_NS. A robot with the wheel
distance r that is commanded a speed v and a turning rate w moves by

    along:   (1 + s) v + d w r + l w,   across: b v + f w,   around:  (1 + s + k) w + d v / r.

Here, s is the mean error of its wheels, d half the difference between their errors, k the error of
1 / r, b the error of its heading, and (f, l) the point at which its pose is measured. Each of these
is unknown but constant, and has a normal prior. A command acts after a delay between the TAPS, so
weights of the earlier and later commands are fitted too. The check then looks for a motion that no
command explains, beginning at some moment of the trial:

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
from tetractl.core.robot_step import EXACT, PARTS, RobotStep
from tetractl.lab.frames import TimedPose
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.motion_check import (
    ANOTHER,
    WATCHDOG_NS,
    CommandHistory,
    MotionCheck,
)
from tetractl.model.motion.wheel_equations import rolled

BLOCK_NS = SECOND // 20
"""Duration of a block, over which motion is compared with commands [ns]."""
TAPS_NS = (SECOND // 20, 0, 3 * SECOND // 25, SECOND // 4)
"""Delays between which a command acts [ns], the nominal one first."""
BEFORE_NS = (*TAPS_NS, 37 * SECOND // 200)
"""The delays TAPS_NS, and one between the last two, which has no weight in the fit [ns]."""
NOISE = np.array([0.4, 0.4, 0.005])
"""Standard deviation of a measured pose: x, y, heading [mm, mm, rad]."""
LATEST = 3
"""Number of delays among which commands are compared, to estimate the effect of a lost packet."""
SLIP = np.array([1.5, 1.5, 0.02])
"""Random walk of a robot along, across and around its heading [mm, mm, rad, each per sqrt(s)]."""
LOST = np.array([0.15, 0.0, 0.15])
"""Error of a block's motion, as a fraction of the difference between successive commands."""
LAGS = LOST / 5
"""The part of this error that remains 0.13 s later, for wheels with a lag of 80 ms."""
CLIP = 1.7
"""Number of standard deviations to which a residual is limited."""


class At:
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
    picture = slice(16, 20)
    """Shift, turn and growth of the whole camera image."""
    motion = slice(13, 20)
    """The columns `velocity` and `picture` together."""
    width = 20


PRIOR = np.array([0.04, 0.05, 0.04, 0.06, 5.0, 1.0, *[0.2] * 6])
"""Prior standard deviations of s, k, d, b, f, l (see the module) and of the weights of delays."""
ERRORS = np.zeros((3, len(PRIOR)))
"""Converts the constants to errors of the left wheel, the right wheel and the heading, (3, 12)."""
ERRORS[:, At.speed - 1] = (1, 1, 0)
ERRORS[:, At.difference - 1] = (-1, 1, 0)
ERRORS[:, At.heading - 1] = (0, 0, 1)
LARGEST = 1 / np.square([500.0, 500.0, 5.0, 500.0, 500.0, 5.0, 5.0])
"""Inverse prior variances of the columns `motion`, from the largest motions [mm/s, rad/s, 1/s]."""
LEAST_BLOCKS = 12
"""Minimum number of blocks since the beginning of a change before it is judged here.

Younger changes are left to `motion_check`, because a lost packet makes 7 blocks wrong in the same
way.
"""
SPACING = 5
"""Number of blocks between two moments of the grid."""
MOMENTS_MAX = 32
"""Maximum number of moments of the grid. Beyond it, old moments are thinned out."""
STEADY = 0.25
"""Maximum relative error of wheels for which this check works.

The check assumes a constant error. A dead zone causes a larger one.
"""
SURE_ERRORS = 3.0
"""Number of standard errors by which an estimate must exceed its limit."""
LEAST_KNOWN = 0.01
"""Fraction of the prior's variance that a trial must explain for a turning rate to be known."""
TOGETHER = "all robots drift together: has the camera, its origin or its scale moved?"
TURNS_TEXT = (
    "robots turn by themselves while they drive. Either their wheels differ, or their poses "
    "have been false since the start; this trial alone cannot distinguish the two: {}"
)
WRONG = (
    "{}'s left wheel is {:+.0%} off its commanded speed, and its right one {:+.0%}: is it "
    "calibrated, or does the camera track another body as this robot?"
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
class Changes:
    """The part of the robots' motion that the fitted constants do not explain, since G moments.

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

    It uses the whole trial. `motion` adds up the motion of the N robots of `rules`. `worst` is the
    statistic at the worst moment of the grid, and `blocks` the number of fitted blocks.
    """

    statistical = True

    def __init__(self, rules: GuardRules, motion: MotionCheck) -> None:
        robots = len(rules.names)
        self._names = rules.names
        self._mm = rules.mm
        self._share = rules.limits.wheel_error
        self._limit = rules.limits.drift
        self._motion = motion
        self._radius = rules.wheel_radius * rules.mm
        # of a step between two poses, each part
        self._variance = 2 * np.square(elementwise.hypot(NOISE, rules.sight.spread))
        self._coarse = rules.sight.coarse
        self.commands = CommandHistory(2, robots)  # speeds [mm/s] and turning rates [rad/s]
        self.worst = 0.0
        self.blocks = 0
        self._fastest = np.zeros(robots)  # greatest speeds commanded [mm/s]
        # the fit: sums of products of the columns, the constants and their covariance
        self._sums = np.zeros((robots, At.width, At.width))
        self._fit = np.zeros((robots, len(PRIOR)))
        self._spread = np.array([np.diag(np.square(PRIOR))] * robots)
        # the grid: sums at moments since which a change is looked for, by the blocks before each
        self._grid = {0: self._sums.copy()}
        # ways beyond CLIP, counted in the next blocks; a turn may be of a lost packet
        self._carried = np.zeros((robots, 3))
        # the last accepted poses of the newest frame, and their times
        self._poses: Sequence[Pose | None] = (None,) * robots
        self._times: Sequence[int] = (0,) * robots
        self.start()

    # ---- what is taken ----

    def start(self) -> None:
        """Ignore the motion between the last pose and the next one, but keep the fit."""
        self._began_ns = 0  # when the block began
        self._starts: list[MeasuredPose | None] = [None] * len(self._names)
        self._carried[:] = 0.0

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Record that an action was transmitted to the robots; see `GuardCheck.sent`."""
        speeds = np.array(speed) * self._mm
        self._fastest = np.maximum(self._fastest, speeds)
        self.commands.sent(now_ns, np.array([speeds, turning]))

    def frame(
        self, now_ns: int, times: Sequence[int], poses: Sequence[Pose | None]
    ) -> tuple[Abort, ...]:
        """Check the motion up to a frame; see `GuardCheck.frame`.

        Repeated poses are left out. Before a calibration, wheels may be wrong by more than STEADY.
        Such wheels would explain any drift, so nothing is checked then.
        """
        poses_before = self._poses
        times_before = self._times
        self._poses = poses
        self._times = times
        dt_ns = now_ns - self._began_ns
        if dt_ns < BLOCK_NS or self._share > STEADY:
            return ()
        ways = self._motion.travelled * (self._mm, self._mm, 1.0)
        ends: list[MeasuredPose | None] = []
        for i, pose in enumerate(poses):
            # no new measurement, though it has another time
            repeats = pose == poses_before[i] and times[i] != times_before[i] and not self._coarse
            if pose is None or repeats:
                ends.append(None)
            else:
                ends.append(MeasuredPose(pose, times[i], ways[i]))
        if dt_ns < WATCHDOG_NS:
            self._add(ended_blocks(self._starts, ends))
            self.blocks += 1
        self._began_ns = now_ns
        self._starts = ends
        fault = self._fit_and_judge() if self.blocks % 2 == 0 else None
        return () if fault is None else (fault,)

    # ---- what is known ----

    def carried(self, i: int, pose: Pose, then_ns: int, late_ns: int) -> Pose:
        """Predict where robot i is somewhat later, from the commands that were sent.

        Args:
            i: Index of the robot.
            pose: Its pose.
            then_ns: The time of the pose [ns].
            late_ns: How much later the prediction is [ns].
        """
        v, w = self.commands.mean(then_ns + late_ns - TAPS_NS[0], late_ns)[:, i]
        way = v / self._mm * late_ns / SECOND
        turned = w * late_ns / SECOND
        dx, dy = rolled(pose.heading, turned, way)
        return replace(pose, x=pose.x + dx, y=pose.y + dy, heading=pose.heading + turned)

    def turns(self) -> str:
        """Return a message about robots that turn off course while they drive.

        A robot counts if it turns by more than SURE_ERRORS standard errors. Either its wheels
        differ, or its poses have been wrong from the start. One trial cannot show which. The
        message is empty if no robot counts.
        """
        texts = [
            f"{name} {rate:+.2f} ± {error:.2f} rad/s"
            for name, rate, error in zip(self._names, *self.turning(), strict=False)
            if abs(rate) > SURE_ERRORS * error
        ]
        return TURNS_TEXT.format(", ".join(texts)) if texts else ""

    def turning(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return how fast each robot turns off course when it drives at its highest command.

        The prior of d is removed, so that trials of one robot can be compared. If d is known to be
        m with the variance q, and its prior variance is p, the rate is v / r m / (1 - q / p) and
        its variance (v / r)^2 q / (1 - q / p).

        Returns:
            The rates and their standard errors [rad/s], N entries each. The error is inf for robots
            that did not drive. Both are empty if no rate is known.
        """
        d = At.difference - 1
        per = self._fastest / self._radius if self._radius else 0.0 * self._fastest
        variance = self._spread[:, d, d]
        explained = 1.0 - variance / PRIOR[d] ** 2
        is_known = (explained > LEAST_KNOWN) & (per > 0.0)
        if not is_known.any():
            return (), ()
        explained = np.where(is_known, explained, 1.0)
        rates = np.where(is_known, per * self._fit[:, d] / explained, 0.0)
        errors = np.where(is_known, per * np.sqrt(variance / explained), np.inf)
        return tuple(rates.tolist()), tuple(errors.tolist())

    def left_over(self, i: int, poses: Sequence[TimedPose]) -> tuple[Floats, Floats]:
        """Compute the part of a robot's motion that commands and wheels do not explain.

        Args:
            i: Index of the robot.
            poses: Its poses, oldest first.

        Returns:
            z (3,), in standard deviations, and its regressors on a shift, turn and growth of the
            image (3, 4) [mm/s, mm/s, rad/s, 1/s].
        """
        total = np.zeros((3, At.width))
        variance = self._variance
        for then, now in pairwise(poses):
            dt_ns = now.exposed_ns - then.exposed_ns
            step = RobotStep.between(
                then.pose, now.pose, dt_ns=dt_ns, until_ns=now.exposed_ns, robot=i
            )
            x, walk = self._regressors([step], step.way[None] * (self._mm, self._mm, 1.0))
            total = total + x[0]
            variance = variance + walk[0]
        regressors = total[:, At.constants]
        variance = variance + np.einsum("rp,pq,rq->r", regressors, self._spread[i], regressors)
        spread = np.sqrt(variance)
        residual = total[:, At.residual] - np.einsum("rp,p->r", regressors, self._fit[i])
        return residual / spread, total[:, At.picture] / spread[:, None]

    # ---- the fit ----

    def _commanded(self, block: RobotStep) -> Floats:
        """Return the speed and turning rate commanded over a block, for each delay of BEFORE_NS.

        The shape is (5, 2).
        """
        means = [self.commands.mean(block.until_ns - tap_ns, block.dt_ns) for tap_ns in BEFORE_NS]
        return np.array(means)[:, :, block.robot]

    def _regressors(self, blocks: Sequence[RobotStep], motions: Floats) -> tuple[Floats, Floats]:
        """Compute residuals and regressors of blocks with the `motions` (K, 3), and variances.

        Returns:
            Residuals and regressors, shape (K, 3, 20), and variances of the motions, shape (K, 3).
        """
        commanded = np.array([self._commanded(block) for block in blocks])  # (K, 5, 2)
        sent = commanded[:, : len(TAPS_NS)]
        dt_s = np.array([block.dt_ns / SECOND for block in blocks])
        v, w = sent[:, 0].T * dt_s
        r = self._radius
        later = (sent[:, 1:] - sent[:, :1]) * dt_s[:, None, None]
        along = 0
        across = 1
        around = 2
        x = np.zeros((len(blocks), 3, At.width))
        x[:, :, At.residual] = motions
        x[:, along, At.residual] -= v
        x[:, around, At.residual] -= w
        x[:, along, At.speed] = v
        x[:, along, At.difference] = w * r
        x[:, along, At.aside] = w
        x[:, along, At.taps_along] = later[:, :, 0]
        x[:, across, At.heading] = v
        x[:, across, At.forward] = w
        x[:, around, At.speed] = w
        x[:, around, At.radius] = w
        x[:, around, At.difference] = v / r if r else 0.0
        x[:, around, At.taps_around] = later[:, :, 1]
        x[:, :, At.velocity] = np.eye(3) * dt_s[:, None, None]
        x[:, :2, At.picture] = self._picture_moves([block.before for block in blocks], dt_s)
        x[:, around, At.picture.start + 2] = dt_s
        unlike = np.ptp(sent[:, :LATEST], axis=1)[:, [0, 0, 1]] * dt_s[:, None]
        before = np.abs(commanded[:, LATEST:] - sent[:, :1]).max(axis=1)[:, [0, 0, 1]]
        before = before * dt_s[:, None]
        walk = SLIP * SLIP * dt_s[:, None] + (LOST * unlike) ** 2 + (LAGS * before) ** 2
        return x, walk

    def _picture_moves(self, poses: Sequence[Pose | None], dt_s: Floats) -> Floats:
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

    def _add(self, blocks: Sequence[RobotStep]) -> None:
        """Add blocks of different robots to the sums.

        Each block is clipped to the range that is expected for it.
        """
        if not blocks:
            return
        robots = [block.robot for block in blocks]
        motions = np.array([block.way for block in blocks]) + self._carried[robots]
        x, walk = self._regressors(blocks, motions)
        spread = np.sqrt(self._variance + walk)
        x /= spread[:, :, None]
        regressors = x[:, :, At.constants]
        expected = product(regressors, self._fit[robots, :, None])[..., 0]
        uncertain = product(regressors, self._spread[robots]) * regressors
        bound = CLIP * np.sqrt(1 + uncertain.sum(axis=2))
        residual = x[:, :, At.residual].copy()
        x[:, :, At.residual] = np.clip(residual, expected - bound, expected + bound)
        self._carried[robots, :2] = ((residual - x[:, :, At.residual]) * spread)[:, :2]
        self._sums[robots] += product(x.swapaxes(1, 2), x)

    def _fit_and_judge(self) -> Abort | None:
        """Repeat the fit, and return the abort of the run if it shows a fault, else None.

        From time to time, a moment is added to the grid.
        """
        sums = self._sums
        self._spread = inverse(sums[:, At.constants, At.constants] + np.diag(1 / np.square(PRIOR)))
        self._fit = np.einsum("npq,nq->np", self._spread, sums[:, At.constants, At.residual])
        self.worst = 0.0
        change = self._find_worst_change()
        if self.blocks - max(self._grid) >= SPACING:
            self._grid[self.blocks] = sums.copy()
            if len(self._grid) > MOMENTS_MAX:  # old moments are kept less densely
                for moment in list(self._grid)[1 : 3 * MOMENTS_MAX // 4 : 2]:
                    del self._grid[moment]
        return change if self.worst > self._limit else self._wrong_wheels()

    # ---- changes ----

    def _find_worst_change(self) -> Abort | None:
        """Find the unexplained motion, and its beginning, that reduce the residuals most.

        It may be the motion of one robot or of the whole image. `worst` is set to the reduction.
        The result is None while no moment is old enough.
        """
        youngest = self.blocks - LEAST_BLOCKS
        old = [sums_then for blocks, sums_then in self._grid.items() if blocks <= youngest]
        if not old:
            return None
        sums = self._sums
        fitted = np.einsum("np,np->n", self._fit, sums[:, At.constants, At.residual])
        squares = sums[:, At.residual, At.residual] - fitted  # (N,) what is left over in all
        count = 3.0 * max(self.blocks, 1)
        changes = self._changes(np.array(old), squares, count)
        of_one = slice(0, 3)
        pulls = changes.pulls[..., of_one]
        own_squares = changes.squares[..., of_one, of_one] + np.diag(LARGEST[of_one])
        velocity = solve(own_squares, pulls[..., None])[..., 0]
        gain = (pulls * velocity).sum(axis=2)  # (G, N)
        gain /= np.maximum(1.0, (squares - gain) / count)  # noise above that assumed
        shift, gain_together = self._shift_of_all(changes)
        gain_alone = gain.max(axis=1)
        g = int(np.maximum(gain_alone, gain_together).argmax())
        self.worst = float(max(gain_alone[g], gain_together[g]))
        excess = Excess("drift", self.worst, self._limit)
        i = int(gain[g].argmax())
        if gain_together[g] > gain_alone[g]:
            gains = self._gains_of_shift(changes, g, shift[g])
            i = int(gains.argmax())
            if gains.sum() - gains[i] > self._limit / 4:  # it explains the others' motion as well
                everybody = range(len(self._names))
                return Abort(TOGETHER, tuple(everybody), excess=excess)
        part = PARTS[int((pulls[g, i] * velocity[g, i]).argmax())]  # in which it moves most
        text = f"{self._names[i]} {ANOTHER.format(part)}"
        return Abort(text, (i,), suspect=i, excess=replace(excess, robot=i))

    def _changes(self, old: Floats, squares: Floats, count: float) -> Changes:
        """Compute the motion since some moments that the fitted constants do not explain.

        `old` contains the sums at these moments, shape (G, N, ...). `squares` (N,) is the sum of
        the remaining squared residuals, and `count` their number.
        """
        since = self._sums - old
        mixed = since[..., At.constants, At.motion]
        explained = product(product(mixed.swapaxes(2, 3), self._spread), mixed)
        unexplained = since[..., At.motion, At.motion] - explained
        pulls = since[..., At.motion, At.residual] - product(self._fit[:, None], mixed)[..., 0, :]
        noise = np.maximum(1.0, squares / count)[:, None]
        return Changes(unexplained, pulls, noise)

    def _shift_of_all(self, changes: Changes) -> tuple[Floats, Floats]:
        """Find, for each moment, the image motion that best explains the motion of all robots.

        The results are the motion (G, 4) and the reduction of the residuals (G,). The reduction is
        0 if there is only one robot.
        """
        picture = slice(3, 7)
        total = (changes.pulls[..., picture] / changes.noise).sum(axis=1)
        squares = (changes.squares[..., picture, picture] / changes.noise[..., None]).sum(axis=1)
        squares = squares + np.diag(LARGEST[picture])
        shift = solve(squares, total[..., None])[..., 0]
        if len(self._names) == 1:
            return shift, np.zeros(len(shift))
        return shift, (total * shift).sum(axis=1)

    def _gains_of_shift(self, changes: Changes, g: int, shift: Floats) -> Floats:
        """Compute how much a motion of the image since moment g reduces each robot's residuals.

        The motion has shape (4,), the result (N,).
        """
        picture = slice(3, 7)
        pulls = changes.pulls[g][:, picture]
        squares = changes.squares[g][:, picture, picture]
        rest = 2 * pulls - np.einsum("npq,q->np", squares, shift)
        return np.einsum("np,p->n", rest, shift) / changes.noise[:, 0]

    # ---- wheels ----

    def _wrong_wheels(self) -> Abort | None:
        """Return an abort if a robot's wheels or heading are surely too wrong, else None."""
        errors = product(self._fit, ERRORS.T)  # (N, 3)
        variances = np.einsum("ep,npq,eq->ne", ERRORS, self._spread, ERRORS)
        sure = np.abs(errors) - SURE_ERRORS * np.sqrt(variances)
        beyond = sure > self._share
        for i, name in enumerate(self._names):
            if not beyond[i].any():
                continue
            *_, heading_is_wrong = beyond[i]
            excess = Excess("wheels", float(sure[i].max()), self._share, robot=i)
            if heading_is_wrong:
                return Abort(f"{name} {ANOTHER.format(PARTS[1])}", excess=excess)
            left_error, right_error, _ = errors[i]
            return Abort(WRONG.format(name, left_error, right_error), excess=excess)
        return None


def ended_blocks(
    starts: Sequence[MeasuredPose | None], ends: Sequence[MeasuredPose | None]
) -> list[RobotStep]:
    """Return the motions of the robots that have poses at both ends of a block of time.

    Args:
        starts: Poses at the beginning of the block, shape (N,).
        ends: Poses at its end, shape (N,).
    """
    blocks: list[RobotStep] = []
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if start is not None and end is not None and end.exposed_ns > start.exposed_ns:
            way = end.travelled - start.travelled
            dt_ns = end.exposed_ns - start.exposed_ns
            blocks.append(RobotStep(way, EXACT, dt_ns, end.exposed_ns, i, start.pose))
    return blocks
