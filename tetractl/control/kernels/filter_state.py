"""The state of `tetractl.control.filter`, and what its filters assume; without the compiler.

The state of a robot is, in the order of the indices below: x, y, heading of its course, helix as
sine and cosine; ln of a and of the speed over the spec's, `side`, LN_W, turn bias, marker bias, and
flow along x and y. LN_W is ln of a rate: of a cell, of its helix's frequency over the usual one;
of wheels, of the `saturation` of their motors, which do not saturate from 0 on. The first MOVED
change with time, the others only by their random walk. Swing and pace have no variance.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tetractl.control.prior import Sticks
from tetractl.core.poses import Floats

X, Y, HEADING, SINE, COSINE, LN_A, LN_V, SIDE, LN_W, BIAS, MARKER, FLOW_X, FLOW_Y = range(13)
MOVED, SIZE = LN_A, FLOW_Y + 1  # number of state variables that move, and of all with a covariance
SWING, PACE = range(SIZE, SIZE + 2)  # turning rate / a and speed / v of lagging wheels
STATE = PACE + 1  # number of state variables
FOUND, DRIFT, MISFIT, TURNS, STANDS = 20, slice(11, 13), slice(13, 16), slice(16, 19), 19
"""The numbers found of a robot: its pose, a, speed, turn bias, heading bias, the deviations of all
but the turn bias, the direction followed, flow and the misfit of the model; `side`, its deviation,
`saturation`, and the probability that it stands."""
FOLLOWS = STUCK = 3
"""Number of latest commands that a robot may follow; then comes the slot of the hypothesis that a
robot stands although it was sent a direction."""
SLOTS = STUCK + 1
LOG_FOLLOWS = 6
"""The same number for logs, where commands may follow each other sooner than the frames tell
whether a robot heard the one before: it may have heard any of them, and the likeliest are kept."""


class Assumed(NamedTuple):
    """What the filter assumes of radio, robots and camera."""

    still: float = 1e-3  # pace below which a stopped robot counts as standing
    substep_s: float = 0.025  # longest step between two additions of random walks
    substeps: int = 4000  # most of them: beyond 100 s without a command they are longer
    lost: float = 0.05  # probability that a command does not arrive
    alike: float = 0.1  # squared difference of two hypotheses' headings, over the variance
    gate: float = 30.0  # squared deviation above which a measurement is an outlier
    least_weight: float = -25.0  # least ln of a hypothesis's weight
    lost_track_s: float = 0.3  # time without a fit after which the camera's pose is used
    scale_memory: float = 400.0  # number of frames over which the noise is averaged
    scale_least: float = 1e-3  # least ratio of observed to expected variances
    scale_most: float = 10.0  # greatest such ratio
    mean_capped: float = 0.8  # mean of the square of a standard normal number, capped at 4
    forget_s: float = 10.0  # time constant with which scores of dead times decay
    block: int = 8  # number of frames of a block of innovations
    most_square: float = 25.0  # largest square of a block's sum
    least_blocks: int = 10  # number of blocks for which those that are missing count as empty
    # standard normal quantile of 0.999: a limit of chi-square is by Wilson and Hilferty
    sure: float = 3.09


class BankGrid(NamedTuple):
    """How a robot's filters are spread over dead times and frequencies of the helix."""

    step_s: float = 0.02  # initial spacing of the dead times
    finest_s: float = 0.005  # a grid with this spacing or less is not refined further
    reach: float = 3.0  # half width at first, in standard deviations of the prior
    unlikely: float = 25.0  # a filter is dropped if its ln likelihood is less than the best by this
    own: float = 0.1  # probability that a robot's dead time differs from the others'
    own_s: float = 0.06  # standard deviation of such a difference
    same_pitch: float = 0.05  # distance of ln frequencies below which they are the same


ASSUMED, GRID = Assumed(), BankGrid()


class Shared(NamedTuple):
    """What a bank of B filters of N robots tells of their dead times, at T times of a grid."""

    near: Floats  # (T, B, N) how likely a time is for the others, given a filter's dead time
    prior: Floats  # (T,) ln of the prior of each time
    room: Floats  # (T, N) scratch
    score: Floats  # (B, N) ln of each filter's probability, up to a constant
    dead_times: Floats  # (2, N) each robot's dead time and its standard deviation [s]


class FilterModel(NamedTuple):
    """The prior on N robots; `noise` and `walk` are standard deviations."""

    parameters: Floats  # (N, K) PARAMETERS of the motion
    noise: Floats  # (3, N) of measured x, y [length unit] and heading [rad]
    walk: Floats  # (SIZE, N) deviation of the state's random walk [1/sqrt(s)]
    helix: float  # its angular frequency [rad/s], 0 if there is none
    lag: float  # time constant with which turning rate and speed follow a direction [s]
    watchdog: float  # time without a command after which a robot stops, or inf [s]
    sticks: Sticks = Sticks()
    hold: float = 0.0  # time for which wheels keep a turning rate that they were sent [s]
    coarse: bool = False  # whether poses of robots that drive may be equal


class Bank(NamedTuple):
    """B filters of each of N robots, each with its own dead time and SLOTS or more hypotheses."""

    state: Floats  # (B, N, SLOTS, STATE)
    cov: Floats  # (B, N, SLOTS, SIZE, SIZE)
    u: Floats  # (B, N, SLOTS) direction followed [rad], NaN for a robot that stands
    until: Floats  # (B, N, SLOTS) time at which its watchdog stops a robot that follows u [s]
    weight: Floats  # (B, N, SLOTS) ln of the probability, -inf if there is none
    scale: Floats  # (B, N, 2) ratio of observed to expected variances of positions and headings
    unfit: Floats  # (B, N) time since a hypothesis fitted [s]
    # (B, N, 2, 4) innovations along and across the course and of the heading, over their
    # deviations, and 1: sums over the present block; then sums of the former blocks' mean squares
    white: Floats
    tau: Floats  # (B, N) dead time [s]
    score: Floats  # (B, N) ln of the likelihood, up to a constant; -inf for no filter
    next: NDArray[np.int64]  # (B, N) index of the command that acts next
    pitch: NDArray[np.int64]  # (B, N) which frequency of the helix the filter started from

    @classmethod
    def start(
        cls,
        tau: Floats,
        mean: Floats,
        std: Floats,
        pitch: NDArray[np.int64],
        follows: int = FOLLOWS,
    ) -> Self:
        """Return filters with dead times tau (B,) of robots that stand, with one hypothesis each:
        means and standard deviations of the states, (B, N, STATE) and (N, SIZE), and `pitch` (B,).
        There is room for `follows` hypotheses of robots that drive, and one of a stuck robot.
        """
        count, total, slots = len(std), len(tau), follows + 1
        weight = np.full((total, count, slots), -np.inf)
        weight[..., 0] = 0.0
        cov = np.zeros((total, count, slots, SIZE, SIZE))
        cov[..., range(SIZE), range(SIZE)] = std[:, None] ** 2
        return cls(
            np.repeat(mean[:, :, None], slots, axis=2),
            cov,
            np.full(weight.shape, np.nan),
            np.full(weight.shape, np.inf),
            weight,
            np.ones((total, count, 2)),
            np.zeros((total, count)),
            np.zeros((total, count, 2, 4)),
            np.repeat(tau[:, None], count, axis=1),
            np.zeros((total, count)),
            np.zeros((total, count), dtype=np.int64),
            np.repeat(pitch[:, None], count, axis=1),
        )

    def part(self, which: NDArray[np.int64]) -> Self:
        """Return each robot's filters `which` (B, N)."""
        robots = np.arange(which.shape[1])
        return self._make(column[which, robots] for column in self)
