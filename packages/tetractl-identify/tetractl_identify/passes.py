"""Runs the controller's filter over whole tracks, for likelihoods, estimates and residuals.

This is the only module of the identification from logs that uses the compiled filter. One run over
the tracks is called a pass. A pass has R rows and a bank of B dead times. Each row is a robot with
assumed noise and random walks. The filter is the one that the controller runs
(`control.estimation.filter`), with its hypotheses that a command was lost or that a robot is stuck.
Turning rate a, speed and heading bias are constant states, and the noise is as assumed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tetractl.control.estimation.kernels.filter_state import (
    LAG,
    LN_A,
    LN_SPEED,
    LOG_FOLLOWS,
    STATES,
    STATES_OF_WHEELS,
    TURN_BIAS,
    Bank,
    FilterModel,
    PoseFrames,
    SentCommands,
)
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Integers, wrap
from tetractl.model.motion.motion import PARAMETERS
from tetractl_identify.tracks import Track, select_rows_apart

FRAME_GAP_MIN_S = 0.035
"""Minimum time between two frames [s]. A frame that follows sooner is left out."""
DRIVING_FRACTION = 0.5
"""A robot drives if it travels at least this fraction of its usual distance."""
DIRECTIONS_MAX = 10_000
"""Maximum number of directions between two frames."""
RESTART_GAP_S = 0.3
"""Time without a pose after which a row restarts from the camera's next pose [s]."""
REST_BEFORE_DRIVING_S = 0.3
"""Time before it drives at which a robot with lagging wheels certainly stands still [s]."""
SPEED_BLOCK_S = 1.0
"""Duration of the blocks whose speeds are compared [s]."""
QUANTILES = (0.3, 0.7)
"""Quantiles between which the speeds of blocks are compared.

A speed that changes in the middle of a trial is beyond both. A speed that a radio stops in less
than a third of its seconds is beyond none.
"""
QUANTILE_STDS = 1.049
"""Distance between the QUANTILES of a normal distribution [standard deviations]."""
STANDING_FRACTION = 0.5
"""Fraction of its usual speed below which a robot nearly stands still."""
SPEED_WINDOW_S = 0.2
"""Time over which the speed of a robot is judged to decide whether it nearly stands still [s].

The noise of the camera makes no such speed over this time.
"""
BLOCK_FRACTION_MIN = 0.6
"""Minimum fraction of a block for which a robot must be measured."""
MEDIAN_DISTANCE = 0.826
"""Median distance of a place from the middle of its neighbours, relative to the noise of each.

It is .6745 sqrt(1.5).
"""
IDENTIFIED = [LN_A, LN_SPEED, TURN_BIAS]
"""The filter's states of a `PassPrior`."""
NO_COMMANDS = SentCommands(np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class TrackFrames:
    """M frames of a track, and the C directions that act in them.

    Attributes:
        time_s: Times of the poses, shape (M, N) [s].
        poses: x, y [length unit] and heading [rad], shape (M, N, 3).
        is_used: Whether a pose updates the filter, shape (M, N).
        is_restart: Whether the filter starts again from a pose, shape (M, N).
        sent_s: When each direction was sent, shape (C,) [s].
        direction_rad: The directions, shape (C,) [rad].
        watchdog_s: Robots that receive nothing for this time stop [s].
        lag_s: Time constant with which the wheels follow [s].
        hold_moments: For how long the wheels keep a rate, in the form of
            `model.motion.turn_rate.compute_held_turning_rate` [s, s2, s3].
    """

    time_s: Floats
    poses: Floats
    is_used: Bools
    is_restart: Bools
    sent_s: Floats
    direction_rad: Floats
    watchdog_s: float
    lag_s: float
    hold_moments: tuple[float, float, float]

    @classmethod
    def from_track(cls, track: Track) -> "TrackFrames":
        """Select the frames at least FRAME_GAP_MIN_S apart, from the first direction to the stop.

        A robot's poses are used from the time at which it drives. With lagging wheels, they are
        used from its last standstill, because its turning rate cannot be seen while it starts.
        After a gap of RESTART_GAP_S, the poses restart the filter.

        Raises:
            UsageError: If no direction was sent, or if there are very many between two frames.
        """
        if not len(track.sent_s):
            raise UsageError(f"{track.source}: the log has no direction that was sent")
        rows = np.flatnonzero(track.time_s <= track.stop_s)
        before_s = float(track.sent_s[0]) - FRAME_GAP_MIN_S
        rows = rows[select_rows_apart(track.time_s[rows], FRAME_GAP_MIN_S, before_s)]
        time_s = track.time_s[rows]
        poses = np.nan_to_num(track.poses[rows])
        valid = track.valid[rows]
        is_driving = _find_driving_frames(time_s, poses, valid, track.lag_s > 0)
        is_used = valid & np.logical_or.accumulate(is_driving, axis=0)
        # when each robot's pose was last used before each frame (M, N), -inf if never
        last_used_including_s = np.maximum.accumulate(
            np.where(is_used, time_s[:, None], -np.inf), axis=0
        )
        last_used_s = np.vstack([np.full((1, is_used.shape[1]), -np.inf), last_used_including_s])[
            : len(time_s)
        ]
        is_restart = is_used & (time_s[:, None] - last_used_s > RESTART_GAP_S)
        directions_max = np.diff(np.searchsorted(track.sent_s, time_s)).max(initial=0)
        if directions_max > DIRECTIONS_MAX:
            raise UsageError(
                f"{directions_max} directions were sent between two successive frames, too "
                "many for an identification",
                "log more frames",
            )
        return cls(
            time_s=track.exposed_s[rows],
            poses=poses,
            is_used=is_used & ~is_restart,
            is_restart=is_restart,
            sent_s=track.sent_s,
            direction_rad=track.direction_rad,
            watchdog_s=track.watchdog_s,
            lag_s=track.lag_s,
            hold_moments=_hold_moments(track),
        )


def _find_driving_frames(time: Floats, poses: Floats, valid: Bools, has_lag: bool) -> Bools:
    """Find the frames in which each robot drives, shape (M, N).

    For a robot with lagging wheels, driving starts REST_BEFORE_DRIVING_S
    earlier.
    """
    displacement = np.diff(poses[..., :2], axis=0)
    speed = np.hypot(displacement[..., 0], displacement[..., 1]) / np.diff(time)[:, None]
    speed[~(valid[:-1] & valid[1:])] = np.nan
    is_driving = np.zeros_like(valid)
    is_driving[1:] = speed >= DRIVING_FRACTION * _median_of_columns(speed)
    if has_lag:
        driving_from_s = np.where(is_driving.any(axis=0), time[is_driving.argmax(axis=0)], np.inf)
        is_driving |= time[:, None] >= driving_from_s - REST_BEFORE_DRIVING_S
    return is_driving


def _hold_moments(track: Track) -> tuple[float, float, float]:
    """Compute for how long lagging wheels keep a rate: mean first three powers [s, s2, s3].

    The means are taken over time. The host sends the wheels a new rate with each command.
    """
    is_before_end = track.sent_s <= track.stop_s
    gaps_s = np.diff(track.sent_s[is_before_end])
    if track.lag_s == 0 or not gaps_s.any():
        return 0.0, 0.0, 0.0
    return (
        float(np.average(gaps_s, weights=gaps_s)),
        float(np.average(gaps_s**2, weights=gaps_s)),
        float(np.average(gaps_s**3, weights=gaps_s)),
    )


def count_driving_intervals(tracks: Sequence[TrackFrames]) -> Integers:
    """Count the intervals between frames in which each robot drives, shape (N,)."""
    return np.sum([track.is_used.sum(axis=0) for track in tracks], axis=0)


def compute_median_speeds(tracks: Sequence[TrackFrames]) -> Floats:
    """Compute the median speed of each robot between frames (N,) [length unit/s].

    Only intervals in which a robot drives count. The speed is infinite if a robot has none.
    """
    speed_by_track = []
    for track in tracks:
        displacement = np.diff(track.poses[..., :2], axis=0)
        gaps_s = np.diff(track.time_s, axis=0)
        is_measured = track.is_used[1:] & (track.is_used | track.is_restart)[:-1] & (gaps_s > 0)
        speed = np.hypot(displacement[..., 0], displacement[..., 1]) / np.where(
            gaps_s > 0, gaps_s, 1.0
        )
        speed_by_track.append(np.where(is_measured, speed, np.nan))
    return _median_of_columns(np.concatenate(speed_by_track))


def estimate_position_noise(tracks: Sequence[TrackFrames]) -> Floats:
    """Estimate the noise of each robot's measured positions (N,) [length unit].

    The estimate is the median distance of a position from the line between its two neighbours in
    time.
    """
    noise_by_robot: list[float] = []
    for robot in range(tracks[0].is_used.shape[1]):
        distances: list[Floats] = [np.zeros(1)]
        for track in tracks:
            is_used = track.is_used[:, robot]
            times = track.time_s[is_used, robot]
            for coordinates in track.poses[is_used, robot, :2].T:
                fraction = (times[1:-1] - times[:-2]) / np.maximum(
                    times[2:] - times[:-2], FRAME_GAP_MIN_S
                )
                interpolated = coordinates[:-2] + fraction * (coordinates[2:] - coordinates[:-2])
                distances.append(np.abs(coordinates[1:-1] - interpolated))
        median_distance = float(np.median(np.concatenate(distances)))
        noise_by_robot.append(median_distance / MEDIAN_DISTANCE)
    return np.array(noise_by_robot)


def compute_speed_wander(tracks: Sequence[TrackFrames]) -> Floats:
    """Compute the relative standard deviation of each robot's speed (N,) between blocks of time.

    A block lasts SPEED_BLOCK_S. The result is 0 if the speed is measured in only one block. It is
    the deviation of a normal distribution with the same QUANTILES as the blocks.
    """
    wander_by_robot: list[float] = []
    for robot in range(tracks[0].is_used.shape[1]):
        block_speeds: list[float] = []
        for track in tracks:
            block_speeds += _compute_block_speeds(track, robot)
        wander = 0.0
        if len(block_speeds) > 1:
            lower, median, upper = np.quantile(block_speeds, (QUANTILES[0], 0.5, QUANTILES[1]))
            wander = (upper - lower) / (QUANTILE_STDS * abs(median))
        wander_by_robot.append(wander)
    return np.array(wander_by_robot)


def _compute_block_speeds(track: TrackFrames, robot: int) -> list[float]:
    """Compute the speed of a robot along its heading in each block with enough measurements.

    Intervals in which the robot nearly stands still are left out, because lost commands may stop a
    robot.
    """
    is_measured = track.is_used[1:, robot] & track.is_used[:-1, robot]
    if not is_measured.any():
        return []
    x, y, heading = track.poses[:, robot].T
    turn_rad = np.asarray(wrap(np.diff(heading)))
    distance = (np.diff(x + 1j * y) * np.exp(-1j * (heading[:-1] + turn_rad / 2))).real
    gaps_s = np.diff(track.time_s[:, robot])
    step_s = float(np.median(gaps_s[is_measured]))
    window = np.ones(max(1, round(SPEED_WINDOW_S / step_s)))
    window_distance = np.convolve(np.where(is_measured, distance, 0.0), window, "same")
    window_s = np.convolve(np.where(is_measured, gaps_s, 0.0), window, "same")
    windowed_speed = window_distance / np.where(window_s > 0, window_s, np.inf)
    is_driving = is_measured & (
        windowed_speed > STANDING_FRACTION * np.median(windowed_speed[is_measured])
    )
    block = ((track.time_s[1:, robot] - track.time_s[0, robot]) / SPEED_BLOCK_S).astype(np.int64)
    distances = np.bincount(block[is_driving], distance[is_driving])
    durations_s = np.bincount(block[is_driving], gaps_s[is_driving])
    is_full = durations_s > BLOCK_FRACTION_MIN * SPEED_BLOCK_S
    return (distances[is_full] / durations_s[is_full]).tolist()


def _median_of_columns(values: Floats) -> Floats:
    """Compute the median of each column without NaN.

    It is infinite for a column without numbers.
    """
    medians = []
    for column in values.T:
        numbers = column[np.isfinite(column)]
        medians.append(np.median(numbers) if numbers.size else np.inf)
    return np.array(medians)


@dataclass(frozen=True, slots=True)
class PassPrior:
    """The prior assumptions about R rows of the filter.

    Attributes:
        mean: Means of ln a, ln of the speed and heading bias, shape (R, 3).
        std: Their standard deviations, shape (R, 3).
        noise: Standard deviations of a measured position [length unit] and heading [rad], shape (R,
            2).
        walk: Their random walks [1/sqrt(s)], shape (R, 2).
    """

    mean: Floats
    std: Floats
    noise: Floats
    walk: Floats


@dataclass(frozen=True, slots=True)
class PassResult:
    """The results of a pass of the filter.

    Attributes:
        block_ln_likelihoods: ln of the likelihood of each block of time, up to a constant, shape
            (K, B, R).
        mean: Means as in `PassPrior`, shape (B, R, 3).
        std: Their standard deviations, shape (B, R, 3).
        heading_residuals: Residuals of headings for the dead time in the middle of the bank [rad],
            shape (F, R), if watched. NaN where a pose is not used.
        lost: Expected number of directions that did not reach each robot, shape (R,), if watched.
    """

    block_ln_likelihoods: Floats
    mean: Floats
    std: Floats
    heading_residuals: Floats
    lost: Floats

    @property
    def likelihood(self) -> Floats:
        """ln of the likelihood of all frames, up to a constant, shape (B, R).

        It is the sum of `block_ln_likelihoods` over the blocks of time.
        """
        return self.block_ln_likelihoods.sum(axis=0)


def run_filter(
    tracks: Sequence[TrackFrames],
    rows: NDArray[np.int64],
    prior: PassPrior,
    dead_times_s: Floats,
    spacing_s: float = 0.0,
    watched: bool = False,
    blocks: Sequence[Integers] = (),
) -> PassResult:
    """Run the filter over tracks, once for each dead time.

    Args:
        tracks: The frames of each track.
        rows: The indices of the robots (R,).
        prior: The assumptions about each row: turning rate, speed and heading bias, noise, and
            random walks.
        dead_times_s: The dead times (B,) [s].
        spacing_s: Uncertainty of each dead time [s].
        watched: Whether to collect the residuals of headings and the expected numbers of lost
            directions.
        blocks: For each track, the index of the block of each frame (F,). By default, all frames
            are in block 0.
    """
    first_model, bank = _start_filter(prior, dead_times_s)
    blocks = blocks or [np.zeros(len(track.time_s), dtype=np.int64) for track in tracks]
    block_count = 1 + max(block[-1] for block in blocks)
    block_ln_likelihoods = np.zeros((block_count, len(dead_times_s), len(rows)))
    lost_directions = np.zeros(len(rows))
    residuals: list[Floats] = []
    for track, block in zip(tracks, blocks, strict=True):
        _begin_track(bank, track)
        model = first_model._replace(
            watchdog_s=track.watchdog_s, host_lag_s=track.lag_s, hold=track.hold_moments
        )
        residual_collector = _ResidualCollector(track.direction_rad, len(rows)) if watched else None
        _run_track(
            bank, model, track, rows, spacing_s, residual_collector, block_ln_likelihoods, block
        )
        if residual_collector is not None:
            residuals += residual_collector.residuals
            lost_directions += residual_collector.lost
        # each branch of a row goes on from the likeliest one
        likeliest = bank.ln_weight.argmax(axis=2)[..., None, None]
        bank.state[...] = np.take_along_axis(bank.state, likeliest, axis=2)
        bank.cov[...] = np.take_along_axis(bank.cov, likeliest[..., None], axis=2)
    variance = np.diagonal(bank.cov[:, :, 0], axis1=2, axis2=3)[..., IDENTIFIED]
    return PassResult(
        block_ln_likelihoods=block_ln_likelihoods,
        mean=bank.state[:, :, 0, IDENTIFIED],
        std=np.sqrt(np.maximum(variance, 0.0)),
        heading_residuals=np.array(residuals),
        lost=lost_directions,
    )


def _begin_track(bank: Bank, track: TrackFrames) -> None:
    """Give each row a single hypothesis at the beginning of a track.

    Without a lag, the first direction of the track acts already. With a lag, the wheels stand
    still until it acts.
    """
    bank.ln_weight[...] = -np.inf
    bank.ln_weight[..., 0] = 0.0
    bank.state[..., LAG] = track.lag_s
    if track.lag_s > 0:  # the wheels stand until the first direction acts
        bank.direction[...] = np.nan
        bank.next_command[:] = 0
    else:  # the first direction also acts before its time
        bank.direction[...] = track.direction_rad[0]
        bank.next_command[:] = 1
    bank.until_s[...] = bank.dead_time_s[..., None] + track.sent_s[0] + track.watchdog_s


def _run_track(
    bank: Bank,
    model: FilterModel,
    track: TrackFrames,
    rows: NDArray[np.int64],
    spacing_s: float,
    residual_collector: "_ResidualCollector | None",
    block_ln_likelihoods: Floats,
    block: Integers,
) -> None:
    """Run the filter over the frames of a track, and add their ln likelihoods to the blocks.

    Args:
        bank: The filters.
        model: The assumptions about the robots.
        track: The frames (F,).
        rows: The indices of the robots (R,).
        spacing_s: Uncertainty of each dead time [s].
        residual_collector: Collects residuals. None to collect nothing.
        block_ln_likelihoods: The ln likelihood of each block (K, B, R), to which this function
            adds.
        block: The index of each frame's block (F,).
    """
    from tetractl.control.estimation.kernels import filter as kernel

    commands = SentCommands(track.sent_s, track.direction_rad)
    all_times_s = track.time_s[:, rows]
    poses = np.ascontiguousarray(track.poses[:, rows])
    is_used = np.ascontiguousarray(track.is_used[:, rows])
    is_restart = np.ascontiguousarray(track.is_restart[:, rows])
    # the filter is called with two frames: one without poses, by which no interval is too long
    # for its commands, and the camera's
    frame_poses = np.full((2, *poses.shape[1:]), np.nan)
    frame_valid = np.zeros((2, len(rows)), np.bool_)
    previous_s = np.full(len(rows), -np.inf)
    for frame, times_s in enumerate(all_times_s):
        frame_times_s = np.stack([np.maximum(previous_s, times_s - 2 * RESTART_GAP_S), times_s])
        frame_poses[1] = poses[frame]
        frame_valid[1] = is_used[frame]
        frames = PoseFrames(frame_times_s, frame_poses, frame_valid)
        likelihoods = kernel.follow(bank, model, commands, frames, False, spacing_s)
        block_ln_likelihoods[block[frame]] += likelihoods
        bank.noise_scale[...] = 1.0
        if is_restart[frame].any():
            kernel.place(bank, model, NO_COMMANDS, times_s, poses[frame], is_restart[frame])
        if residual_collector is not None:
            residual_collector.add(bank, poses[frame], is_used[frame])
        previous_s = times_s


class _ResidualCollector:
    """Collector of heading residuals along a track, for the middle dead time of a bank.

    Attributes:
        residuals: The residuals of headings in each frame, shape (R,) each [rad].
        lost: Expected number of directions that did not reach each robot, shape (R,).
    """

    def __init__(self, u: Floats, rows: int) -> None:
        self.residuals: list[Floats] = []
        self._u = u
        self._rows = np.arange(rows)
        # probability that a robot does not follow the newest direction, with a row for each
        # direction; the last row is for the time before the first direction
        self._missed = np.zeros((len(u) + 1, rows))

    def add(self, bank: Bank, poses: Floats, used: Bools) -> None:
        """Add the residuals of a frame.

        Args:
            bank: The filters.
            poses: The poses, shape (R, 3).
            used: Whether each pose is used, shape (R,).
        """
        middle_dead_time = len(bank.dead_time_s) // 2
        ln_weight = bank.ln_weight[middle_dead_time]
        state = bank.state[middle_dead_time, self._rows, ln_weight.argmax(axis=1)]
        self.residuals.append(np.where(used, wrap(poses[:, 2] - state[:, 2]), np.nan))
        newest = bank.next_command[middle_dead_time] - 1
        follows_another = bank.direction[middle_dead_time] != self._u[newest][:, None]
        weights = np.exp(ln_weight) * follows_another
        self._missed[newest, self._rows] = weights[:, :-1].sum(axis=1)

    @property
    def lost(self) -> Floats:
        """The expected number of lost directions (R,)."""
        return self._missed[:-1].sum(axis=0)


def _start_filter(prior: PassPrior, dead_times_s: Floats) -> tuple[FilterModel, Bank]:
    """Create the filter's model, and its bank at the start."""
    count = len(prior.mean)
    # positions along and across have the same noise and walk
    noise = np.repeat(prior.noise, (2, 1), axis=1).T
    walk = np.zeros((STATES_OF_WHEELS, count))
    walk[:3] = np.repeat(prior.walk, (2, 1), axis=1).T
    mean = np.zeros((len(dead_times_s), count, STATES))
    mean[..., IDENTIFIED] = prior.mean
    std = np.zeros((count, STATES_OF_WHEELS))
    std[:, IDENTIFIED] = prior.std
    groups = np.zeros(len(dead_times_s), dtype=np.int64)
    bank = Bank.start(dead_times_s, mean, std, groups, LOG_FOLLOWS)
    ones = np.ones((count, len(PARAMETERS)))
    noise = np.ascontiguousarray(noise)
    return FilterModel(ones, noise, walk, 0.0, 0.0, np.inf, branch_all=True), bank
