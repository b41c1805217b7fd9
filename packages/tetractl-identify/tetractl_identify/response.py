"""Fits how robots on two wheels follow commands of speed v and turning rate w.

**Model.** A command acts `dead_time` after it is sent. The speed p(t) and turning rate q(t) that it
leads to follow it with first-order lags of their own. From one pose to the next a robot

    turns by   turning_gain * integral of q  +  veer * integral of p  +  a random walk's step
    drives     speed_gain * integral of p    +  a term in q          +  a random walk's step

along its heading. Poses are measured with white noise, which two neighbouring steps share with
opposite signs: the covariance of the steps is tridiagonal. If the commands may be timed by another
clock, its times run apart from those of the poses at the rate `clock_drift`, and the dead time is
the one in the middle of the recording.

**Fit.** For given `ResponseParameters` (dead time, lags, noise) the steps are linear in the gains,
so that `_Whitened` has their restricted likelihood in closed form. The gains have a wide prior,
which only matters where the data cannot tell two of them apart, as on circles. `_delay` finds the
delay after which commands explain most of the motion, whatever the difference of the clocks. From a
grid around this delay, `_search` finds the likeliest parameters. Intervals are
normal in the dead time, the gains and the logarithms of the others, and as wide as the differences
of blocks of BLOCK_S require: gains of real robots wander over seconds, which no model of white
noise and random walks contains.

**Check.** If the commands explain less than half of what a robot does, there are no values
(`explained`). Unusual values are printed, and named below the table (`unusual`).

**Data.** Steps last at least STEP_S. The fit leaves out steps in which no command acts, since a
robot without commands stands still, and steps that are FAR times further off than usual, as where a
tracker takes one body for another.

Shapes: a robot has S steps in all its tracks, of which the fit uses M; one track has C commands.
Pairs of a motion's two integrals stand in columns: of p, then of q.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.optimize import minimize

from tetractl.core.errors import UsageError, printable
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.tools.likelihood import NORMAL, UNLIKELY, SampleInterval, derivatives
from tetractl.tools.table.table import Column, Table
from tetractl_identify.explained import (
    Explained,
    explained,
    refuse_contradicted,
    windows_of,
)
from tetractl_identify.fit import block_numbers, wider_of_blocks
from tetractl_identify.identify import INTERVALS_MIN, cell, labels_of
from tetractl_identify.pose_steps import Complex, PoseSteps, robust_gains
from tetractl_identify.tracks import Track, integrals_of_sent, rows_apart
from tetractl_identify.unusual import (
    GAINS,
    USUAL,
    may_be_usual,
    undetermined_values,
    unusual_values,
)

STEP_S = 0.1
"""Least duration of a step [s]."""
LONGEST_S = 0.55
LONGEST = 2.2
"""A step is left out, since the robot was not seen, if it lasts LONGEST_S [s] or more, and LONGEST
times the median time between two poses."""
FAR = 8.0
"""How far off a step is that is left out, in standard deviations."""
NEIGHBOURS = 5
"""How many steps earlier or later commands may act than they seem to at first."""
CLIP = 3.0
"""Standard deviations at which residuals are clipped for a first estimate of the noise."""
STD_OF_MEDIAN = 1.48
"""Standard deviation of normal numbers over the median of their magnitudes."""
SAME_LAG_S = 0.02
"""How well a lag has to be known to be of use in a spec [s]."""
GRID_DEAD_TIMES_S = np.arange(-0.25, 0.26, 0.05)
"""Dead times from which the search may start, less that of the start [s]."""
GRID_TURNING_LAGS_S = np.array([0.03, 0.1, 0.3])
"""Lags of turning from which it may start [s]; that of speed starts at its unit."""
CLOCKS_S = np.arange(-200, 201) / 20
PEAK = 5
"""Delays that are tried, less the expected one [s]; and their number to either side of one that it
has to exceed."""
AS_GOOD = 0.1
REVERSED = 0.8
"""Share of the motion by which a delay nearer to the expected one may explain less; and that for
which a delay counts if robots turn right where they are sent left."""
CLIPPED = 0.02
"""Fraction of the rates that is clipped at either end."""
DEAD_TIME_UNIT_S = 0.05
LAG_UNIT_S = 0.1
HEADING_WALK_UNIT = 0.02
"""[rad/sqrt(s)]"""
HEADING_NOISE_UNIT = 0.003
"""[rad]"""
WAY_WALK_UNIT = 0.02
"""Of the speed times 1 sqrt(s)."""
POSITION_NOISE_UNIT_S = 0.002
"""Of the speed: usual values of the parameters, in which they are searched."""
LN_MOST = 25.0
"""Maximum magnitude of the logarithm of a parameter over its unit: beyond it, numbers overflow."""
LAG_LEAST_S = 1e-3
LAG_MOST_S = 10.0
"""Shorter and longer lags are taken for these [s]."""
GRADIENT = 1e-3
"""Slope of ln of the posterior, per unit of the parameters, at which the search ends."""
INTEGRALS_KEPT = 64
"""Number of integrals that are not computed again: most parameters do not change them."""
UNIT_LEAST = 0.02
UNIT_STDS = 3.0
"""Unit of the parameters for the intervals: UNIT_STDS standard deviations, from UNIT_LEAST to 1 of
the units of the search."""
SEARCHED = 8
"""Number of the parameters that are searched; behind them in a vector come the gains."""
PRIOR_STD = 5.0
"""Standard deviation of the prior of each parameter, in its units: hardly any prior."""
TURN_ERROR_RAD = 5e-4
WAY_ERROR = 0.005
"""Standard deviations by which the model errs in a turn [rad], and in a distance, relative to the
usual one. Robots do not drive arcs, and wheels turn by whole counts."""
GAIN_PRIOR_STD = 10.0
"""Standard deviation of the prior of the gains around 1, or relative to gains above 1: hardly any
prior."""
OTHER_PRIOR_STD = 1.0
"""Standard deviation of the prior of what the other integral adds to a motion, around 0, relative
to the motion: hardly any prior."""
ONE_RATIO = 0.999
"""Squared correlation of the two integrals above which the data cannot tell them apart, as on
circles. The motion is then taken for the robot's own."""
NOTHING = 1e-6
ONE_RATIO_STD = 0.3
"""Factor on the deviation of the prior in this case; and the deviation of the gains then, relative
to them."""
UNKNOWN = 5.0
"""Half width of the interval of a logarithm from which the data do not bound the value."""
UNKNOWN_S = 0.45
"""Half width of the interval of the dead time that its prior alone makes, nearly [s]."""
RESOLVED_S = 1e-3
RESOLVED_GAIN = 1e-3
"""Standard deviations of times [s] and of gains that no recording resolves: stamps are in ms, and a
camera is calibrated to 0.1 % at best."""
DRIFT_S = 0.1
"""By how much two clocks run apart in a recording, from which it is said [s]."""


@dataclass(frozen=True, slots=True)
class RobotResponse:
    """How one robot follows its commands; see the fields of `FittedRobot` for the noise.

    Attributes:
        name: The robot.
        turning_gain: Turning rate, over the one that was sent.
        speed_gain: Speed, over the one that was sent.
        veer: How much the robot turns per distance travelled while w is 0 [rad/length unit].
        heading_offset: Mean angle from the heading to the motion [rad], in the sense of v.
        clock_drift: How fast the times of commands run apart from those of the poses [s/s]. None
            if both are of one clock.
        turning_explained: How much of the turning the commands explain.
        distance_explained: How much of the distance travelled they explain.
        duration_s: Duration of the recording, of the longest if there are several [s].
        intervals: Number of steps used.
        left_out: Number of steps left out because they are too far off.
    """

    name: str
    dead_time: SampleInterval
    turning_lag: SampleInterval
    speed_lag: SampleInterval
    turning_gain: SampleInterval
    speed_gain: SampleInterval
    veer: SampleInterval
    heading_offset: SampleInterval
    heading_walk: SampleInterval
    heading_noise: SampleInterval
    way_walk: SampleInterval
    position_noise: SampleInterval
    clock_drift: SampleInterval | None
    turning_explained: Explained
    distance_explained: Explained
    duration_s: float
    intervals: int
    left_out: int

    @property
    def quantities(self) -> dict[str, SampleInterval]:
        """The values by name, in the order of a table's rows."""
        values = {name: getattr(self, name) for name in UNITS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def problem(self) -> str:
        """What contradicts the commands; "" if nothing does."""
        turns = self.turning_explained.is_contradicted(
            may_be_usual("turning_gain", self.turning_gain)
        )
        drives = self.distance_explained.is_contradicted(
            may_be_usual("speed_gain", self.speed_gain)
        )
        of_turning = f"{self.turning_explained} of the turning" if turns else ""
        of_distance = f"{self.distance_explained} of the distance travelled" if drives else ""
        return " and ".join(filter(None, (of_turning, of_distance)))


UNITS = {
    "dead_time": "s",
    "turning_lag": "s",
    "speed_lag": "s",
    "turning_gain": "",
    "speed_gain": "",
    "veer": "rad/{unit}",
    "heading_offset": "rad",
    "heading_walk": "rad/sqrt(s)",
    "heading_noise": "rad",
    "way_walk": "{unit}/sqrt(s)",
    "position_noise": "{unit}",
    "clock_drift": "s/s",
}
"""The units of `quantities`; {unit} is the tracks' unit of length."""


def respond(tracks: Sequence[Track], dead_time: float = 0.1) -> list[RobotResponse]:
    """Fit how each robot of the tracks follows its commands.

    Args:
        tracks: Tracks of the same robots, with the speeds and turning rates that were sent.
        dead_time: The expected dead time [s], which decides if several explain the motion.

    Raises:
        UsageError: If a robot drives too little, or if its commands explain less than half of what
            it does.
    """
    responses: list[RobotResponse] = []
    for robot, name in enumerate(tracks[0].names):
        driven = [_driven_track(track, robot) for track in tracks]
        responses.append(_response(name, _usable_steps(name, driven, dead_time)))
    sources = dict.fromkeys(source for track in tracks for source in track.sources)
    problems = [(response.name, response.problem) for response in responses if response.problem]
    refuse_contradicted(tuple(sources), problems)
    return responses


# ---- Steps ----


@dataclass(frozen=True, slots=True)
class _DrivenTrack:
    """One robot in one track: the `steps` between its poses at `pose_s` (S + 1,) [s], and the
    `commands` (C, 2) of v and w that it was sent at `sent_s` (C,) [s]. `two_clocks` is as in
    `Track`."""

    pose_s: Floats
    steps: PoseSteps
    sent_s: Floats
    commands: Floats
    two_clocks: bool

    @property
    def duration_s(self) -> float:
        """Time from the first pose to the last [s]."""
        return float(self.pose_s[-1] - self.pose_s[0]) if len(self.pose_s) else 0.0

    def integrals(self, dead_time: float, lag: float, drift: float = 0.0) -> Floats:
        """Return the integrals over each step (S, 2) of the rates r that follow the commands u.

        From lag dr/dt = u - r the integral of r is that of u less lag times the rise of r, hence
        the difference of U(t) - lag r(t) between a step's ends, with U the integral of u. Between
        two commands r tends to u as exp(-t / lag); robots have the first command's rates before it.
        """
        if len(self.pose_s) < 2 or not len(self.sent_s):
            return np.zeros((len(self.steps.turned), 2))
        apart_s = np.diff(self.sent_s)
        decay = np.exp(-apart_s / lag)
        # r at each command: r[k + 1] = decay[k] r[k] + (1 - decay[k]) u[k], a system in two bands
        bands = np.ones((2, len(self.commands)))
        bands[1, :-1] = -decay
        bands[1, -1] = 0.0
        first = self.commands[:1]
        rest = (1 - decay)[:, None] * self.commands[:-1]
        rates = solve_banded((1, 0), bands, np.vstack([first, rest]))
        of_commands = np.cumsum(apart_s[:, None] * self.commands[:-1], axis=0)
        total = np.vstack([np.zeros((1, 2)), of_commands])

        middle_s = (self.pose_s[0] + self.pose_s[-1]) / 2
        acting_s = self.pose_s - dead_time + drift * (self.pose_s - middle_s)
        newest = np.maximum(np.searchsorted(self.sent_s, acting_s, side="right") - 1, 0)
        command = self.commands[newest]
        since_s = (acting_s - self.sent_s[newest])[:, None]
        rate = command + (rates[newest] - command) * np.exp(-np.maximum(since_s, 0.0) / lag)
        return np.diff(total[newest] + since_s * command - lag * rate, axis=0)

    def sent(self, delay: float) -> Floats:
        """Return the way and turn that were sent in each step (S, 2), a delay [s] before."""
        until = integrals_of_sent(self.sent_s, self.commands, self.pose_s - delay)
        return np.diff(until, axis=0)

    def acts(self, dead_time: float) -> Bools:
        """Return in which steps (S,) a command acts."""
        times = self.pose_s - dead_time
        return (times[:-1] >= self.sent_s[0]) & (times[1:] <= self.sent_s[-1])


def _driven_track(track: Track, robot: int) -> _DrivenTrack:
    """Return the steps of a robot in a track, and its commands."""
    times_s = track.exposed[:, robot]
    frames = np.flatnonzero(track.valid[:, robot])
    frames = frames[rows_apart(times_s[frames], STEP_S)]
    commanded = np.isfinite(track.twists[:, robot]).all(axis=1)
    return _DrivenTrack(
        pose_s=times_s[frames],
        steps=PoseSteps.between(times_s[frames], track.poses[frames, robot]),
        sent_s=track.sent[commanded],
        commands=track.twists[commanded, robot],
        two_clocks=track.two_clocks,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """The M steps of a robot that the fit uses.

    Attributes:
        tracks: All tracks of the robot.
        rows: Which of the steps of all tracks are used, shape (M,).
        turned: Turns, shape (M,) [rad].
        moved: Distances along and across the heading, shape (M,), as in `PoseSteps`.
        begin_s: Begin of each step, shape (M,) [s].
        duration_s: Duration of each step, shape (M,) [s].
        block: Number of the block in which each step is, shape (M,).
        neighbours: Whether the next step begins with the pose at which a step ends, shape (M - 1,).
        left_out: Number of steps left out because they are too far off.
        dead_time: Dead time from which the search starts [s].
        drift_unit: Usual drift of the clocks, in which it is searched; 0 for one clock.
        in_one_ratio: Whether speed and turning rate are sent in one ratio.
    """

    tracks: list[_DrivenTrack]
    rows: Integers
    turned: Floats
    moved: Complex
    begin_s: Floats
    duration_s: Floats
    block: Integers
    neighbours: Bools
    left_out: int
    dead_time: float
    drift_unit: float
    in_one_ratio: bool

    @property
    def way(self) -> Floats:
        """The distances along the heading (M,) [length unit]."""
        return self.moved.real

    @property
    def speed(self) -> float:
        """The median speed [length unit/s]."""
        return max(float(np.median(np.abs(self.way) / self.duration_s)), 1e-12)

    def integrals(self, p: "ResponseParameters") -> Floats:
        """Return the integrals over each step (M, 2) of the speed and the turning rate, each with
        its lag."""
        of_speed = self._with_lag(p.dead_time, p.speed_lag, p.clock_drift)
        of_turning = self._with_lag(p.dead_time, p.turning_lag, p.clock_drift)
        return np.column_stack([of_speed[:, 0], of_turning[:, 1]])

    @lru_cache(INTEGRALS_KEPT)  # noqa: B019 few are kept
    def _with_lag(self, dead_time: float, lag: float, drift: float) -> Floats:
        """Return the integrals over each step (M, 2), both with one lag."""
        return _integrals(self.tracks, dead_time, lag, drift)[self.rows]


def _integrals(
    tracks: Sequence[_DrivenTrack], dead_time: float, lag: float, drift: float = 0.0
) -> Floats:
    """Return the integrals over all steps of some tracks (S, 2)."""
    return np.concatenate([track.integrals(dead_time, lag, drift) for track in tracks])


def _usable_steps(name: str, tracks: list[_DrivenTrack], expected_s: float) -> _Steps:
    """Choose the steps of a robot to use, for an expected dead time [s]; UsageError if they are too
    few."""
    steps = PoseSteps.together([track.steps for track in tracks])
    drives = steps.duration_s < _longest(steps)
    _require_enough(name, drives)
    dead_time = _delay(tracks, steps, expected_s + LAG_UNIT_S) - LAG_UNIT_S
    driven = _integrals(tracks, dead_time, LAG_UNIT_S)
    acts = np.concatenate([track.acts(dead_time) for track in tracks])
    drives &= acts & (np.hypot(driven[:, 0], driven[:, 1]) > 1e-9)
    _require_enough(name, drives)
    way = steps.moved.real
    turned = steps.turned
    far_off = _far_off(turned, driven, drives) | _far_off(way, driven, drives)
    rows = np.flatnonzero(drives & ~far_off)
    ends_of_tracks = np.cumsum([len(track.steps.turned) for track in tracks])[:-1]
    begin_s = np.concatenate([track.pose_s[:-1] for track in tracks])
    longest_s = max(track.duration_s for track in tracks)
    has_two_clocks = any(track.two_clocks for track in tracks)
    return _Steps(
        tracks=tracks,
        rows=rows,
        turned=turned[rows],
        moved=steps.moved[rows],
        begin_s=begin_s[rows],
        duration_s=steps.duration_s[rows],
        block=block_numbers(steps.duration_s)[rows],
        neighbours=(np.diff(rows) == 1) & ~np.isin(rows[1:], ends_of_tracks),
        left_out=int((drives & far_off).sum()),
        dead_time=dead_time,
        # the ends of the longest recording are off by the usual change of the dead time
        drift_unit=2 * DEAD_TIME_UNIT_S / longest_s if has_two_clocks else 0.0,
        in_one_ratio=_are_in_one_ratio(driven[rows]),
    )


def _are_in_one_ratio(driven: Floats) -> bool:
    """Decide whether two integrals (M, 2) are one, up to a factor."""
    lengths = np.linalg.norm(driven, axis=0)
    product = float(driven[:, 0] @ driven[:, 1])
    return bool(lengths.all()) and product**2 > ONE_RATIO * float(np.prod(lengths)) ** 2


def _longest(steps: PoseSteps) -> float:
    """Return the duration from which a step is left out [s]."""
    if not len(steps.duration_s):
        return LONGEST_S
    return max(LONGEST_S, LONGEST * float(np.median(steps.duration_s)))


def _require_enough(name: str, drives: Bools) -> None:
    """Raise UsageError if a robot drives in too few steps (S,)."""
    if drives.sum() < INTERVALS_MIN:
        raise UsageError(
            f"robot {printable(name)} drives in only {drives.sum()} steps between its poses",
            f"{INTERVALS_MIN} are needed: give longer recordings, or leave it out of the tables",
        )


def _delay(tracks: Sequence[_DrivenTrack], steps: PoseSteps, expected_s: float) -> float:
    """Return the delay [s] after which speeds and turns that were sent explain most of the motion;
    of several that explain AS_GOOD as much, that nearest to the expected one.
    """
    delays = expected_s + CLOCKS_S
    is_seen = steps.duration_s < _longest(steps)
    motion = _usual_rates(steps.at(is_seen))
    shares = np.zeros(len(delays))
    for i, delay in enumerate(delays.tolist()):
        sent = np.concatenate([track.sent(delay) for track in tracks]) / steps.duration_s[:, None]
        shares[i] = _share(motion, sent[is_seen])
    is_peak = (shares == maximum_filter1d(shares, 2 * PEAK + 1)) & (
        shares >= shares.max() - AS_GOOD
    )
    peaks = delays[is_peak]
    return float(peaks[np.abs(peaks - expected_s).argmin()])


def _usual_rates(steps: PoseSteps) -> Floats:
    """Return the turning rates and the speeds ahead and aside in some steps (3, S), clipped to
    those that are usual: a tracker may take a body for another."""
    motion = np.stack([steps.turned, steps.moved.real, steps.moved.imag]) / steps.duration_s
    low, high = np.quantile(motion, (CLIPPED, 1 - CLIPPED), axis=1, keepdims=True)
    return np.clip(motion, low, high)


def _share(motion: Floats, sent: Floats) -> float:
    """Return the share of a motion (3, S) that speeds and turning rates sent (S, 2) explain."""
    turn_rate, ahead, aside = motion
    speed, rate = sent.T
    of_turns = _correlation(rate, turn_rate)
    of_ways = math.hypot(_correlation(speed, ahead), _correlation(speed, aside))
    unexplained = (1 - of_turns**2) * (1 - min(of_ways, 1.0) ** 2)
    return (1 - unexplained) * (1.0 if of_turns > 0 else REVERSED)


def _correlation(first: Floats, second: Floats) -> float:
    """Return the correlation of two series (S,), 0 if one of them never changes."""
    a = first - first.mean()
    b = second - second.mean()
    lengths = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / (lengths + 1e-300)


def _far_off(measured: Floats, driven: Floats, drives: Bools) -> Bools:
    """Return which steps (S,) are FAR from the regression of those that drive, and further than
    commands can make them that act up to NEIGHBOURS steps earlier or later: in a track without
    noise, others are off only by these."""
    expected = driven @ robust_gains(measured[drives], driven[drives])
    residuals = np.abs(measured - expected)
    usual = STD_OF_MEDIAN * np.median(residuals[drives])
    near = 2 * NEIGHBOURS + 1
    changes = maximum_filter1d(expected, near) - minimum_filter1d(expected, near)
    return residuals > FAR * usual + changes + 1e-9


# ---- The fit ----


@dataclass(frozen=True, slots=True)
class ResponseParameters:
    """What is searched: dead time and lags [s], random walks per sqrt(s) and noises of the heading
    [rad] and of the way and positions [length unit].

    A search has them as a vector (8,) in the order of the fields: the dead time less the expected
    one, in DEAD_TIME_UNIT_S; the drift of the clocks, in its unit; of all others the logarithms
    over their units.
    """

    dead_time: float
    turning_lag: float
    speed_lag: float
    heading_walk: float
    way_walk: float
    heading_noise: float
    position_noise: float
    clock_drift: float

    def at(self, vector: Floats) -> "ResponseParameters":
        """Return the parameters of a vector (8,). `self` has the units; the dead time of a vector
        of zeros is that of `self`, and there is no drift then."""
        factor = np.exp(np.clip(vector, -LN_MOST, LN_MOST))
        return ResponseParameters(
            dead_time=self.dead_time + DEAD_TIME_UNIT_S * vector[0],
            turning_lag=_lag(self.turning_lag * factor[1]),
            speed_lag=_lag(self.speed_lag * factor[2]),
            heading_walk=self.heading_walk * factor[3],
            way_walk=self.way_walk * factor[4],
            heading_noise=self.heading_noise * factor[5],
            position_noise=self.position_noise * factor[6],
            clock_drift=self.clock_drift * vector[7],
        )


def _lag(lag_s: float) -> float:
    """Return a lag [s] within the bounds of those that are tried."""
    return min(max(lag_s, LAG_LEAST_S), LAG_MOST_S)


@dataclass(frozen=True, slots=True)
class _Whitened:
    """Turns or distances with their integrals, divided by the Cholesky root of their covariance.

    Attributes:
        y: Whitened turns or distances, shape (M,): y - x gains is white.
        x: Whitened integrals, shape (M, 2), of p and of q.
        ln_root: Logarithms of the diagonal of the root, shape (M,).
        own: Column of the integral that the motion follows: 0 for distances, 1 for turns.
        own_only: Whether the other integral adds nothing.
    """

    y: Floats
    x: Floats
    ln_root: Floats
    own: int
    own_only: bool

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """The mean (2,) of the prior of the gains, and the inverse of its variance (2,)."""
        lengths = np.linalg.norm(self.x, axis=0)
        scale = max(float(lengths[self.own]), float(np.linalg.norm(self.y)), 1e-12)
        std = OTHER_PRIOR_STD * (NOTHING if self.own_only else 1.0)
        weights = np.square(np.maximum(lengths, 1e-12) / (std * scale))
        weights[self.own] = np.square(
            max(float(lengths[self.own]), 1e-12) / (GAIN_PRIOR_STD * scale)
        )
        mean = np.zeros(2)
        mean[self.own] = 1.0
        return mean, weights

    @property
    def information(self) -> Floats:
        """The information (2, 2) on the gains."""
        return np.asarray(self.x.T @ self.x + np.diag(self.prior[1]), dtype=np.float64)

    def gains(self) -> Floats:
        """Return the likeliest gains (2,), of the integrals of p and of q."""
        mean, weights = self.prior
        gains = np.linalg.solve(self.information, self.x.T @ self.y + weights * mean)
        return np.asarray(gains, dtype=np.float64)

    def likelihoods(self, gains: Floats) -> Floats:
        """Return ln of the likelihood of each step (M,) with some gains (2,)."""
        return -self.ln_root - np.square(self.y - self.x @ gains) / 2

    def restricted_likelihood(self) -> float:
        """Return ln of the likelihood whatever the gains are."""
        _, ln_information = np.linalg.slogdet(self.information)
        likelihoods = self.likelihoods(self.gains())
        return float(likelihoods.sum() - ln_information / 2)


def _whiten(
    measured: Floats,
    own: int,
    p: "ResponseParameters",
    steps: _Steps,
    walk: float,
    noise: float,
    error: float,
) -> _Whitened:
    """Whiten turns or distances (M,), with their integrals: the variance of a step is walk^2 times
    its duration, error^2 and twice noise^2, the covariance of neighbours -noise^2."""
    covariance = np.zeros((2, len(measured)))  # its diagonal, and the one below
    covariance[0] = walk**2 * steps.duration_s + error**2 + 2 * noise**2
    covariance[1, :-1] = np.where(steps.neighbours, -(noise**2), 0.0)
    root = cholesky_banded(covariance, lower=True)
    whitened = solve_banded((1, 0), root, np.column_stack([measured, steps.integrals(p)]))
    return _Whitened(whitened[:, 0], whitened[:, 1:], np.log(root[0]), own, steps.in_one_ratio)


def _turns(steps: _Steps, p: ResponseParameters) -> _Whitened:
    return _whiten(steps.turned, 1, p, steps, p.heading_walk, p.heading_noise, TURN_ERROR_RAD)


def _ways(steps: _Steps, p: ResponseParameters) -> _Whitened:
    error = WAY_ERROR * float(np.median(np.abs(steps.way))) + 1e-12
    return _whiten(steps.way, 0, p, steps, p.way_walk, p.position_noise, error)


def _search(steps: _Steps, units: ResponseParameters) -> tuple[Floats, Floats]:
    """Find the likeliest vector of parameters (8,), from the best of a grid of starts.

    Returns:
        The vector, and about its standard deviations (8,).
    """

    def posteriors(vectors: Floats) -> Floats:
        """Return ln of the posterior (V,) of vectors (V, 8), with a normal prior around 0."""
        scores = np.zeros(len(vectors))
        for i, vector in enumerate(vectors):
            parameters = units.at(vector)
            turns = _turns(steps, parameters).restricted_likelihood()
            ways = _ways(steps, parameters).restricted_likelihood()
            scores[i] = turns + ways - np.square(vector).sum() / (2 * PRIOR_STD**2)
        return np.where(np.isfinite(scores), scores, UNLIKELY)

    lags = np.log(GRID_TURNING_LAGS_S / LAG_UNIT_S)
    grid = list(product(GRID_DEAD_TIMES_S / DEAD_TIME_UNIT_S, lags))
    starts = np.zeros((len(grid), SEARCHED))
    starts[:, :2] = grid
    best = starts[posteriors(starts).argmax()]
    found = minimize(
        lambda vector: -posteriors(vector[None])[0], best, method="BFGS", options={"gtol": GRADIENT}
    )
    return found.x, np.sqrt(np.diag(found.hess_inv))


def _response(name: str, steps: _Steps) -> RobotResponse:
    """Fit one robot and return its values with their intervals."""
    driven = _integrals(steps.tracks, steps.dead_time, LAG_UNIT_S)[steps.rows]
    heading_noise = _noise(steps, steps.turned, driven)
    position_noise = _noise(steps, steps.way, driven)
    units = ResponseParameters(  # of a vector of zeros
        dead_time=steps.dead_time,
        turning_lag=LAG_UNIT_S,
        speed_lag=LAG_UNIT_S,
        heading_walk=HEADING_WALK_UNIT,
        way_walk=WAY_WALK_UNIT * steps.speed,
        heading_noise=max(HEADING_NOISE_UNIT, heading_noise),
        position_noise=max(POSITION_NOISE_UNIT_S * steps.speed, position_noise),
        clock_drift=steps.drift_unit,
    )
    vector, curvature_std = _search(steps, units)
    likeliest = units.at(vector)
    turn_gains = _turns(steps, likeliest).gains()
    way_gains = _ways(steps, likeliest).gains()
    likeliest_all = np.concatenate([vector, turn_gains, way_gains])
    std = _deviations(steps, units, likeliest_all, curvature_std)
    of_search = ResponseParameters(*std[:SEARCHED].tolist())  # in the units of the search
    veer_std, turning_std, speed_std = std[SEARCHED : SEARCHED + 3].tolist()
    if steps.in_one_ratio:
        veer_std = math.inf
        turning_std = math.hypot(turning_std, ONE_RATIO_STD * turn_gains[1])
        speed_std = math.hypot(speed_std, ONE_RATIO_STD * way_gains[0])

    # how much of the motion the commands explain
    driven = steps.integrals(likeliest)
    sent = steps.integrals(replace(likeliest, turning_lag=LAG_LEAST_S, speed_lag=LAG_LEAST_S))
    windows = windows_of(steps.begin_s, steps.begin_s + steps.duration_s)
    turning_explained = explained(
        steps.turned, driven @ turn_gains, sent[:, 1], likeliest.heading_noise, windows
    )
    distance_explained = explained(
        steps.moved, driven @ way_gains, sent[:, 0], likeliest.position_noise, windows
    )
    clock_drift = None
    if steps.drift_unit:
        clock_drift = _normal(likeliest.clock_drift, steps.drift_unit * of_search.clock_drift)
    return RobotResponse(
        name=name,
        dead_time=_dead_time(likeliest.dead_time, DEAD_TIME_UNIT_S * of_search.dead_time),
        turning_lag=_lag_interval(likeliest.turning_lag, of_search.turning_lag),
        speed_lag=_lag_interval(likeliest.speed_lag, of_search.speed_lag),
        turning_gain=_normal(turn_gains[1], math.hypot(turning_std, RESOLVED_GAIN)),
        speed_gain=_normal(way_gains[0], math.hypot(speed_std, RESOLVED_GAIN)),
        veer=_normal(turn_gains[0], veer_std),
        heading_offset=_heading_offset(steps, driven[:, 0]),
        heading_walk=_log_normal(likeliest.heading_walk, of_search.heading_walk),
        heading_noise=_log_normal(likeliest.heading_noise, of_search.heading_noise),
        way_walk=_log_normal(likeliest.way_walk, of_search.way_walk),
        position_noise=_log_normal(likeliest.position_noise, of_search.position_noise),
        clock_drift=clock_drift,
        turning_explained=turning_explained,
        distance_explained=distance_explained,
        duration_s=max(track.duration_s for track in steps.tracks),
        intervals=len(steps.rows),
        left_out=steps.left_out,
    )


def _noise(steps: _Steps, measured: Floats, driven: Floats) -> float:
    """Estimate the noise of poses by what two neighbouring steps share, of turns or distances (M,)
    and the integrals (M, 2) that drive them."""
    residuals = measured - driven @ robust_gains(measured, driven)
    limit = CLIP * STD_OF_MEDIAN * float(np.median(np.abs(residuals)))
    clipped = np.clip(residuals, -limit, limit)
    products = (clipped[1:] * clipped[:-1])[steps.neighbours]
    return math.sqrt(max(-float(products.mean()), 0.0)) if products.size else 0.0


def _heading_offset(steps: _Steps, driven: Floats) -> SampleInterval:
    """Find the mean angle from the heading to the motion [rad], in the sense of the distances (M,)
    that were sent.

    The interval comes from the differences of blocks. It also contains the angle that remains if a
    tracked point ahead of the axle, which moves aside in turns, explains as much as it can.
    """
    by_block = _sums(steps.block, np.sign(driven) * steps.moved)
    total = by_block.sum()
    if not abs(total):
        return SampleInterval(0.0, -math.pi, math.pi)
    angle = float(np.angle(total))
    across = (by_block * np.exp(-1j * angle)).imag
    mean = _normal(angle, min(float(np.linalg.norm(across) / abs(total)), math.pi))
    slope, _ = robust_gains(steps.moved.imag, np.column_stack([steps.way, steps.turned]))
    beside = float(np.arctan(slope))
    return SampleInterval(angle, min(mean.low, beside), max(mean.high, beside))


def _sums(block: Integers, steps: Complex) -> Complex:
    """Add the steps (M,) of each block."""
    return np.bincount(block, steps.real) + 1j * np.bincount(block, steps.imag)


def _deviations(
    steps: _Steps, units: ResponseParameters, likeliest: Floats, curvature_std: Floats
) -> Floats:
    """Return the standard deviations (12,) of the likeliest vector, with the gains of turns and of
    ways behind it: the greater of the curvature's and of the jackknife's of blocks.

    With s_b and H_b the slope and curvature of ln of the likelihood of each of B blocks, and H that
    of all, the vector without a block is nearly the likeliest less (H - H_b)^-1 s_b.
    """
    at_best = units.at(likeliest[:SEARCHED])
    unit = np.ones(len(likeliest))
    unit[:SEARCHED] = np.clip(UNIT_STDS * curvature_std, UNIT_LEAST, 1.0)
    regressions = (_turns(steps, at_best), _ways(steps, at_best))
    of_gains = [np.diag(np.linalg.inv(whitened.information)) for whitened in regressions]
    unit[SEARCHED:] = np.sqrt(np.concatenate(of_gains))

    def of_blocks(changes: Floats) -> Floats:
        """Return ln of the likelihood of each block (B, V) after changes (1, V, 12) in units."""
        of_changes = []
        for values in likeliest + unit * changes[0]:
            parameters = units.at(values[:SEARCHED])
            turns = _turns(steps, parameters).likelihoods(values[SEARCHED : SEARCHED + 2])
            ways = _ways(steps, parameters).likelihoods(values[SEARCHED + 2 :])
            of_changes.append(np.bincount(steps.block, turns + ways))
        return np.column_stack(of_changes)

    size = len(likeliest)
    slopes, curvatures = derivatives(of_blocks, size)
    curvature = curvatures.sum(axis=0)
    of_prior = np.concatenate([whitened.prior[1] for whitened in regressions])
    curvature[range(SEARCHED, size), range(SEARCHED, size)] += of_prior * unit[SEARCHED:] ** 2
    inverse = _inverse(curvature)
    pulls = slopes @ inverse
    wider = wider_of_blocks(np.diagonal(curvatures, axis1=1, axis2=2))
    spread = len(pulls) * np.var(pulls, axis=0, ddof=1)
    variance = np.diag(inverse)
    return unit * np.sqrt(np.maximum(variance, wider**2 * spread))


def _inverse(curvature: Floats) -> Floats:
    """Return the inverse of a curvature (K, K), uphill where it is hollow, and with the prior."""
    value, axes = np.linalg.eigh(curvature)
    return (axes / np.maximum(np.abs(value), PRIOR_STD**-2)) @ axes.T


def _normal(value: float, std: float) -> SampleInterval:
    """Return a value with its interval."""
    reach = NORMAL * std
    return SampleInterval(value, value - reach, value + reach)


def _dead_time(value: float, std: float) -> SampleInterval:
    """Return the dead time with its interval, without ends if the data do not bound it."""
    if NORMAL * std > UNKNOWN_S:
        return SampleInterval(value, -math.inf, math.inf)
    return _normal(value, math.hypot(std, RESOLVED_S))


def _lag_interval(value: float, std: float) -> SampleInterval:
    """Return a lag with its interval, which begins at 0 for a lag that is at its minimum."""
    interval = _log_normal(value, math.hypot(std, RESOLVED_S / value))
    return replace(interval, low=0.0) if value <= 2 * LAG_LEAST_S else interval


def _log_normal(value: float, std: float) -> SampleInterval:
    """Return a value with the interval of its logarithm."""
    reach = NORMAL * std
    if reach > UNKNOWN:
        return SampleInterval(value, 0.0, math.inf)
    return SampleInterval(value, value * math.exp(-reach), value * math.exp(reach))


# ---- The table ----


DETERMINED = ("dead_time", "turning_lag", "speed_lag", *GAINS, "veer")
"""The values of which the table says whether the data determine them."""


def response_table(responses: Sequence[RobotResponse], title: str, unit: str) -> Table:
    """Return a table of robots' values with their 95 % intervals; a row per value."""
    units = {name: UNITS[name] for name in responses[0].quantities}
    labels = [*labels_of(units, unit), "turning explained", "distance explained", "left out"]
    columns = [Column("quantity", labels)]
    for robot in responses:
        values = [cell(value) for value in robot.quantities.values()]
        left_out = f"{robot.left_out} of {robot.left_out + robot.intervals}"
        of_motion = [str(robot.turning_explained), str(robot.distance_explained)]
        columns.append(Column(robot.name, [*values, *of_motion, left_out]))
    by_name = [(robot.name, robot.quantities) for robot in responses]
    drift = DRIFT_S / max(robot.duration_s for robot in responses)
    usual = USUAL | {"clock_drift": (-drift, drift)}
    notes = [
        _lag_for_spec(responses),
        undetermined_values(by_name, DETERMINED),
        unusual_values(by_name, usual),
    ]
    return Table(title, tuple(columns), "\n".join(text for text in notes if text))


def _lag_for_spec(responses: Sequence[RobotResponse]) -> str:
    """Describe the lag of a spec that fits all robots: the mean of the lags of turning, by which a
    host steers, weighted by their precision. "" if it is not known well enough to be of use."""
    lags = np.array([robot.turning_lag.value for robot in responses])
    widths = np.array([robot.turning_lag.high - robot.turning_lag.low for robot in responses])
    weights = 1 / np.clip(widths, LAG_LEAST_S, LAG_MOST_S)
    mean = float(np.average(lags, weights=weights))
    if not (widths / 2 <= SAME_LAG_S).all():
        return ""
    if not (abs(lags - mean) <= SAME_LAG_S).all():
        return f"no single lag fits all robots within {SAME_LAG_S:g} s"
    return f"the lag of turning for a spec: lab.lag={mean:.3f} (simulated: wheels.lag)"
