"""Runs the controller's filter over whole tracks: likelihood, estimates and residuals.

This is the only module of a log's identification that knows the compiled filter. A pass has R rows,
each a robot with assumed noise and walks, and a bank of B dead times. The filter is the one that
the controller runs (`control.filter`), with its hypotheses of lost commands and of a stuck robot;
turning rate a, speed and heading bias are constant states, and the noise is as assumed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tetractl.control.kernels.filter_state import (
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
from tetractl.core.poses import Bools, Floats, wrap
from tetractl.model.motion.motion import PARAMETERS
from tetractl.replay.identification.tracks import Track

SHORTEST_S = 0.035  # shortest interval: a frame that follows sooner is left out
DRIVING = 0.5  # a robot drives if it travels at least this fraction of its usual distance
DIRECTIONS_MAX = 10_000  # largest number of directions between two frames
UNSEEN_S = 0.3  # time without a pose after which a row restarts from the camera's next pose [s]
AT_REST_S = 0.3  # time before it drives at which a robot with lagging wheels certainly stands [s]
POINTS = np.arange(-2.0, 3.0)  # dead times of a parabola, in standard deviations
UNKNOWN_S = 0.3  # standard deviation from which a dead time counts as unknown [s]
GROWTH = 0.2, 5.0  # range of the new standard deviation of the dead time over the one before
IDENTIFIED = [LN_A, LN_SPEED, TURN_BIAS]  # the filter's states of a `Belief`


@dataclass(frozen=True, slots=True)
class TrackFrames:
    """M frames of a track and the C directions u [rad], sent `when` (C,) [s], that act in them.

    `time` (M, N) are the times of the poses [s]. `used` (M, N) is which of the poses (M, N, 3) the
    filter is updated by; at those with `placed` (M, N) it starts from the camera's pose. Robots
    that receive nothing for `watchdog` [s] stop; their wheels follow with the time constant `lag`
    [s], and keep a rate for `hold`, as `model.motion.turn_rate.held` has it [s, s2, s3].
    """

    time: Floats
    poses: Floats
    used: Bools
    placed: Bools
    when: Floats
    u: Floats
    watchdog: float
    lag: float
    hold: tuple[float, float, float]

    @classmethod
    def of(cls, track: Track) -> "TrackFrames":
        """Return the frames at least SHORTEST_S apart, from the first direction to the stop.

        A robot's poses are used from where it drives, those of one with lagging wheels from where
        it still stands: how fast it turns amid its start cannot be seen. After a gap of UNSEEN_S
        they restart it. UsageError if no direction was sent, or very many between two frames.
        """
        if not len(track.sent):
            raise UsageError(f"{track.source}: no direction was sent")
        kept, last = [], float(track.sent[0]) - SHORTEST_S
        for k in np.flatnonzero(track.time <= track.until).tolist():
            if track.time[k] - last >= SHORTEST_S - 1e-9:
                kept.append(k)
                last = track.time[k]
        time, poses, valid = track.time[kept], np.nan_to_num(track.poses[kept]), track.valid[kept]
        moved = np.diff(poses[..., :2], axis=0)
        pace = np.hypot(moved[..., 0], moved[..., 1]) / np.diff(time)[:, None]
        pace[~(valid[:-1] & valid[1:])] = np.nan
        driving = np.zeros_like(valid)
        driving[1:] = pace >= DRIVING * _usual(pace)
        if track.lag > 0:
            first = np.where(driving.any(axis=0), time[driving.argmax(axis=0)], np.inf)
            driving |= time[:, None] >= first - AT_REST_S
        seen = valid & np.logical_or.accumulate(driving, axis=0)
        latest = np.maximum.accumulate(np.where(seen, time[:, None], -np.inf), axis=0)
        before = np.vstack([np.full((1, seen.shape[1]), -np.inf), latest])[: len(time)]
        placed = seen & (time[:, None] - before > UNSEEN_S)
        most = np.diff(np.searchsorted(track.sent, time)).max(initial=0)
        if most > DIRECTIONS_MAX:
            raise UsageError(f"{most} directions were sent between two frames", "log more frames")
        return cls(
            time=track.exposed[kept],
            poses=poses,
            used=seen & ~placed,
            placed=placed,
            when=track.sent,
            u=track.u,
            watchdog=track.watchdog,
            lag=track.lag,
            hold=_hold(track),
        )


def _hold(track: Track) -> tuple[float, float, float]:
    """Return the means over time of the first three powers of how long lagging wheels keep the rate
    of a heading [s, s2, s3]: the host sends them a new one with each command."""
    apart_s = np.diff(track.sent[track.sent <= track.until])
    if track.lag == 0 or not apart_s.any():
        return 0.0, 0.0, 0.0
    first, second, third = (float(np.average(apart_s**k, weights=apart_s)) for k in (1, 2, 3))
    return first, second, third


def speeds(tracks: Sequence[TrackFrames]) -> Floats:
    """Return the median distance per time of each robot (N,) between frames [length unit/s]."""
    pace = []
    for track in tracks:
        moved = np.hypot(*np.diff(track.poses[..., :2], axis=0).transpose(2, 0, 1))
        both = track.used[1:] & (track.used | track.placed)[:-1]
        apart = np.diff(track.time, axis=0)
        pace.append(np.where(both & (apart > 0), moved / np.where(apart > 0, apart, 1.0), np.nan))
    return _usual(np.concatenate(pace))


def _usual(pace: Floats) -> Floats:
    """Return the median of each column, infinity for one without numbers."""
    numbers = [column[np.isfinite(column)] for column in pace.T]
    return np.array([np.median(one) if one.size else np.inf for one in numbers])


class Belief(NamedTuple):
    """What is assumed of R rows: `mean` and `std` (R, 3) of ln a, ln of the speed and heading bias;
    standard deviations `noise` (R, 2) of a measured position [length unit] and heading [rad], and
    `walk` (R, 2) of their random walks [1/sqrt(s)].
    """

    mean: Floats
    std: Floats
    noise: Floats
    walk: Floats


class Passed(NamedTuple):
    """The results of a pass: `likelihood` (B, R) is its logarithm, up to a constant; `mean` and
    `std` (B, R, 3) are as in `Belief`.

    For the dead time in the middle of the bank, if watched: `residuals` (F, R, 3) along the path,
    across it and of the heading, NaN where a pose is not used; `lost` (R,) is the expected number
    of directions that did not reach the robot.
    """

    likelihood: Floats
    mean: Floats
    std: Floats
    residuals: Floats
    lost: Floats


def run(
    tracks: Sequence[TrackFrames],
    rows: NDArray[np.int64],
    belief: Belief,
    tau: Floats,
    apart_s: float = 0.0,
    watched: bool = False,
) -> Passed:
    """Run the filter over tracks for robots `rows` (R,) and dead times tau (B,) [s], each uncertain
    by `apart_s`.
    """
    from tetractl.control.kernels import filter as kernel

    first, bank = _start(belief, tau)
    each, middle = np.arange(len(rows)), len(tau) // 2
    likelihood, lost = np.zeros((len(tau), len(rows))), np.zeros(len(rows))
    residuals = []
    for track in tracks:
        bank.ln_weight[...], bank.ln_weight[..., 0] = -np.inf, 0.0
        commands = SentCommands(track.when, track.u)
        if track.lag > 0:  # the wheels stand until the first direction acts
            bank.direction[...] = np.nan
            bank.next_command[:] = 0
        else:  # the first direction also acts before its time
            bank.direction[...] = track.u[0]
            bank.next_command[:] = 1
        bank.until_s[...] = bank.dead_time_s[..., None] + track.when[0] + track.watchdog
        model = first._replace(watchdog_s=track.watchdog, lag_s=track.lag, hold=track.hold)
        of_all = track.poses, track.used, track.placed
        poses, used, placed = (np.ascontiguousarray(one[:, rows]) for one in of_all)
        missed = np.zeros((len(track.u) + 1, len(rows)))  # the last row: before any was sent
        frames, seen = np.full((2, *poses.shape[1:]), np.nan), np.zeros((2, len(rows)), np.bool_)
        last = np.full(len(rows), -np.inf)
        for now, pose, use, fresh in zip(track.time[:, rows], poses, used, placed, strict=True):
            time = np.stack([np.maximum(last, now - 2 * UNSEEN_S), now])
            frames[1], seen[1], last = pose, use, now
            both = PoseFrames(time, frames, seen)
            likelihood += kernel.follow(bank, model, commands, both, False, apart_s)
            bank.noise_scale[...] = 1.0
            if fresh.any():
                none = SentCommands(np.empty(0), np.empty(0))
                kernel.place(bank, model, none, time[1], pose, fresh)
            if watched:
                ln_weight, latest = bank.ln_weight[middle], bank.next_command[middle] - 1
                z = bank.state[middle, each, ln_weight.argmax(axis=1)]
                residuals.append(np.where(use[:, None], _residual(pose, z), np.nan))
                others = np.exp(ln_weight) * (bank.direction[middle] != track.u[latest][:, None])
                missed[latest, each] = others[:, :-1].sum(axis=1)
        lost += missed[:-1].sum(axis=0)
        best = bank.ln_weight.argmax(axis=2)[..., None, None]
        bank.state[...] = np.take_along_axis(bank.state, best, axis=2)
        bank.cov[...] = np.take_along_axis(bank.cov, best[..., None], axis=2)
    variance = np.diagonal(bank.cov[:, :, 0], axis1=2, axis2=3)[..., IDENTIFIED]
    mean, std = bank.state[:, :, 0, IDENTIFIED], np.sqrt(np.maximum(variance, 0.0))
    return Passed(likelihood, mean, std, np.array(residuals), lost)


def marginal(
    tracks: Sequence[TrackFrames], belief: Belief, tau: float, tau_std: float, watched: bool = False
) -> tuple[float, float, Floats, Floats, Passed]:
    """Run the filter with dead times around `tau` [s], apart by `tau_std`, for N robots.

    Returns the likeliest dead time and its standard deviation [s], by a parabola, means and
    standard deviations (N, 3) there, which account for that of the dead time, and the pass.
    """
    rows, taus = np.arange(len(belief.mean)), tau + POINTS * tau_std
    found = run(tracks, rows, belief, taus, watched=watched)
    total = found.likelihood.sum(axis=1)
    bend, slope, _ = np.polyfit(POINTS, total, 2)
    best = -slope / (2 * bend) if bend < 0 else POINTS[total.argmax()]
    best = float(np.clip(best, 2 * POINTS[0], 2 * POINTS[-1]))
    shape = belief.mean.shape
    rise, middle = np.polyfit(POINTS, found.mean.reshape(len(POINTS), -1), 1)
    std = tau_std * float(np.clip(np.sqrt(0.5 / max(-bend, 1e-9)), *GROWTH))
    std = min(std, UNKNOWN_S)
    deviation = np.hypot(found.std[len(POINTS) // 2], rise.reshape(shape) * std / tau_std)
    return tau + best * tau_std, std, (middle + best * rise).reshape(shape), deviation, found


def _start(belief: Belief, tau: Floats) -> tuple[FilterModel, Bank]:
    """Return the filter's model and its bank at the start."""
    count = len(belief.mean)
    noise, walk = np.repeat(belief.noise, (2, 1), axis=1).T, np.zeros((STATES_OF_WHEELS, count))
    walk[:3] = np.repeat(belief.walk, (2, 1), axis=1).T
    mean = np.zeros((len(tau), count, STATES))
    std = np.zeros((count, STATES_OF_WHEELS))
    mean[..., IDENTIFIED] = belief.mean
    std[:, IDENTIFIED] = belief.std
    bank = Bank.start(tau, mean, std, np.zeros(len(tau), dtype=np.int64), LOG_FOLLOWS)
    noise, ones = np.ascontiguousarray(noise), np.ones((count, len(PARAMETERS)))
    return FilterModel(ones, noise, walk, 0.0, 0.0, np.inf, branch_all=True), bank


def _residual(pose: Floats, z: Floats) -> Floats:
    """Return measured poses (R, 3) less estimated ones: along the path, across it, in heading."""
    x, y, heading = (pose - z[:, :3]).T
    c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
    return np.column_stack([c * x + s * y, c * y - s * x, wrap(heading)])
