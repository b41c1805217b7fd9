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
from tetractl_identify.tracks import Track, rows_apart

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
"""Distance between the quantiles INNER of a normal distribution [standard deviations]."""
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
    """M frames of a track, and the C directions u [rad] that act in them.

    The directions were sent at the times `sent_s` (C,) [s]. `time` (M, N) are the times of the
    poses [s]. `used` (M, N) says which of the poses (M, N, 3) update the filter. At the poses with
    `restarts` (M, N), the filter starts again from the measured pose. Robots that receive nothing
    for `watchdog` [s] stop. Their wheels follow with the time constant `lag` [s], and keep a rate
    for `hold_moments`, which has the form of `model.motion.turn_rate.turning_with_hold` [s, s2,
    s3].
    """

    time: Floats
    poses: Floats
    used: Bools
    restarts: Bools
    sent_s: Floats
    u: Floats
    watchdog: float
    lag: float
    hold_moments: tuple[float, float, float]

    @classmethod
    def from_track(cls, track: Track) -> "TrackFrames":
        """Select the frames at least SHORTEST_S apart, from the first direction to the stop.

        A robot's poses are used from the time at which it drives. With lagging wheels, they are
        used from its last standstill, because its turning rate cannot be seen while it starts.
        After a gap of UNSEEN_S, the poses restart the filter.

        Raises:
            UsageError: If no direction was sent, or if there are very many between two frames.
        """
        if not len(track.sent):
            raise UsageError(f"{track.source}: the log has no direction that was sent")
        rows = np.flatnonzero(track.time <= track.until)
        before_s = float(track.sent[0]) - FRAME_GAP_MIN_S
        rows = rows[rows_apart(track.time[rows], FRAME_GAP_MIN_S, before_s)]
        time = track.time[rows]
        poses = np.nan_to_num(track.poses[rows])
        valid = track.valid[rows]
        driving = _find_driving_frames(time, poses, valid, track.lag > 0)
        used = valid & np.logical_or.accumulate(driving, axis=0)
        # when each robot's pose was last used before each frame (M, N), -inf if never
        latest = np.maximum.accumulate(np.where(used, time[:, None], -np.inf), axis=0)
        last_used = np.vstack([np.full((1, used.shape[1]), -np.inf), latest])[: len(time)]
        restarts = used & (time[:, None] - last_used > RESTART_GAP_S)
        most = np.diff(np.searchsorted(track.sent, time)).max(initial=0)
        if most > DIRECTIONS_MAX:
            raise UsageError(
                f"{most} directions were sent between two successive frames, too "
                "many for an identification",
                "log more frames",
            )
        return cls(
            time=track.exposed[rows],
            poses=poses,
            used=used & ~restarts,
            restarts=restarts,
            sent_s=track.sent,
            u=track.u,
            watchdog=track.watchdog,
            lag=track.lag,
            hold_moments=_hold_moments(track),
        )


def _find_driving_frames(time: Floats, poses: Floats, valid: Bools, lagging: bool) -> Bools:
    """Find the frames in which each robot drives, shape (M, N).

    For a robot with lagging wheels, driving starts AT_REST_S earlier.
    """
    moved = np.diff(poses[..., :2], axis=0)
    pace = np.hypot(moved[..., 0], moved[..., 1]) / np.diff(time)[:, None]
    pace[~(valid[:-1] & valid[1:])] = np.nan
    driving = np.zeros_like(valid)
    driving[1:] = pace >= DRIVING_FRACTION * _median_of_columns(pace)
    if lagging:
        driving_from_s = np.where(driving.any(axis=0), time[driving.argmax(axis=0)], np.inf)
        driving |= time[:, None] >= driving_from_s - REST_BEFORE_DRIVING_S
    return driving


def _hold_moments(track: Track) -> tuple[float, float, float]:
    """Compute for how long lagging wheels keep a rate: mean first three powers [s, s2, s3].

    The means are taken over time. The host sends the wheels a new rate with each command.
    """
    is_before_end = track.sent <= track.until
    gaps_s = np.diff(track.sent[is_before_end])
    if track.lag == 0 or not gaps_s.any():
        return 0.0, 0.0, 0.0
    return (
        float(np.average(gaps_s, weights=gaps_s)),
        float(np.average(gaps_s**2, weights=gaps_s)),
        float(np.average(gaps_s**3, weights=gaps_s)),
    )


def intervals_used(tracks: Sequence[TrackFrames]) -> Integers:
    """Return the number of intervals between frames in which each robot drives (N,)."""
    return np.sum([track.used.sum(axis=0) for track in tracks], axis=0)


def speeds(tracks: Sequence[TrackFrames]) -> Floats:
    """Compute the median speed of each robot between frames (N,) [length unit/s].

    Only intervals in which a robot drives count. The speed is infinite if a robot has none.
    """
    paces = []
    for track in tracks:
        moved = np.diff(track.poses[..., :2], axis=0)
        gaps_s = np.diff(track.time, axis=0)
        measured = track.used[1:] & (track.used | track.restarts)[:-1] & (gaps_s > 0)
        pace = np.hypot(moved[..., 0], moved[..., 1]) / np.where(gaps_s > 0, gaps_s, 1.0)
        paces.append(np.where(measured, pace, np.nan))
    return _median_of_columns(np.concatenate(paces))


def position_noise(tracks: Sequence[TrackFrames]) -> Floats:
    """Estimate the noise of each robot's measured positions (N,) [length unit].

    The estimate is the median distance of a position from the line between its two neighbours in
    time.
    """
    noises: list[float] = []
    for robot in range(tracks[0].used.shape[1]):
        distances: list[Floats] = [np.zeros(1)]
        for track in tracks:
            used = track.used[:, robot]
            times = track.time[used, robot]
            for places in track.poses[used, robot, :2].T:
                fraction = (times[1:-1] - times[:-2]) / np.maximum(
                    times[2:] - times[:-2], FRAME_GAP_MIN_S
                )
                interpolated = places[:-2] + fraction * (places[2:] - places[:-2])
                distances.append(np.abs(places[1:-1] - interpolated))
        median_distance = float(np.median(np.concatenate(distances)))
        noises.append(median_distance / MEDIAN_DISTANCE)
    return np.array(noises)


def speed_wander(tracks: Sequence[TrackFrames]) -> Floats:
    """Compute the relative standard deviation of each robot's speed (N,) between blocks of time.

    A block lasts WANDER_S. The result is 0 if the speed is measured in only one block. It is the
    deviation of a normal distribution with the same quantiles INNER as the blocks.
    """
    wanders: list[float] = []
    for robot in range(tracks[0].used.shape[1]):
        paces: list[float] = []
        for track in tracks:
            paces += _paces_of_blocks(track, robot)
        wander = 0.0
        if len(paces) > 1:
            lower, median, upper = np.quantile(paces, (QUANTILES[0], 0.5, QUANTILES[1]))
            wander = (upper - lower) / (QUANTILE_STDS * abs(median))
        wanders.append(wander)
    return np.array(wanders)


def _paces_of_blocks(track: TrackFrames, robot: int) -> list[float]:
    """Compute the speed of a robot along its heading in each block with enough measurements.

    Intervals in which the robot nearly stands still are left out, because lost commands may stop a
    robot.
    """
    is_measured = track.used[1:, robot] & track.used[:-1, robot]
    if not is_measured.any():
        return []
    x, y, heading = track.poses[:, robot].T
    turned = np.asarray(wrap(np.diff(heading)))
    distance = (np.diff(x + 1j * y) * np.exp(-1j * (heading[:-1] + turned / 2))).real
    gaps_s = np.diff(track.time[:, robot])
    step_s = float(np.median(gaps_s[is_measured]))
    window = np.ones(max(1, round(SPEED_WINDOW_S / step_s)))
    window_distance = np.convolve(np.where(is_measured, distance, 0.0), window, "same")
    window_s = np.convolve(np.where(is_measured, gaps_s, 0.0), window, "same")
    pace = window_distance / np.where(window_s > 0, window_s, np.inf)
    drives = is_measured & (pace > STANDING_FRACTION * np.median(pace[is_measured]))
    block = ((track.time[1:, robot] - track.time[0, robot]) / SPEED_BLOCK_S).astype(np.int64)
    distances = np.bincount(block[drives], distance[drives])
    durations_s = np.bincount(block[drives], gaps_s[drives])
    is_full = durations_s > BLOCK_FRACTION_MIN * SPEED_BLOCK_S
    return (distances[is_full] / durations_s[is_full]).tolist()


def _median_of_columns(pace: Floats) -> Floats:
    """Compute the median of each column without NaN.

    It is infinite for a column without numbers.
    """
    medians = []
    for column in pace.T:
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
    blocks = blocks or [np.zeros(len(track.time), dtype=np.int64) for track in tracks]
    block_count = 1 + max(block[-1] for block in blocks)
    block_ln_likelihoods = np.zeros((block_count, len(dead_times_s), len(rows)))
    lost_directions = np.zeros(len(rows))
    residuals: list[Floats] = []
    for track, block in zip(tracks, blocks, strict=True):
        _begin_track(bank, track)
        model = first_model._replace(
            watchdog_s=track.watchdog, host_lag_s=track.lag, hold=track.hold_moments
        )
        watch = _ResidualWatch(track.u, len(rows)) if watched else None
        _run_track(bank, model, track, rows, spacing_s, watch, block_ln_likelihoods, block)
        if watch is not None:
            residuals += watch.residuals
            lost_directions += watch.lost
        # each branch of a row goes on from the likeliest one
        best = bank.ln_weight.argmax(axis=2)[..., None, None]
        bank.state[...] = np.take_along_axis(bank.state, best, axis=2)
        bank.cov[...] = np.take_along_axis(bank.cov, best[..., None], axis=2)
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
    bank.state[..., LAG] = track.lag
    if track.lag > 0:  # the wheels stand until the first direction acts
        bank.direction[...] = np.nan
        bank.next_command[:] = 0
    else:  # the first direction also acts before its time
        bank.direction[...] = track.u[0]
        bank.next_command[:] = 1
    bank.until_s[...] = bank.dead_time_s[..., None] + track.sent_s[0] + track.watchdog


def _run_track(
    bank: Bank,
    model: FilterModel,
    track: TrackFrames,
    rows: NDArray[np.int64],
    spacing_s: float,
    watch: "_ResidualWatch | None",
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
        watch: Collects residuals. None to collect nothing.
        block_ln_likelihoods: The ln likelihood of each block (K, B, R), to which this function
            adds.
        block: The index of each frame's block (F,).
    """
    from tetractl.control.estimation.kernels import filter as kernel

    commands = SentCommands(track.sent_s, track.u)
    times = track.time[:, rows]
    poses = np.ascontiguousarray(track.poses[:, rows])
    used = np.ascontiguousarray(track.used[:, rows])
    restarts = np.ascontiguousarray(track.restarts[:, rows])
    # the filter is called with two frames: one without poses, by which no interval is too long
    # for its commands, and the camera's
    frame_poses = np.full((2, *poses.shape[1:]), np.nan)
    frame_valid = np.zeros((2, len(rows)), np.bool_)
    previous = np.full(len(rows), -np.inf)
    for frame, times_now in enumerate(times):
        frame_times = np.stack([np.maximum(previous, times_now - 2 * RESTART_GAP_S), times_now])
        frame_poses[1] = poses[frame]
        frame_valid[1] = used[frame]
        frames = PoseFrames(frame_times, frame_poses, frame_valid)
        likelihoods = kernel.follow(bank, model, commands, frames, False, spacing_s)
        block_ln_likelihoods[block[frame]] += likelihoods
        bank.noise_scale[...] = 1.0
        if restarts[frame].any():
            kernel.place(bank, model, NO_COMMANDS, times_now, poses[frame], restarts[frame])
        if watch is not None:
            watch.add(bank, poses[frame], used[frame])
        previous = times_now


class _ResidualWatch:
    """Collects residuals along a track, for the dead time in the middle of a bank.

    `residuals` has an entry (R,) for each frame: the residuals of headings [rad]. `lost` (R,) is
    the expected number of the directions u (C,) that did not reach a robot.
    """

    def __init__(self, u: Floats, rows: int) -> None:
        self.residuals: list[Floats] = []
        self._u = u
        self._rows = np.arange(rows)
        # by the newest direction sent: the probability that the robot follows another one; the
        # last row is of none sent
        self._missed = np.zeros((len(u) + 1, rows))

    def add(self, bank: Bank, poses: Floats, used: Bools) -> None:
        """Add the residuals of a frame.

        Args:
            bank: The filters.
            poses: The poses, shape (R, 3).
            used: Whether each pose is used, shape (R,).
        """
        middle = len(bank.dead_time_s) // 2
        ln_weight = bank.ln_weight[middle]
        state = bank.state[middle, self._rows, ln_weight.argmax(axis=1)]
        self.residuals.append(np.where(used, wrap(poses[:, 2] - state[:, 2]), np.nan))
        newest = bank.next_command[middle] - 1
        follows_another = bank.direction[middle] != self._u[newest][:, None]
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
