"""The data of the filters that learn how robots move: states, arrays, and assumptions.

`tetractl.control.estimation.filter` explains the filters. Nothing in this file needs the compiler.

**State.** For each robot, a filter estimates the position (x, y), the heading theta in which the
robot travels, its turning rate a, and its speed v. It also estimates a turn bias beta; a marker
bias m, which is added to the measured heading; and the flow (f_x, f_y), which carries the robot or
with which it slides. Under a direction u, a robot moves by

    dx/dt = v cos theta + f_x,   dy/dt = v sin theta + f_y,   dtheta/dt = a sin(u + beta - theta).

A cell also swims on a helix with the angular frequency w. Its sideways swing has the sine part p
and the cosine part q. (For robots on wheels, p = q = 0.)

    dp/dt = w q,   dq/dt = -w p.

All parameters drift as random walks, so that old measurements lose their weight. Robots may turn
faster to one side. The motors of wheels may saturate, so that the robot turns no faster than some
maximum rate (`tetractl.model.motion.turn_rate`). Turning rate and speed of wheels approach the
commanded values with the time constant T, their lag. The host assumes a lag, with which it predicts
the heading at which the robot would come to a standstill. The direction acts on that heading
(`filter_motion`). `filter_measure` explains what a camera measures.

**Arrays.** Each state of a robot has one index, see below. All states have a variance except the
last four. Robots on wheels have no helix: their covariance ends before HELIX_SINE, and their helix
states stay 0. Cells have all states, but their LN_SATURATION stays 0.

The arrays of a `Bank` have an entry for each filter b of B, and for each robot i of N. Arrays of
hypotheses also have an entry for each slot s of S. In all slots except the last, the robot drives
and follows one of the recent commands. In the last slot, the robot is stuck.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tetractl.control.estimation.prior import Prior, Sticks
from tetractl.core import elementwise
from tetractl.core.motion_estimate import INNOVATIONS, Estimate
from tetractl.core.poses import Bools, Floats, Poses

# Slots of the state.
X = 0
"""Index of the position along x [length unit]."""
Y = 1
"""Index of the position along y [length unit]."""
HEADING = 2
"""Index of the heading theta of the course [rad], which is not wrapped."""
LN_A = 3
"""Index of the logarithm of the turning rate a, relative to the prior's.

This state and the three that follow are in the order of `RobotParameters`.
"""
LN_SPEED = 4
"""Index of the logarithm of the speed v, relative to the prior's."""
SIDE = 5
"""Index of k, if a robot turns by a exp(k) to the left and by a exp(-k) to the right."""
LN_SATURATION = 6
"""Index of the logarithm of the motors' saturation (`tetractl.model.motion.turn_rate`).

From 0 on, the motors do not saturate.
"""
TURN_BIAS = 7
"""Index of the turn bias beta: the direction to which a robot turns minus the one sent [rad]."""
MARKER_BIAS = 8
"""Index of the marker bias m, which is added to the measured heading [rad]."""
FLOW_X = 9
"""Index of the flow along x [length unit/s]."""
FLOW_Y = 10
"""Index of the flow along y [length unit/s]."""
HELIX_SINE = 11
"""Index of p, the position of a cell on its helix to the left of its course [length unit]."""
HELIX_COSINE = 12
"""Index of q, which is p a quarter of a period later [length unit]."""
LN_FREQUENCY = 13
"""Index of the logarithm of the helix's angular frequency w, relative to the usual one."""
SWING = 14
"""Index of the turning rate of lagging wheels, as a multiple of a."""
PACE = 15
"""Index of the speed of lagging wheels, as a fraction of v, from 0 to 1."""
HOST_SWING = 16
"""Index of the turning rate that the host of lagging wheels assumes, as a multiple of a."""
LAG = 17
"""Index of the lag T of the wheels: how slowly turning rate and speed follow a direction [s].

It never changes: each lag that is tried has filters of its own.
"""

STATES_OF_WHEELS = FLOW_Y + 1
"""Number of states of a robot on wheels that have a variance."""
STATES_OF_CELLS = LN_FREQUENCY + 1
"""Number of states of a cell that have a variance."""
STATES = LAG + 1
"""Length of the state of a robot, including the entries without a variance."""

ALONG = 0
"""Index of the innovation of the position along the course. HEADING is the third index."""
ACROSS = 1
"""Index of the innovation of the position across the course."""
POSITIONS = 0
"""Index of the ratio for positions in `Bank.noise_scale`."""
HEADINGS = 1
"""Index of the ratio for headings in `Bank.noise_scale`."""

FOLLOWS = 3
"""Number of hypotheses of a filter in which the robot follows one of the latest commands."""
LOG_FOLLOWS = 6
"""Number of such hypotheses for filters that evaluate a log.

In logs, commands may follow each other sooner than the frames show whether a robot received the
one before. It may have received any of them, and the likeliest are kept.
"""

# Without another source, a value was chosen once, and docs/decisions/filter.md has the errors
# measured with it. Those of one module alone are there.
LOSS_PROBABILITY = 0.05
"""Assumed probability that a robot misses a command."""
GATE = 30.0
"""Sum of squared innovations above which a measured pose is an outlier.

Chi-square of 3 numbers exceeds it once in 700,000 poses.
"""
LEAST_BLOCKS = 10
"""Minimum number of blocks in the test of the model. Missing blocks count as perfect ones."""
QUANTILE = 3.09
"""Standard normal quantile of 0.999, the level of the test of innovations."""
GRID_STEP_S = 0.02
"""Distance between the dead times of neighbouring filters at the start [s]."""
FINEST_STEP_S = 0.005
"""Distance between dead times below which a grid is not refined [s].

It is a sixth of the time between frames.
"""
REFINED = 3
"""Number of dead times that a grid must be reduced to before it is refined."""
OWN_PROBABILITY = 0.1
"""Assumed probability that a robot's dead time differs from the others'."""
OWN_STD_S = 0.06
"""Standard deviation of the difference of such a robot's dead time [s]."""


class SentCommands(NamedTuple):
    """The C commands that were sent to all robots, in the order of their times."""

    sent_s: Floats
    """Times at which the commands were sent [s], shape (C,)."""
    directions: Floats
    """Directions of the commands [rad], shape (C,). NaN for a stop."""


class PoseFrames(NamedTuple):
    """Camera frames with the poses of N robots. The first frame is where the filters start."""

    time_s: Floats
    """Times of the poses [s], shape (F, N)."""
    poses: Floats
    """Measured x, y [length unit] and heading [rad], shape (F, N, 3)."""
    valid: Bools
    """Whether each pose was measured and may be used, shape (F, N)."""

    def part(self, begin: int, end: int) -> Self:
        """Return the frames from index `begin` up to, but not including, `end`."""
        return self._make(column[begin:end] for column in self)


class FilterModel(NamedTuple):
    """The assumptions of the Kalman filters about N robots: how they move and are measured.

    `noise` contains the standard deviations of a measured pose. `walk` contains, for each state,
    the standard deviation of its random change, which grows with the square root of time.
    """

    parameters: Floats
    """Prior turning rate a [rad/s] and speed v [length unit/s] of each robot, shape (N, 2)."""
    noise: Floats
    """Standard deviations of measured x, y [length unit] and heading [rad], shape (3, N)."""
    walk: Floats
    """Random walk of each of the n states with a variance [unit of the state/sqrt(s)], (n, N)."""
    helix_rad_s: float
    """Usual angular frequency of a cell's helix [rad/s]. 0 for robots on wheels."""
    host_lag_s: float
    """The lag of the wheels that their host assumes [s]. 0 if it neglects the lag."""
    watchdog_s: float
    """Time without a command after which a robot stops [s]. Infinity if robots do not stop."""
    sticks: Sticks = Sticks()
    """How often, and for how long, robots ignore commands."""
    hold: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Means over time of the first three powers of how long wheels keep a turning rate [s, s2, s3].

    They are 0 if the rate is always that of the present heading.
    """
    coarse: bool = False
    """Whether the camera is so coarse that the poses of driving robots may repeat exactly."""
    branch_all: bool = False
    """Whether every hypothesis branches when a command takes effect, as for logs.

    Otherwise only the likeliest one does, which is all the controller has time for.
    """


class Bank(NamedTuple):
    """B Kalman filters for each of N robots, each filter for another possible dead time.

    The dead time is the time from a command to its effect. Each filter has S hypotheses about what
    its robot is doing.
    """

    state: Floats
    """State of each hypothesis, shape (B, N, S, STATES)."""
    cov: Floats
    """Covariance P of each hypothesis, shape (B, N, S, n, n).

    n is STATES_OF_WHEELS or STATES_OF_CELLS: only these states have a variance.
    """
    direction: Floats
    """Direction u that the robot follows [rad], shape (B, N, S). NaN if it stands still."""
    until_s: Floats
    """Time at which its watchdog stops a robot that follows a direction [s], shape (B, N, S)."""
    ln_weight: Floats
    """ln of each hypothesis's probability, shape (B, N, S). -inf for an empty slot."""
    noise_scale: Floats
    """Ratios of observed to expected variances, shape (B, N, 2): of positions and of headings."""
    unfit_s: Floats
    """Time since a measured pose last fitted the likeliest hypothesis [s], shape (B, N)."""
    block_sum: Floats
    """Sums of the innovations in the present block of frames, shape (B, N, 3).

    The three are the innovations along and across the course and of the heading, each divided by
    its standard deviation.
    """
    block_frames: Floats
    """Number of frames in the present block, shape (B, N)."""
    square_sum: Floats
    """Sums of the mean squares of all complete blocks, for each innovation, shape (B, N, 3)."""
    blocks: Floats
    """Number of complete blocks, shape (B, N)."""
    dead_time_s: Floats
    """Assumed dead time tau of each filter [s], shape (B, N)."""
    step_s: Floats
    """Distance between the dead times of a robot's filters [s], shape (B, N).

    It is the same for all filters of a robot.
    """
    score: Floats
    """ln of the likelihood of the robot's own frames, up to a constant, shape (B, N).

    It is -inf if there is no filter.
    """
    shared_score: Floats
    """ln of the filter's probability given the frames of all robots, up to a constant, (B, N)."""
    next_command: NDArray[np.int64]
    """Index of the next command that takes effect in each filter, shape (B, N)."""
    group: NDArray[np.int64]
    """Group of each filter, shape (B, N): from which tried value it started (`filter_start`)."""

    @classmethod
    def start(
        cls,
        dead_time_s: Floats,
        mean: Floats,
        std: Floats,
        group: NDArray[np.int64],
        follows: int = FOLLOWS,
    ) -> Self:
        """Create filters for robots that stand still, with one hypothesis each.

        Args:
            dead_time_s: The dead time of each filter (B,) [s].
            mean: The means of the states (B, N, STATES).
            std: The standard deviations of the states with a variance (N, n).
            group: The group of each filter (B,).
            follows: The number of slots for hypotheses of robots that drive. There is one more
                slot, for a stuck robot.
        """
        robots, states = std.shape
        per_filter = (len(dead_time_s), robots)
        per_slot = (*per_filter, follows + 1)
        ln_weight = np.full(per_slot, -np.inf)
        ln_weight[..., 0] = 0.0
        cov = np.zeros((*per_slot, states, states))
        cov[..., range(states), range(states)] = np.square(std[:, None])
        return cls(
            state=np.repeat(mean[:, :, None], follows + 1, axis=2),
            cov=cov,
            direction=np.full(per_slot, np.nan),
            until_s=np.full(per_slot, np.inf),
            ln_weight=ln_weight,
            noise_scale=np.ones((*per_filter, 2)),
            unfit_s=np.zeros(per_filter),
            block_sum=np.zeros((*per_filter, 3)),
            block_frames=np.zeros(per_filter),
            square_sum=np.zeros((*per_filter, 3)),
            blocks=np.zeros(per_filter),
            dead_time_s=np.repeat(dead_time_s[:, None], robots, axis=1),
            step_s=np.full(per_filter, GRID_STEP_S),
            score=np.zeros(per_filter),
            shared_score=np.zeros(per_filter),
            next_command=np.zeros(per_filter, dtype=np.int64),
            group=np.repeat(group[:, None], robots, axis=1),
        )

    @classmethod
    def joined(cls, banks: Sequence[Self]) -> Self:
        """Join several banks of the same robots into one bank, with all their filters."""
        return cls._make(np.concatenate(columns) for columns in zip(*banks, strict=True))

    def copied(self) -> Self:
        """Return a copy of the bank, whose arrays can be changed independently."""
        return self._make(column.copy() for column in self)

    def part(self, rows: NDArray[np.int64]) -> Self:
        """Select the filters with the indices `rows`, shape (R, N), separately for each robot."""
        robots = np.arange(rows.shape[1])
        return self._make(column[rows, robots] for column in self)

    def padded(self, count: int) -> Self:
        """Extend the arrays to `count` filters for each robot.

        The added rows are marked as unused.
        """
        size, robots = self.dead_time_s.shape
        rows = np.minimum(np.arange(count), size - 1)
        padded = self.part(rows[:, None].repeat(robots, axis=1))
        padded.score[size:] = -np.inf
        return padded


class Hypotheses(NamedTuple):
    """The S hypotheses of a filter about what its robot is doing, for example that it is stuck.

    The fields are explained in `Bank`.
    """

    state: Floats
    """State of each hypothesis, shape (S, STATES)."""
    cov: Floats
    """Covariance P of each hypothesis, shape (S, n, n)."""
    direction: Floats
    """Direction that the robot follows [rad], shape (S,). NaN if it stands still."""
    until_s: Floats
    """Time at which the robot's watchdog stops it [s], shape (S,)."""
    ln_weight: Floats
    """ln of each hypothesis's probability, shape (S,). -inf for an empty slot."""


class FilterScratch(NamedTuple):
    """Working arrays in which a filter predicts and updates one hypothesis."""

    jacobian: Floats
    """F, the derivatives of a step with respect to the state before it, shape (n, n)."""
    product: Floats
    """The product F P, shape (n, n)."""
    p_h: Floats
    """The product P H' for one measured number, shape (n,)."""
    expected: Floats
    """The pose that the camera is expected to measure, shape (3,)."""
    off: Floats
    """The measured minus the expected pose, shape (3,)."""
    variance: Floats
    """The variances of the measured x, y and heading, shape (3,)."""
    slopes: Floats
    """H, the derivatives of the measured numbers with respect to the state, shape (3, n)."""
    innovation: Floats
    """The innovation of the hypothesis that was updated last, shape (3,)."""
    likeliest_innovation: Floats
    """The innovation of the likeliest hypothesis, shape (3,)."""
    parents: Hypotheses
    """The S - 1 hypotheses that drive, as they are before a command splits all of them."""
    ln_branches: Floats
    """ln of the probabilities of their branches: command received, or missed, shape (2, S - 1)."""
    parent_of: NDArray[np.int64]
    """Index of the parent whose branch is in each slot, shape (S - 1,)."""

    @classmethod
    def room_for(cls, bank: Bank) -> Self:
        """Create working arrays for the filters of a bank."""
        driving = bank.ln_weight.shape[2] - 1
        states = bank.cov.shape[4]
        return cls(
            jacobian=np.eye(states),
            product=np.empty((states, states)),
            p_h=np.empty(states),
            expected=np.empty(3),
            off=np.empty(3),
            variance=np.empty(3),
            slopes=np.zeros((3, states)),
            innovation=np.zeros(3),
            likeliest_innovation=np.zeros(3),
            parents=Hypotheses(
                state=np.empty((driving, STATES)),
                cov=np.empty((driving, states, states)),
                direction=np.empty(driving),
                until_s=np.empty(driving),
                ln_weight=np.empty(driving),
            ),
            ln_branches=np.empty((2, driving)),
            parent_of=np.empty(driving, np.int64),
        )


class CommonTimes(NamedTuple):
    """A grid of T dead times, from a command to its effect, that all robots may share.

    It also contains how well each filter agrees with each of these times.
    """

    near: Floats
    """Density of each time for the other robots, given a filter's dead time [1/s], (T, B, N)."""
    ln_prior: Floats
    """ln of the prior density of each time, up to a constant, shape (T,)."""

    @classmethod
    def of(cls, bank: Bank, prior: Prior) -> Self:
        """Compute the shared dead times for the filters of a bank.

        If filter b of robot i is right, the robot's dead time is tau_b, with an uncertainty of half
        the step of its grid, step_s. Another robot has the same dead time, except with a small
        probability OWN_PROBABILITY; then it differs by about OWN_STD_S. Up to a factor, this gives
        the density

            near = (1 - own) g(t - tau_b, step_s / 2) + own g(t - tau_b, own_s),

        where g(d, s) = exp(-(d/s)^2 / 2) / s.
        """
        times_s = np.arange(0, float(bank.dead_time_s.max()) + FINEST_STEP_S, FINEST_STEP_S / 2)
        gaps_s = times_s[:, None, None] - bank.dead_time_s
        width_s = np.maximum(bank.step_s, FINEST_STEP_S) / 2
        near = (1 - OWN_PROBABILITY) * elementwise.exp(-np.square(gaps_s / width_s) / 2) / width_s
        near += OWN_PROBABILITY * elementwise.exp(-np.square(gaps_s / OWN_STD_S) / 2) / OWN_STD_S
        deviations = (times_s - prior.dead_time) / (prior.dead_time_std or 1.0)
        return cls(near=near, ln_prior=-np.square(deviations) / 2)


class NextFilters(NamedTuple):
    """The C filters of each of N robots that are kept for the next frames; `select` fills it."""

    rows: NDArray[np.int64]
    """Indices of the kept filters in the bank, shape (C, N). -1 after a robot's last one."""
    dead_time_s: Floats
    """The dead time that each kept filter gets [s], shape (C, N)."""
    score: Floats
    """The score that each kept filter gets, shape (C, N)."""
    step_s: Floats
    """New distance between each robot's dead times [s], shape (N,)."""

    @classmethod
    def room_for(cls, size: int, bank: Bank) -> Self:
        """Create empty arrays for `size` filters of each robot of a bank."""
        step_s = bank.step_s[0].copy()
        shape = (size, len(step_s))
        return cls(
            rows=np.empty(shape, np.int64),
            dead_time_s=np.empty(shape),
            score=np.empty(shape),
            step_s=step_s,
        )

    def taken_from(self, bank: Bank) -> Bank:
        """Return a bank that consists of these filters, each with its new dead time and score.

        If a robot has fewer filters than others, copies of its last filter fill the rest. They do
        not count as filters.
        """
        goes_on = self.rows >= 0
        number = goes_on.sum(axis=0)  # of filters of each robot (N,)
        places = np.minimum(np.arange(number.max())[:, None], number - 1)
        chosen = bank.part(np.take_along_axis(self.rows, places, axis=0))
        chosen.dead_time_s[:] = np.take_along_axis(self.dead_time_s, places, axis=0)
        chosen.score[:] = np.take_along_axis(self.score, places, axis=0)
        chosen.score[~goes_on[: len(places)]] = -np.inf
        chosen.step_s[:] = self.step_s
        return chosen


class Forecast(NamedTuple):
    """Where each robot will be, and how it moves, by its most probable filter and hypothesis.

    `kernels.bank.forecast` fills it.

    Poses and `directions` are predicted for the moment when the next command acts on each robot,
    assuming that the robot receives everything that was already sent. Fields without a description
    here are explained in `Estimate`.
    """

    x: Floats
    y: Floats
    heading: Floats
    directions: Floats
    """Directions that the robots follow [rad], shape (N,). NaN if a robot stands still."""
    turn_bias: Floats
    """Directions to which robots turn, minus the directions sent [rad], shape (N,)."""
    flow: Floats
    """Flow that carries each robot, along x and y [length unit/s], shape (N, 2)."""
    a: Floats
    a_std: Floats
    speed: Floats
    speed_std: Floats
    heading_bias: Floats
    heading_bias_std: Floats
    misfit: Floats
    side: Floats
    side_std: Floats
    saturation: Floats
    stands: Floats
    lag: Floats | None
    """The lag of each robot's wheels [s], shape (N,). None if the lag is not learnt."""
    lag_std: Floats | None
    own_dead_time: Floats
    own_dead_time_std: Floats
    dead_time_s: float
    """The mean of the robots' dead times [s]."""
    dead_time_std_s: float
    """Standard deviation of the dead time, including the differences between robots [s]."""

    @classmethod
    def room_for(cls, robots: int) -> Self:
        """Create a forecast for this many robots whose arrays are filled with NaN."""
        arrays: dict[str, Any] = {name: np.full(robots, np.nan) for name in cls._fields}
        arrays["flow"] = np.full((robots, 2), np.nan)
        arrays["misfit"] = np.full((robots, len(INNOVATIONS)), np.nan)
        return cls(**arrays)._replace(lag=None, lag_std=None, dead_time_s=0.0, dead_time_std_s=0.0)

    @property
    def poses(self) -> Poses:
        """The poses predicted by each robot's likeliest filter when the next command acts on it.

        If its wheels lag, it is the pose at which it would come to rest if it stopped then.
        """
        return Poses(self.x, self.y, self.heading)

    @property
    def estimate(self) -> Estimate:
        """The estimate of the robots' motion after the last frame, with standard deviations."""
        return Estimate(
            a=self.a,
            a_std=self.a_std,
            speed=self.speed,
            speed_std=self.speed_std,
            heading_bias=self.heading_bias,
            heading_bias_std=self.heading_bias_std,
            dead_time=self.dead_time_s,
            dead_time_std=self.dead_time_std_s,
            misfit=self.misfit,
            side=self.side,
            side_std=self.side_std,
            saturation=self.saturation,
            stands=self.stands,
            lag=self.lag,
            lag_std=self.lag_std,
            own_dead_time=self.own_dead_time,
            own_dead_time_std=self.own_dead_time_std,
        )


def largest_square_sum(blocks: float) -> float:
    """Compute the limit that a sum of squared standard normal numbers rarely exceeds.

    Chance exceeds the limit once in a thousand times. The limit is a quantile of the chi-square
    distribution, in the approximation of Wilson and Hilferty (1931).

    Args:
        blocks: The number of squares.
    """
    part = 2 / (9 * blocks)
    root = 1 - part + QUANTILE * math.sqrt(part)
    return blocks * root * root * root
