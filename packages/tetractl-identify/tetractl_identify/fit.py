"""Fits the dead time, turning rates, speeds, heading biases and noise of robots.

All robots share the dead time. The fit maximises the likelihood of the controller's filter
(`control.estimation.filter`).

A first pass of the filter goes over the longest track. It tries a grid of dead times and, for each,
the expected turning rates a times each of RATE_FACTORS. The fit starts with the most likely values.
Then it does at least ROUNDS_MIN rounds. Each round passes over all tracks twice:

- with varied noise. This gives the gradient and curvature of the likelihood as a function of the
  measurement noise and the random walks, for a Newton step;
- with dead times around the most likely one. A parabola through the likelihoods gives the dead time
  (its maximum) and its standard deviation (its width). The same pass gives each robot's a, speed
  and bias with their deviations.

The filter estimates a, speed and bias as constant states with wide priors. The likelihood is
therefore the restricted one, which accounts for their fit. Intervals are normal in ln a, ln of the
speed, bias, dead time, ln of the measurement noise, and the random walks. They are widened as the
differences between blocks of BLOCK_S require (`_RobotFit._widen_deviations`).

The model does not fit two kinds of robots. One kind has a speed that wanders from second to second.
The other has heading residuals that are not white, by the test of Ljung and Box ("On a measure of
lack of fit in time series models", Biometrika 65, 1978).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtrit

from tetractl.control.estimation.filter_start import HEADING_NOISE, POSITION_NOISE_S, SLIP, WALK
from tetractl.core.poses import Floats, Integers
from tetractl.tools.likelihood import Z_95, SampleInterval, newton_step
from tetractl_identify.passes import (
    SPEED_BLOCK_S,
    PassPrior,
    PassResult,
    TrackFrames,
    compute_speed_wander,
    count_driving_intervals,
    estimate_position_noise,
    run_filter,
)

ROUNDS_MIN = 6
"""Minimum number of rounds of a fit."""
ROUNDS_MAX = 20
"""Maximum number of rounds if the dead time has not settled.

That happens where directions turn smoothly: a sine of .8 rad/s gave an a of 4.16 instead of 4 after
six rounds.
"""
SETTLED_S = 3e-4
"""Change in a round below which a dead time has settled, if it is not below half its deviation [s].
"""
RATE_FACTORS = (1.0, 0.4, 2.5)
"""Factors on the expected a, from which the first pass starts."""
GRID_REACH_S = 0.3
"""Half the width of the range of dead times in the first pass [s]."""
GRID_SPACING_S = 0.02
"""Spacing of the dead times in the first pass [s]."""
SEARCH_FROM_S = -0.5
"""Minimum of the dead times that are searched if it is unknown [s]."""
SEARCH_UNTIL_S = 2.0
"""Maximum of the dead times that are searched if it is unknown [s]."""
SEARCH_SPACING_S = 0.05
"""Spacing of the dead times that are searched if it is unknown [s].

Below 0, times come from two clocks.
"""
DEFAULT_DEAD_TIME_S = 0.05  # dead time from which the fit begins if none is found [s]
FIRST_STD = np.array([0.5, 0.5, 0.2])
"""Prior standard deviations of ln a, ln of the speed and bias [rad] in the first pass."""
PRIOR_STD_MAX = np.array([2.0, 0.5, 1.0])
"""Maximum prior standard deviations of ln a, ln of the speed and bias [rad] in any pass."""
PRIOR_WIDENING = 10.0
"""Prior standard deviation of a pass, relative to the deviation after the previous pass."""
PARABOLA_POINTS = np.arange(-2.0, 3.0)
"""Dead times through which a parabola is fitted.

They are differences from the likeliest dead time so far, in its standard deviations.
"""
STD_RATIO_MIN = 0.2
"""Minimum ratio of the new standard deviation of the dead time to the previous deviation."""
STD_RATIO_MAX = 5.0
"""Maximum ratio of the new standard deviation of the dead time to the previous deviation."""
UNKNOWN_S = 0.3
"""Standard deviation from which a dead time counts as unknown [s]."""
LN_NOISE_RATIO_MAX = 50.0
"""Maximum logarithm of the ratio of a noise to the usual one."""
NOISE_PRIOR_STD = 5.0
"""Prior standard deviation of the noise's parameters."""
FIXED_STD = 1e-6
"""Prior standard deviation of a, speed and bias that are given."""
BLOCK_S = 20.0
"""Duration of the blocks whose differences give the intervals [s]."""
BLOCKS_MIN = 8
"""Minimum number of the blocks whose differences give the intervals.

If necessary, they are shorter. For 10 runs of real robots, deviations of gains from blocks of 2,
10, 20, 30 and 60 s are in the ratio 0.7, 0.9, 1, 1.05 and 1.1.
"""
DEAD_TIME_INDEX = 7
"""Index of the dead time among a robot's parameters.

The other seven precede it: noise, ln a, ln of the speed and bias.
"""
HALF_WIDTH_MAX = np.array([3.0, 1.0, 1.5])
"""Half widths of the intervals of ln a, ln speed and bias [rad] above which they are unlimited."""
RESIDUAL_LAGS = 5
"""Number of lags in the test whether residuals are white."""
WHITENESS_SIGNIFICANCE = 0.001
"""Significance level of the test whether residuals are white."""
RESIDUAL_CLIP = 4.0
"""Magnitude to which larger residuals are clipped [standard deviations]."""
DEAD_TIME_RESOLUTION_S = 1e-3
"""Time below 0 that no recording distinguishes from 0 [s].

If the interval of a dead time ends above -DEAD_TIME_RESOLUTION_S, its part below 0 is cut off.
"""
HEADING_MISFIT_MIN = 1e-3
"""Standard deviation of heading residuals below which no camera shows a misfit [rad]."""
RADIO_DELAY_ERROR_S = 7e-4
"""How far the radio's delay may be from the delay that a host assumes [s].

Hosts of lagging wheels send rates for the headings after that delay, so robots turn as if a were
larger by the fraction a RADIO_DELAY_ERROR_S. The bench's host assumes 7 ms instead of 7.7 ms. With
this value, intervals of a contained the truth in 344 of 360 cases in the bench's logs (n = 120,
three robots each; benchmarks/identify_coverage.py --bench).
"""
HEADING_MISFIT = "heading"
SPEED_MISFIT = "along the path"
SPEED_WANDER_MAX = 0.03
"""Relative standard deviation of a robot's speed over a second above which the model does not fit.

In trials of the bench it is at most 0.010, for robots that slip by 20 % in half of a trial at least
0.095 (n = 36 each).
"""


@dataclass(frozen=True, slots=True)
class FittedRobot:
    """The most probable values of a robot, with 95 % intervals. Lengths are in the tracks' unit.

    Attributes:
        name: The robot.
        a: Turning rate [rad/s].
        speed: Speed [length unit/s].
        heading_bias: Heading to which the robot turns, minus the direction sent [rad].
        position_noise: Standard deviation of measured positions along the path [length unit].
        heading_noise: Standard deviation of measured headings [rad].
        heading_walk: Standard deviation of the heading's random walk after one second
            [rad/sqrt(s)].
        lost: Number of commands that the robot probably lost.
        intervals: Number of intervals used.
        misfits: What the model does not explain: a speed that wanders, or residuals of the heading
            that are not white.
    """

    name: str
    a: SampleInterval
    speed: SampleInterval
    heading_bias: SampleInterval
    position_noise: SampleInterval
    heading_noise: SampleInterval
    heading_walk: SampleInterval
    lost: int
    intervals: int
    misfits: tuple[str, ...]


def fit(
    frames: list[TrackFrames],
    names: Sequence[str],
    a: Floats,
    speed: Floats,
    dead_time: float | None,
    all_commands: bool = True,
) -> tuple[SampleInterval, tuple[FittedRobot, ...]]:
    """Fit the parameters of N robots to the frames of some tracks.

    Args:
        frames: The frames of each track.
        names: The names of the robots, for the result.
        a: The expected turning rates (N,) [rad/s].
        speed: The expected speeds (N,) [length unit/s].
        dead_time: The expected dead time [s], None if it is unknown.
        all_commands: Whether the tracks contain every command that the robots followed. Otherwise
            no heading counts as a misfit. This is so if the host of lagging wheels sends new rates
            between two directions, which the tracks do not contain.

    Returns:
        The dead time that all robots share [s], and the values of each robot.
    """
    state = _RobotFit(frames, a, speed, dead_time)
    for round_index in range(ROUNDS_MAX):
        previous_tau_s = state.tau
        state.fit_noise()
        state.fit_motion()
        if round_index + 1 >= ROUNDS_MIN and abs(state.tau - previous_tau_s) < max(
            SETTLED_S, state.tau_std / 2
        ):
            break
    return state.result(names, all_commands)


def _search_dead_time(frames: TrackFrames, rows: np.ndarray, prior: PassPrior) -> float:
    """Find the most likely dead time on a grid [s].

    Robots `rows` (R,) are tried with each of RATE_FACTORS. If the result is at an end of the grid,
    nothing fits, and DEFAULT_DEAD_TIME_S is returned.
    """
    taus = np.arange(SEARCH_FROM_S, SEARCH_UNTIL_S, SEARCH_SPACING_S)
    result = run_filter([frames], rows, prior, taus, SEARCH_SPACING_S)
    best = _likeliest_dead_time(result)
    return DEFAULT_DEAD_TIME_S if best in (0, len(taus) - 1) else float(taus[best])


def _likeliest_dead_time(result: PassResult) -> int:
    """Return the index of the dead time that is most likely for all robots together.

    The pass must have tried each of RATE_FACTORS, and each robot takes its most likely factor.
    """
    likelihood_by_rate = result.likelihood.reshape(len(result.likelihood), -1, len(RATE_FACTORS))
    joint_likelihood = likelihood_by_rate.max(axis=2).sum(axis=1)
    return int(joint_likelihood.argmax())


class _RobotFit:
    """The parameters of a fit, which improve round by round.

    The parameters are the dead time `tau`, the means and standard deviations (N, 3) of ln a, ln of
    the speed and heading bias, and the noise. The noise of a robot has four parameters (N, 4), in
    units `_noise_unit` (N, 4). They are the logarithm of the position noise, the random walk of
    positions, the logarithm of the heading noise, and the random walk of headings. Random walks can
    be 0, and only their magnitudes matter.
    """

    def __init__(
        self, frames: list[TrackFrames], a: Floats, speed: Floats, dead_time: float | None
    ) -> None:
        self.frames = frames
        count = len(a)
        self._noise_unit = np.column_stack(
            [
                POSITION_NOISE_S * speed,
                SLIP * speed,
                np.full(count, HEADING_NOISE),
                np.full(count, WALK),
            ]
        )
        self.noise = np.tile((0.0, 1.0, 0.0, 1.0), (count, 1))
        # from much less than the true noise of positions, the walk of headings may end at 0
        self.noise[:, 0] = np.log(
            np.maximum(estimate_position_noise(frames) / self._noise_unit[:, 0], 1.0)
        )
        self.noise_std = np.ones_like(self.noise)
        no_bias = np.zeros(count)
        self.mean = np.column_stack([np.log(a), np.log(speed), no_bias])
        self.std = np.tile(FIRST_STD / PRIOR_WIDENING, (count, 1))
        self.tau, self.mean, self.std = self._find_start(dead_time)
        self.tau_std = GRID_SPACING_S / 2

    def _find_start(self, dead_time: float | None) -> tuple[float, Floats, Floats]:
        """Find the most likely dead time, and the means and deviations to start from.

        The dead time is searched around the expected one, or everywhere if it is unknown. Each
        robot starts with the most likely of RATE_FACTORS.
        """
        count = len(self.mean)
        rows = np.repeat(np.arange(count), len(RATE_FACTORS))
        prior = self._build_prior(rows, self.noise[rows])
        prior.mean[:, 0] += np.tile(np.log(RATE_FACTORS), count)
        longest_track = max(self.frames, key=lambda track: len(track.time_s))
        if dead_time is None:
            dead_time = _search_dead_time(longest_track, rows, prior)
        earliest_s = (
            dead_time - GRID_REACH_S if dead_time < 0 else max(0.0, dead_time - GRID_REACH_S)
        )
        taus = np.arange(earliest_s, dead_time + GRID_REACH_S, GRID_SPACING_S)
        result = run_filter([longest_track], rows, prior, taus, GRID_SPACING_S)
        likeliest = _likeliest_dead_time(result)
        likeliest_factors = (
            result.likelihood[likeliest].reshape(count, len(RATE_FACTORS)).argmax(axis=1)
        )
        likeliest_rows = np.arange(count) * len(RATE_FACTORS) + likeliest_factors
        return (
            float(taus[likeliest]),
            result.mean[likeliest, likeliest_rows],
            result.std[likeliest, likeliest_rows],
        )

    def fit_noise(self) -> None:
        """Do one Newton step for the parameters of the noise, and set their standard deviations."""

        def likelihood(noise: Floats) -> Floats:
            """Return ln of the likelihoods (N, V) of variants of the noise (N, V, 4)."""
            rows = np.repeat(np.arange(len(noise)), noise.shape[1])
            prior = self._build_prior(rows, noise.reshape(-1, 4))
            result = run_filter(self.frames, rows, prior, np.array([self.tau]))
            return result.likelihood.reshape(noise.shape[:2])

        self.noise, self.noise_std = newton_step(likelihood, self.noise, NOISE_PRIOR_STD)

    def fit_motion(self, watched: bool = False) -> PassResult:
        """Fit the dead time, a, speed and bias with the present noise.

        The dead time and its standard deviation come from a parabola through the likelihoods. The
        means change with the dead time along a fitted line, so their deviations also account for
        the uncertainty of the dead time.

        Returns:
            The pass with dead times around the previous one.
        """
        rows = np.arange(len(self.mean))
        prior = self._build_prior(rows, self.noise)
        taus = self.tau + PARABOLA_POINTS * self.tau_std
        result = run_filter(self.frames, rows, prior, taus, watched=watched)
        likelihood = result.likelihood.sum(axis=1)
        curvature, slope, _ = np.polyfit(PARABOLA_POINTS, likelihood, 2)
        shift_stds = (
            -slope / (2 * curvature) if curvature < 0 else PARABOLA_POINTS[likelihood.argmax()]
        )
        shift_stds = float(np.clip(shift_stds, 2 * PARABOLA_POINTS[0], 2 * PARABOLA_POINTS[-1]))
        width_stds = np.sqrt(0.5 / max(-curvature, 1e-9))
        std_ratio = float(np.clip(width_stds, STD_RATIO_MIN, STD_RATIO_MAX))
        tau_std = min(self.tau_std * std_ratio, UNKNOWN_S)
        mean_slope, mean_at_center = np.polyfit(
            PARABOLA_POINTS, result.mean.reshape(len(PARABOLA_POINTS), -1), 1
        )
        std_from_dead_time = mean_slope.reshape(self.mean.shape) * tau_std / self.tau_std
        self.mean = (mean_at_center + shift_stds * mean_slope).reshape(self.mean.shape)
        self.std = np.hypot(result.std[len(PARABOLA_POINTS) // 2], std_from_dead_time)
        self.tau += shift_stds * self.tau_std
        self.tau_std = tau_std
        return result

    def _build_prior(self, rows: np.ndarray, noise: Floats) -> PassPrior:
        """Create the prior of a pass for robots `rows` (R,) with parameters of the noise (R, 4).

        It is PRIOR_WIDENING times as wide as the present estimate, up to PRIOR_STD_MAX.
        """
        std = np.minimum(PRIOR_WIDENING * self.std, PRIOR_STD_MAX)[rows]
        deviations = self._to_deviations(rows, noise)
        return PassPrior(
            mean=self.mean[rows], std=std, noise=deviations[:, ::2], walk=deviations[:, 1::2]
        )

    def _to_deviations(self, rows: np.ndarray, noise: Floats) -> Floats:
        """Convert noise parameters (R, 4) of robots `rows` (R,) to standard deviations (R, 4).

        Even columns hold logarithms, and odd columns hold factors whose sign does not
        count.
        """
        factors = np.abs(noise)
        factors[:, ::2] = np.exp(np.minimum(noise[:, ::2], LN_NOISE_RATIO_MAX))
        return self._noise_unit[rows] * factors

    def _widen_deviations(self) -> None:
        """Widen the deviations as the differences between blocks require.

        For each parameter, the factor is the square root of a ratio: the variance of the slopes of
        the blocks, divided by the curvature of the likelihood.
        """
        base, raised, lowered = self._compute_block_likelihoods()
        slopes = (raised - lowered) / 2
        curvatures = 2 * base - raised - lowered
        slopes[..., DEAD_TIME_INDEX:] = slopes[..., DEAD_TIME_INDEX:].sum(axis=1, keepdims=True)
        curvatures[..., DEAD_TIME_INDEX:] = curvatures[..., DEAD_TIME_INDEX:].sum(
            axis=1, keepdims=True
        )
        slope_variance = len(slopes) * np.var(slopes, axis=0, ddof=1)
        curvature_sum = np.maximum(curvatures.sum(axis=0), 1.0)  # 1 without correlated parameters
        widening = np.maximum(
            compute_block_widening(curvatures) * np.sqrt(slope_variance / curvature_sum), 1.0
        )
        self.noise_std = self.noise_std * widening[:, :4]
        self.std = self.std * widening[:, 4:DEAD_TIME_INDEX]
        self.tau_std *= float(widening[0, DEAD_TIME_INDEX])

    def _compute_block_likelihoods(self) -> tuple[Floats, Floats, Floats]:
        """Compute the ln likelihood of each block of each robot (B, N, 8), for varied parameters.

        The three results use the present parameters, each parameter raised by its deviation, and
        each parameter lowered by it. The parameters are the noise, the means and the dead time.
        """
        n_robots = len(self.mean)
        durations_s = [
            np.diff(track.time_s[:, 0], prepend=track.time_s[0, 0]) for track in self.frames
        ]
        track_ends = np.cumsum([len(duration_s) for duration_s in durations_s])[:-1]
        blocks = np.split(assign_blocks(np.concatenate(durations_s)), track_ends)
        changes = np.vstack([np.eye(DEAD_TIME_INDEX), -np.eye(DEAD_TIME_INDEX)])
        rows = np.repeat(np.arange(n_robots), len(changes))
        changes = np.tile(changes, (n_robots, 1))
        noise = self.noise[rows] + self.noise_std[rows] * changes[:, :4]
        prior = self._build_prior(rows, noise)
        prior.mean[...] += self.std[rows] * changes[:, 4:]
        prior.std[...] = FIXED_STD
        varied = run_filter(self.frames, rows, prior, np.array([self.tau]), blocks=blocks)
        by_parameter = varied.block_ln_likelihoods.reshape(-1, n_robots, 2 * DEAD_TIME_INDEX)

        prior = self._build_prior(np.arange(n_robots), self.noise)
        prior.std[...] = FIXED_STD
        taus = self.tau + self.tau_std * np.array([0.0, 1.0, -1.0])
        base, raised_dead_time, lowered_dead_time = run_filter(
            self.frames, np.arange(n_robots), prior, taus, blocks=blocks
        ).block_ln_likelihoods.transpose(1, 0, 2)[..., None]
        raised = np.concatenate([by_parameter[..., :DEAD_TIME_INDEX], raised_dead_time], axis=2)
        lowered = np.concatenate([by_parameter[..., DEAD_TIME_INDEX:], lowered_dead_time], axis=2)
        return base, raised, lowered

    def result(
        self, names: Sequence[str], all_commands: bool
    ) -> tuple[SampleInterval, tuple[FittedRobot, ...]]:
        """Return the dead time and the values of robots with these names, with 95 % intervals.

        Correlated heading residuals count as a misfit only if `all_commands` is set.
        """
        watched = self.fit_motion(watched=True)
        self._widen_deviations()
        correlated = _is_correlated(watched.heading_residuals)
        motion = self._motion_intervals()
        noise = self._noise_intervals()
        speeds = np.exp(self.mean[:, 1])
        wander_from_noise = 2 * np.sqrt(2) * noise[:, 0, 0] / (speeds * SPEED_BLOCK_S)
        does_wander = compute_speed_wander(self.frames) > np.maximum(
            SPEED_WANDER_MAX, wander_from_noise
        )
        intervals = count_driving_intervals(self.frames)
        robots: list[FittedRobot] = []
        for i, name in enumerate(names):
            a, speed, heading_bias = _to_intervals(motion[i])
            position_noise, _, heading_noise, heading_walk = _to_intervals(noise[i])
            misfits = [SPEED_MISFIT] if does_wander[i] else []
            if correlated[i] and all_commands:
                misfits.append(HEADING_MISFIT)
            robots.append(
                FittedRobot(
                    name=name,
                    a=a,
                    speed=speed,
                    heading_bias=heading_bias,
                    position_noise=position_noise,
                    heading_noise=heading_noise,
                    heading_walk=heading_walk,
                    lost=round(float(watched.lost[i])),
                    intervals=int(intervals[i]),
                    misfits=tuple(misfits),
                )
            )
        return self._dead_time_interval(), tuple(robots)

    def _dead_time_interval(self) -> SampleInterval:
        """Compute the dead time and its interval [s].

        The interval has no upper end if the dead time counts as unknown. It is cut off at 0 if its
        upper end is above -DEAD_TIME_RESOLUTION_S.
        """
        half_width = Z_95 * self.tau_std if self.tau_std < UNKNOWN_S else np.inf
        minimum = 0.0 if self.tau + half_width >= -DEAD_TIME_RESOLUTION_S else -np.inf
        value_and_ends = self.tau, self.tau - half_width, self.tau + half_width
        return SampleInterval(*np.maximum(value_and_ends, minimum).tolist())

    def _motion_intervals(self) -> Floats:
        """Return a, speed and bias of each robot (N, 3, 3): value, lower and upper end of each.

        The ends are infinite, or 0 and infinite for a and speed, if the data do not bound
        the value.
        """
        deviations = self.std.copy()
        if any(track.lag_s > 0 for track in self.frames):
            deviations[:, 0] = np.hypot(
                deviations[:, 0], np.exp(self.mean[:, 0]) * RADIO_DELAY_ERROR_S
            )
        half_widths = Z_95 * deviations
        half_widths = np.where(half_widths > HALF_WIDTH_MAX, np.inf, half_widths)
        motion = np.stack([self.mean, self.mean - half_widths, self.mean + half_widths], axis=-1)
        motion[:, :2] = np.exp(motion[:, :2])
        return motion

    def _noise_intervals(self) -> Floats:
        """Return the noise of each robot (N, 4, 3), as a standard deviation and its two ends."""
        rows = np.arange(len(self.noise))
        value = np.abs(self.noise)
        value[:, ::2] = self.noise[:, ::2]
        lower = value - Z_95 * self.noise_std
        lower[:, 1::2] = np.maximum(lower[:, 1::2], 0.0)
        upper = value + Z_95 * self.noise_std
        value_and_ends = [
            self._to_deviations(rows, parameters) for parameters in (value, lower, upper)
        ]
        return np.stack(value_and_ends, axis=-1)


def _to_intervals(values: Floats) -> list[SampleInterval]:
    """Convert values (K, 3) to intervals. Each row is the value, its lower and its upper end."""
    return [SampleInterval(value, lower, upper) for value, lower, upper in values.tolist()]


def _is_correlated(residuals: Floats) -> list[bool]:
    """Check for each robot whether its heading residuals (F, N) [rad] are correlated in time.

    Residuals with a standard deviation below HEADING_MISFIT_MIN do not count.
    """
    n_robots = residuals.shape[1]
    is_correlated: list[bool] = []
    for robot_residuals in residuals.T:
        is_residual = np.isfinite(robot_residuals)
        std = np.std(robot_residuals[is_residual])
        clipped = np.nan_to_num(np.clip(robot_residuals, -RESIDUAL_CLIP * std, RESIDUAL_CLIP * std))
        products = [clipped[lag:] @ clipped[:-lag] for lag in range(1, RESIDUAL_LAGS + 1)]
        autocorrelations = np.array(products) / (clipped @ clipped + 1e-300)
        ljung_box = is_residual.sum() * np.square(autocorrelations).sum()
        is_correlated.append(
            bool(
                std >= HEADING_MISFIT_MIN
                and chdtrc(RESIDUAL_LAGS, ljung_box) < WHITENESS_SIGNIFICANCE / n_robots
            )
        )
    return is_correlated


# ---- Blocks ----


def assign_blocks(duration_s: Floats) -> Integers:
    """Divide a recording into blocks of equal duration, and return the block of each step.

    The blocks last about BLOCK_S, but there are at least BLOCKS_MIN blocks.

    Args:
        duration_s: Duration of each step [s], shape (S,). The steps follow each other in time.

    Returns:
        The index of the block in which each step ends, from 0, shape (S,).
    """
    elapsed_s = np.cumsum(duration_s)
    n_blocks = max(BLOCKS_MIN, round(elapsed_s[-1] / BLOCK_S))
    return np.minimum(elapsed_s / elapsed_s[-1] * n_blocks, n_blocks - 1).astype(np.int64)


def compute_block_widening(curvatures: Floats) -> Floats:
    """Compute how much wider an interval from the spread of blocks is than a normal one.

    The input is the negative curvature h (B, ...) of the ln likelihood of each block. If a robot
    turns in only few blocks, only these blocks contain information about its turns. The effective
    number of blocks of a value is therefore (sum h)^2 / sum h^2, and the interval uses the t
    distribution for this number.
    """
    information = np.maximum(curvatures, 0.0)
    effective_blocks = information.sum(axis=0) ** 2 / (np.square(information).sum(axis=0) + 1e-300)
    return np.asarray(stdtrit(np.maximum(effective_blocks - 1, 1.0), 0.975) / Z_95)
