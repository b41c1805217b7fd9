"""Finds which poses of a robot are real measurements, from the poses alone.

A tracker that has lost a robot may repeat its last pose, report zeros, take another body for the
robot, or see the robot turned. `measured` leaves out two kinds of poses: repeated poses after which
the robot is suddenly far away, and series of poses that jump away and back. For the second kind, it
joins stretches of poses without a jump into chains, and keeps the chain with most poses. Each jump
in a chain costs as many poses as JUMP_S contains.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from tetractl.core.poses import Bools, Floats, Integers, wrap

REPEATS_MIN = 2
"""Minimum number of repeats in a row that are no measurement."""
RELEASE_RATIO_MIN = 2.5
"""Distance or turn between two poses above which a robot has moved while its pose repeated.

It is relative to the usual distance or turn.
"""
SPEED_RATIO_MAX = 10.0
"""Speed above which a distance between two poses is a jump, relative to the usual speed."""
TURN_ALLOWANCE_RAD = 0.5
"""Turn between two poses that is never a jump, however short their time [rad].

A turn is a jump if it exceeds TURN_ALLOWANCE_RAD plus the time between the poses times the larger
of TURN_RATE_MIN and three times the usual rate. This limit is at most TURN_MAX_RAD.
"""
TURN_RATE_MIN = 4.0
"""Minimum turning rate in the limit of a turn that is no jump [rad/s]."""
TURN_MAX_RAD = 2.2
"""Maximum turn between two poses that is no jump [rad]."""
ANY_TURN_S = 0.5
"""Time after which a robot may have turned by any angle [s]."""
JUMP_S = 1.0
"""Duration of poses that a jump outweighs: stretches of twice as long are left out [s]."""
USUAL_QUANTILE = 0.6
FAST_QUANTILE = 0.9
"""Quantiles of turns and distances that count as usual.

Two in five turns may be to and from a flipped heading.
"""
MEDIAN_BEND_OF_NOISE = 1.442
"""Median distance of a position from the mean of its neighbours, relative to its noise.

It is 1.177 sqrt(1.5) if all three have the same noise.
"""
NOISE_STDS_MAX = 10.0
"""Maximum distance of two positions that noise alone explains [standard deviations]."""
DISTANCE_MIN = 1e-9
"""Distance below which nothing is a jump [length unit]."""


def measured(times: Floats, poses: Floats) -> Bools:
    """Find which poses (M, 3) of a robot at `times` (M,) [s] are real measurements.

    Poses that repeat before the robot is suddenly far away are not, and neither are series of poses
    that jump away and back. The result has shape (M,).
    """
    if not len(times):
        return np.zeros(0, dtype=np.bool_)
    without_repeats = np.flatnonzero(~_find_repeats(poses))
    chain = _find_longest_chain(times[without_repeats], poses[without_repeats])
    is_measured = np.zeros(len(times), dtype=np.bool_)
    is_measured[without_repeats[chain]] = True
    return is_measured


def _find_repeats(poses: Floats) -> Bools:
    """Find the poses (M, 3) that repeat the previous pose, or its heading or place.

    Repeats count until the robot is suddenly far away, or until the end.
    """
    distances = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turns_rad = np.abs(wrap(np.diff(poses[:, 2])))
    same_heading = turns_rad == 0
    same_position = distances == 0
    same_pose = same_heading & same_position
    turns_far = turns_rad > RELEASE_RATIO_MIN * _compute_fast_step(turns_rad)
    moves_far = distances > RELEASE_RATIO_MIN * _compute_fast_step(distances)
    poses_frozen = _find_frozen(same_pose, np.append(turns_far | moves_far, True))
    # until the end, a robot that drives straight keeps its heading, and a robot that turns on the
    # spot keeps its position
    headings_frozen = _find_frozen(same_heading & ~same_pose, np.append(turns_far, False))
    positions_frozen = _find_frozen(same_position & ~same_pose, np.append(moves_far, False))
    return poses_frozen | headings_frozen | positions_frozen


def _compute_fast_step(steps: Floats) -> float:
    """Compute the quantile FAST_QUANTILE of the distances or turns (M - 1,) that are above 0.

    The result is 0 if there are none.
    """
    changes = steps[steps > 0]
    return float(np.quantile(changes, FAST_QUANTILE)) if changes.size else 0.0


def _find_frozen(is_same: Bools, is_release: Bools) -> Bools:
    """Find the poses (M,) after at least REPEATS_MIN equal steps (M - 1,) in a row.

    A release (M,) must follow these steps. The end of the track is the last release.
    """
    frozen = np.zeros(len(is_same) + 1, dtype=np.bool_)
    if not is_same.any() or is_same.all():
        return frozen
    changes = np.diff(is_same.astype(np.int64), prepend=0, append=0)
    run_begins = np.flatnonzero(changes == 1)
    run_ends = np.flatnonzero(changes == -1)
    for first_row, end_row in zip(run_begins.tolist(), run_ends.tolist(), strict=True):
        if end_row - first_row >= REPEATS_MIN and is_release[end_row]:
            is_jump = (
                first_row > 0 and is_release[first_row - 1]
            )  # to 0, as of a robot that is lost
            frozen[first_row if is_jump else first_row + 1 : end_row + 1] = True
    return frozen


@dataclass(frozen=True, slots=True)
class _JumpLimits:
    """Limits of how far a robot can move from one pose to another.

    Attributes:
        times: Times of the poses, shape (M,) [s].
        poses: Poses, shape (M, 3).
        speed: The robot's usual speed [length unit/s].
        rate: Its usual turning rate [rad/s].
        usual_s: The usual time between two poses [s]. Time stamps can be late by this time.
        noise: Standard deviation of the positions by noise [length unit].
    """

    times: Floats
    poses: Floats
    speed: float
    rate: float
    usual_s: float
    noise: float

    @classmethod
    def from_poses(cls, times: Floats, poses: Floats) -> "_JumpLimits":
        """Find the usual speed, turning rate and noise of a robot with three or more poses."""
        usual_s = float(np.median(np.diff(times)))
        gaps_s = np.maximum(np.diff(times), usual_s)
        speeds = np.hypot(*np.diff(poses[:, :2], axis=0).T) / gaps_s
        turn_rates = np.abs(wrap(np.diff(poses[:, 2]))) / gaps_s
        # a single pose at a wrong place makes two long distances in a row, but not three
        sustained_speeds = minimum_filter1d(speeds[speeds > 0], 3)
        speed = np.quantile(sustained_speeds, FAST_QUANTILE) if len(sustained_speeds) else 0.0
        rate = max(TURN_RATE_MIN, 3 * np.quantile(turn_rates, USUAL_QUANTILE))
        bends = np.diff(poses[:, :2], 2, axis=0) / 2
        noise = float(np.median(np.hypot(bends[:, 0], bends[:, 1]))) / MEDIAN_BEND_OF_NOISE
        return cls(times, poses, float(speed), float(rate), usual_s, noise)

    def are_jumps(self, from_rows: Integers, to_rows: Integers) -> Bools:
        """Check whether the robot moves or turns too far between the poses of each of K pairs (K,).

        `from_rows` and `to_rows` are indices of poses.
        """
        gaps_s = np.maximum(self.times[to_rows] - self.times[from_rows], self.usual_s)
        changes = self.poses[to_rows] - self.poses[from_rows]
        distance = np.hypot(changes[:, 0], changes[:, 1])
        turn_rad = np.abs(wrap(changes[:, 2]))
        turn_max = np.minimum(TURN_ALLOWANCE_RAD + self.rate * gaps_s, TURN_MAX_RAD)
        turns_away = (turn_rad > turn_max) & (gaps_s <= ANY_TURN_S)
        distance_max = (
            SPEED_RATIO_MAX * self.speed * gaps_s + NOISE_STDS_MAX * self.noise + DISTANCE_MIN
        )
        return turns_away | (distance > distance_max)


def _find_longest_chain(times: Floats, poses: Floats) -> Integers:
    """Find the longest chain in the poses (M, 3) at `times` (M,) [s], and return its indices (K,).

    A stretch is a series of poses without a jump. A chain consists of whole stretches. Its length
    is the number of its poses, minus the number of poses in JUMP_S for each jump. A chain leaves
    out at most twice this number of poses at once.
    """
    n_poses = len(times)
    if n_poses < 3:
        return np.arange(n_poses)
    limits = _JumpLimits.from_poses(times, poses)
    starts_stretch = limits.are_jumps(np.arange(n_poses - 1), np.arange(1, n_poses))
    jump_rows = np.flatnonzero(starts_stretch) + 1
    stretch_begins = np.concatenate([[0], jump_rows])
    stretch_ends = np.concatenate([jump_rows, [n_poses]])
    step_s = float(np.median(np.diff(times)))
    jump_cost = max(1.0, JUMP_S / step_s)
    length_by_stretch = (stretch_ends - stretch_begins).astype(np.float64)
    previous_stretch = np.full(len(stretch_begins), -1)
    for stretch in range(1, len(stretch_begins)):
        earliest = np.searchsorted(stretch_ends, stretch_begins[stretch] - 2 * jump_cost)
        earlier_stretches = np.arange(earliest, stretch)
        is_jump = limits.are_jumps(
            stretch_ends[earlier_stretches] - 1,
            np.full(len(earlier_stretches), stretch_begins[stretch]),
        )
        chain_lengths = length_by_stretch[earlier_stretches] - jump_cost * is_jump
        if chain_lengths.max() > 0:
            previous_stretch[stretch] = earlier_stretches[chain_lengths.argmax()]
            length_by_stretch[stretch] += chain_lengths.max()
    chain: list[Integers] = []
    stretch = int(length_by_stretch.argmax())
    while stretch >= 0:
        chain.append(np.arange(stretch_begins[stretch], stretch_ends[stretch]))
        stretch = int(previous_stretch[stretch])
    return np.concatenate(chain[::-1])
