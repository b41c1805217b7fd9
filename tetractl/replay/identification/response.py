"""Fits how robots on two wheels follow commands of speed v and turning rate w: gains, lags, dead
time and noise; says of which other unit a gain would be.

**Model.** A command acts `dead_time` after it is sent; the speed p(t) and turning rate q(t) that it
leads to follow it with first-order lags of their own. From one pose to the next a robot

    turns by   turning_gain * integral of q  +  veer * integral of p  +  a random walk's step
    drives     speed_gain * integral of p    +  a term in q          +  a random walk's step

along its heading. Poses are measured with white noise, which two neighbouring steps share with
opposite signs: the covariance of the steps is tridiagonal.

**Fit.** For given `ResponseParameters` (dead time, lags, noise) the steps are linear in the gains,
so that `_Whitened` has their restricted likelihood in closed form. `_delay` finds the delay after
which commands explain most of the motion, whatever the clocks' difference; from a grid about it
`_search` finds the likeliest parameters by Newton steps. Intervals are normal in dead time, gains
and logarithms of the others, and as wide as the differences of blocks of BLOCK_S ask: gains of real
robots wander over seconds, which no model of white noise and random walks knows.

**Checks.** Robots move along their headings (`motion_angle.check_angle`), and the commands
explain their turns and ways, with the right sign and in the right units; else the fit would be of
something else.

**Data.** Steps last at least STEP_S. Left out are steps without a command, since a robot that has
none stands, and steps FAR times further off than usual: a tracker that takes a body for another.

Shapes: a robot has S steps in all its tracks, of which M are used; C commands are in one track.
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

from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Integers
from tetractl.replay.identification.fit import (
    NORMAL,
    UNLIKELY,
    SampleInterval,
    block_numbers,
    derivatives,
    wider_of_blocks,
)
from tetractl.replay.identification.identify import INTERVALS_MIN, cell, clock_doubt, labels_of
from tetractl.replay.identification.motion_angle import PoseSteps, check_angle, robust_gains
from tetractl.replay.identification.one_recording import (
    EXPLAINED,
    SURELY_MORE,
    Reading,
    check_explained,
    refuse_drift,
)
from tetractl.replay.identification.standing import Stood, stands_of
from tetractl.replay.identification.tracks import Track, integrals_of_sent, rows_apart
from tetractl.tools.table.table import Column, Table

STEP_S = 0.1
"""Least duration of a step [s]."""
LONGEST_S = 0.55
"""Duration from which a step is left out: the robot was not seen [s]. Tables whose poses are 0.5 s
apart are read."""
FAR = 8.0
"""How far off a step is that is left out, in standard deviations."""
NEIGHBOURS = 5
"""How many steps earlier or later commands may act than they seem to at first."""
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
THIRD_LEAST = 80
"""Least number of steps of a third of a recording in which it is seen how late commands act."""
USUAL = 0.02
"""Share of rates to either side that are clipped."""
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
LAG_LEAST_S = 1e-3
LAG_MOST_S = 10.0
"""Shorter and longer lags are taken for these [s]."""
ROUNDS = 60
"""Newton steps at most."""
INTEGRALS_KEPT = 64
"""Number of integrals that are not computed again: most parameters do not change them."""
DAMPED = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Tried dampings of a step: curvatures added to those of the likelihood."""
SETTLED = 0.02
"""A step that ends the search, in standard deviations of the parameters."""
LEAST_CHANGE = 0.005
"""A step that ends the search whatever the deviations are: 0.25 ms of the dead time, 0.5 % of the
others. Without noise, these deviations are 0."""
GAIN_OF_BASE = (1.8, 2.2)
"""Turning gains as of a distance between wheels that is taken for that to the centre."""
UNIT_WITHIN = 1.5
"""Factor about 1 within which gains are of robots that obey."""
GAIN_MOST = 4.0
"""Gain from which, and below its inverse, commands are not of the unit that they state."""
NOT_THEIR_WAY = (
    "are these turns of motors or wheels, not their way? give v and w, or left and right, as what "
    "the robot was to drive"
)
TURN_UNITS = {
    30 / math.pi: "is w in turns per minute? divide it by 9.549",
    0.5 / math.pi: "is w in turns per second? multiply it by 6.283",
    180 / math.pi: "is w in degrees per second? name its column w_deg_s",
    math.pi / 180: "is w in rad/s, as its column does not say? name it w_rad_s",
    1e3: "is w in mrad/s? divide it by 1000",
    1e-3: "is w per millisecond? multiply it by 1000",
    3600.0: "is w per hour? divide it by 3600",
    1 / 3600.0: "is w in turns of another unit of time? multiply it by 3600",
}
LENGTHS = "are lengths of v and of positions of one unit?"
SPEED_UNITS = {
    1e3: f"{LENGTHS} divide v by 1000",
    1e-3: f"{LENGTHS} multiply v by 1000",
    100: f"{LENGTHS} divide v by 100",
    0.01: f"{LENGTHS} multiply v by 100",
    10: f"{LENGTHS} divide v by 10",
    0.1: f"{LENGTHS} multiply v by 10",
    3600.0: "is v per hour? divide it by 3600",
    1 / 3600.0: "is v per second, as its column does not say? multiply it by 3600",
}
"""By what gains are to be multiplied if commands are of another unit, and what to do."""
SEARCHED = 7
"""Number of the parameters that are searched; behind them in a vector come the gains."""
PRIOR_STD = 5.0
"""Standard deviation of the prior of each parameter, in its units: hardly any prior."""
LEAST_VARIANCE = 1e-18
"""Added per second, so that the covariance of steps without noise can be inverted."""
UNKNOWN = 5.0
"""Half width of the interval of a logarithm from which the data do not bound the value."""


@dataclass(frozen=True, slots=True)
class RobotResponse:
    """How one robot follows its commands; see the fields of `FittedRobot` for the noise.

    `veer` [rad/length unit] is by how much it turns on its way though w is 0, `intervals` the
    number of steps used and `left_out` that of steps too far off. `stood` is when it stood though
    it was sent commands.
    """

    name: str
    dead_time: SampleInterval
    turning_lag: SampleInterval
    speed_lag: SampleInterval
    turning_gain: SampleInterval
    speed_gain: SampleInterval
    veer: SampleInterval
    heading_walk: SampleInterval
    heading_noise: SampleInterval
    way_walk: SampleInterval
    position_noise: SampleInterval
    intervals: int
    left_out: int
    stood: tuple[Stood, ...] = ()

    @property
    def quantities(self) -> dict[str, SampleInterval]:
        """The values by name, in the order of a table's rows."""
        return {name: getattr(self, name) for name in UNITS}


UNITS = {
    "dead_time": "s",
    "turning_lag": "s",
    "speed_lag": "s",
    "turning_gain": "",
    "speed_gain": "",
    "veer": "rad/{unit}",
    "heading_walk": "rad/sqrt(s)",
    "heading_noise": "rad",
    "way_walk": "{unit}/sqrt(s)",
    "position_noise": "{unit}",
}
"""The units of `quantities`; {unit} is the tracks' unit of length."""


def respond(tracks: Sequence[Track], dead_time: float = 0.1) -> list[RobotResponse]:
    """Return how each robot of the tracks follows its commands, for an expected dead time [s] if
    several explain its motion; UsageError if it drives too little, or otherwise than it was sent.
    """
    responses = []
    for robot, name in enumerate(tracks[0].names):
        driven = [_driven_track(track, robot) for track in tracks]
        steps = _usable_steps(tracks[0].source, name, driven, dead_time)
        response = _response(tracks[0].source, name, steps)
        stood = stands_of(tracks, robot, response.dead_time.value)
        responses.append(replace(response, stood=stood))
    return responses


# ---- Steps ----


@dataclass(frozen=True, slots=True)
class _DrivenTrack:
    """One robot in one track: the `steps` between its poses at `pose_s` (S + 1,) [s], and the
    `commands` (C, 2) of v and w that it was sent at `sent_s` (C,) [s]."""

    pose_s: Floats
    steps: PoseSteps
    sent_s: Floats
    commands: Floats

    def integrals(self, dead_time: float, lag: float) -> Floats:
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

        acting_s = self.pose_s - dead_time
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
        steps=PoseSteps.of(times_s[frames], track.poses[frames, robot]),
        sent_s=track.sent[commanded],
        commands=track.twists[commanded, robot],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """The M steps of a robot that the fit uses: `rows` (M,) of those of all `tracks`.

    `turned`, `way` and `duration_s` are (M,); `neighbours` (M - 1,) is where the next step begins
    with the pose at which a step ends. `left_out` is the number of steps too far off, `dead_time`
    [s] that from which the search starts.
    """

    tracks: list[_DrivenTrack]
    rows: Integers
    turned: Floats
    way: Floats
    duration_s: Floats
    block: Integers
    neighbours: Bools
    left_out: int
    dead_time: float

    @property
    def speed(self) -> float:
        """The median speed [length unit/s]."""
        return float(np.median(np.abs(self.way) / self.duration_s))

    def integrals(self, p: "ResponseParameters") -> Floats:
        """Return the integrals over each step (M, 2) of the speed and the turning rate, each with
        its lag."""
        of_speed = self._with_lag(p.dead_time, p.speed_lag)
        of_turning = self._with_lag(p.dead_time, p.turning_lag)
        return np.column_stack([of_speed[:, 0], of_turning[:, 1]])

    @lru_cache(INTEGRALS_KEPT)  # noqa: B019 few are kept
    def _with_lag(self, dead_time: float, lag: float) -> Floats:
        """Return the integrals over each step (M, 2), both with one lag."""
        return _integrals(self.tracks, dead_time, lag)[self.rows]


def _integrals(tracks: Sequence[_DrivenTrack], dead_time: float, lag: float) -> Floats:
    """Return the integrals over all steps of some tracks (S, 2)."""
    return np.concatenate([track.integrals(dead_time, lag) for track in tracks])


def _usable_steps(source: str, name: str, tracks: list[_DrivenTrack], expected_s: float) -> _Steps:
    """Return the steps of a robot to use, for an expected dead time [s]; UsageError if they are too
    few, too much alike, or not along its heading."""
    steps = PoseSteps.together([track.steps for track in tracks])
    drives = steps.duration_s < LONGEST_S
    _require_enough(name, drives)
    delay_s = _delay(tracks, steps, expected_s + LAG_UNIT_S)
    _check_clock_rate(source, max(tracks, key=lambda track: len(track.pose_s)), delay_s)
    dead_time = delay_s - LAG_UNIT_S
    driven = _integrals(tracks, dead_time, LAG_UNIT_S)
    acts = np.concatenate([track.acts(dead_time) for track in tracks])
    drives &= acts & (np.hypot(driven[:, 0], driven[:, 1]) > 1e-9)
    _require_enough(name, drives)
    if np.linalg.matrix_rank(driven[drives]) < 2:
        raise UsageError(f"robot {name} is sent one speed and turning rate only")
    check_angle(source, name, steps.at(drives), driven[drives, 0])
    way = steps.moved.real
    turned = steps.turned
    far_off = _far_off(turned, driven, drives) | _far_off(way, driven, drives)
    rows = np.flatnonzero(drives & ~far_off)
    ends_of_tracks = np.cumsum([len(track.steps.turned) for track in tracks])[:-1]
    return _Steps(
        tracks=tracks,
        rows=rows,
        turned=turned[rows],
        way=way[rows],
        duration_s=steps.duration_s[rows],
        block=block_numbers(steps.duration_s)[rows],
        neighbours=(np.diff(rows) == 1) & ~np.isin(rows[1:], ends_of_tracks),
        left_out=int((drives & far_off).sum()),
        dead_time=dead_time,
    )


def _require_enough(name: str, drives: Bools) -> None:
    """Raise UsageError if a robot drives in too few steps (S,)."""
    if drives.sum() < INTERVALS_MIN:
        raise UsageError(
            f"robot {name} drives in only {drives.sum()} steps of {STEP_S:g} to {LONGEST_S:g} s",
            "leave it out of the tables, or give longer ones in which it is seen and drives",
        )


def _delay(tracks: Sequence[_DrivenTrack], steps: PoseSteps, expected_s: float) -> float:
    """Return the delay [s] after which speeds and turns that were sent explain most of the motion;
    of several that explain AS_GOOD as much, that nearest to the expected one.
    """
    delays = expected_s + CLOCKS_S
    (explained,) = _explained_after(delays, tracks, steps, [steps.duration_s < LONGEST_S])
    is_peak = (explained == maximum_filter1d(explained, 2 * PEAK + 1)) & (
        explained >= explained.max() - AS_GOOD
    )
    peaks = delays[is_peak]
    return float(peaks[np.abs(peaks - expected_s).argmin()])


def _explained_after(
    delays: Floats, tracks: Sequence[_DrivenTrack], steps: PoseSteps, parts: Sequence[Bools]
) -> Floats:
    """Return the share of the motion in some parts of the steps (S,) that what was sent explains
    after each of some delays [s] (P, D)."""
    explained = np.zeros((len(parts), len(delays)))
    motions = [_usual_rates(steps.at(part)) for part in parts]
    for i, delay in enumerate(delays.tolist()):
        sent = np.concatenate([track.sent(delay) for track in tracks]) / steps.duration_s[:, None]
        for part, motion, of_part in zip(parts, motions, explained, strict=True):
            of_part[i] = _explained(motion, sent[part])
    return explained


def _check_clock_rate(source: str, track: _DrivenTrack, delay_s: float) -> None:
    """Raise UsageError if commands act later and later, whose delay is some [s] in all."""
    steps = track.steps
    is_seen = steps.duration_s < LONGEST_S
    third_s = float(np.ptp(track.pose_s)) / 3
    third = (track.pose_s[:-1] - track.pose_s[0]) // max(third_s, STEP_S)
    thirds = [is_seen & (third == number) for number in range(3)]
    if min(part.sum() for part in thirds) < THIRD_LEAST:
        return
    delays = delay_s + CLOCKS_S
    shares = _explained_after(delays, [track], steps, thirds)
    refuse_drift(source, shares, delays, 2 * third_s)


def _usual_rates(steps: PoseSteps) -> Floats:
    """Return the turning rates and the speeds ahead and aside in some steps (3, S), clipped to
    those that are usual: a tracker may take a body for another."""
    motion = np.stack([steps.turned, steps.moved.real, steps.moved.imag]) / steps.duration_s
    low, high = np.quantile(motion, (USUAL, 1 - USUAL), axis=1, keepdims=True)
    return np.clip(motion, low, high)


def _explained(motion: Floats, sent: Floats) -> float:
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

    A search has them as a vector (7,) in the order of the fields: the dead time less the expected
    one, in DEAD_TIME_UNIT_S; of all others the logarithms over their units.
    """

    dead_time: float
    turning_lag: float
    speed_lag: float
    heading_walk: float
    way_walk: float
    heading_noise: float
    position_noise: float

    def at(self, vector: Floats) -> "ResponseParameters":
        """Return the parameters of a vector (7,), if these are of a vector of zeros."""
        factor = np.exp(vector)
        return ResponseParameters(
            dead_time=self.dead_time + DEAD_TIME_UNIT_S * vector[0],
            turning_lag=_lag(self.turning_lag * factor[1]),
            speed_lag=_lag(self.speed_lag * factor[2]),
            heading_walk=self.heading_walk * factor[3],
            way_walk=self.way_walk * factor[4],
            heading_noise=self.heading_noise * factor[5],
            position_noise=self.position_noise * factor[6],
        )


def _lag(lag_s: float) -> float:
    """Return a lag [s] within the bounds of those that are tried."""
    return min(max(lag_s, LAG_LEAST_S), LAG_MOST_S)


@dataclass(frozen=True, slots=True)
class _Whitened:
    """Turns or ways `y` (M,) and integrals `x` (M, 2) divided by the Cholesky root L of the steps'
    covariance: y - x gains is white. `ln_root` (M,) are the logarithms of L's diagonal."""

    y: Floats
    x: Floats
    ln_root: Floats

    def gains(self) -> Floats:
        """Return the likeliest gains (2,), of the integrals of p and of q."""
        return np.asarray(np.linalg.solve(self.x.T @ self.x, self.x.T @ self.y), dtype=np.float64)

    def likelihoods(self, gains: Floats) -> Floats:
        """Return ln of the likelihood of each step (M,) with some gains (2,)."""
        return -self.ln_root - np.square(self.y - self.x @ gains) / 2

    def restricted_likelihood(self) -> float:
        """Return ln of the likelihood whatever the gains are."""
        _, ln_information = np.linalg.slogdet(self.x.T @ self.x)
        likelihoods = self.likelihoods(self.gains())
        return float(likelihoods.sum() - ln_information / 2)


def _whiten(
    measured: Floats, integrals: Floats, steps: _Steps, walk: float, noise: float
) -> _Whitened:
    """Return turns or ways (M,) and integrals (M, 2) whitened: a step's variance is walk^2 times
    its duration and twice noise^2, the covariance of neighbours -noise^2."""
    covariance = np.zeros((2, len(measured)))  # its diagonal, and the one below
    covariance[0] = (walk**2 + LEAST_VARIANCE) * steps.duration_s + 2 * noise**2
    covariance[1, :-1] = np.where(steps.neighbours, -(noise**2), 0.0)
    root = cholesky_banded(covariance, lower=True)
    whitened = solve_banded((1, 0), root, np.column_stack([measured, integrals]))
    return _Whitened(whitened[:, 0], whitened[:, 1:], np.log(root[0]))


def _turns(steps: _Steps, p: ResponseParameters) -> _Whitened:
    return _whiten(steps.turned, steps.integrals(p), steps, p.heading_walk, p.heading_noise)


def _ways(steps: _Steps, p: ResponseParameters) -> _Whitened:
    return _whiten(steps.way, steps.integrals(p), steps, p.way_walk, p.position_noise)


def _search(name: str, steps: _Steps, units: ResponseParameters) -> Floats:
    """Return the likeliest vector of parameters (7,), by Newton steps of which the best DAMPED one
    is taken; UsageError if it does not settle."""

    def posteriors(vectors: Floats) -> Floats:
        """Return ln of the posterior (V,) of vectors (V, 7), with a normal prior around 0."""
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
    for _ in range(ROUNDS):
        at_best = best
        slopes, curvatures = derivatives(
            lambda changes, at=at_best: posteriors(at + changes[0])[None], SEARCHED
        )
        value, axes = np.linalg.eigh(curvatures[0])
        value = np.maximum(np.abs(value), PRIOR_STD**-2)
        along = axes.T @ slopes[0]
        steps_tried = [np.clip(axes @ (along / (value + d)), -1.0, 1.0) for d in DAMPED]
        tried = np.array([best, *(best + step for step in steps_tried)])
        best = tried[posteriors(tried).argmax()]
        std = np.sqrt(axes**2 @ (1 / value))
        if (np.abs(best - at_best) < np.maximum(SETTLED * std, LEAST_CHANGE)).all():
            return best
    raise UsageError(
        f"robot {name}: the search for its dead time and lags does not settle",
        "give more or longer recordings, in which speed and turning rate change",
    )


def _response(source: str, name: str, steps: _Steps) -> RobotResponse:
    """Fit one robot and return its values with their intervals."""
    units = ResponseParameters(  # of a vector of zeros
        dead_time=steps.dead_time,
        turning_lag=LAG_UNIT_S,
        speed_lag=LAG_UNIT_S,
        heading_walk=HEADING_WALK_UNIT,
        way_walk=WAY_WALK_UNIT * steps.speed,
        heading_noise=HEADING_NOISE_UNIT,
        position_noise=POSITION_NOISE_UNIT_S * steps.speed,
    )
    vector = _search(name, steps, units)
    likeliest = units.at(vector)
    _check_commands(source, name, steps, likeliest)
    turn_gains = _turns(steps, likeliest).gains()
    way_gains = _ways(steps, likeliest).gains()
    std = _deviations(steps, units, np.concatenate([vector, turn_gains, way_gains]))
    of_search = ResponseParameters(*std[:SEARCHED].tolist())  # in the units of the search
    veer_std, turning_std, speed_std = std[SEARCHED : SEARCHED + 3].tolist()
    return RobotResponse(
        name=name,
        dead_time=_normal(likeliest.dead_time, DEAD_TIME_UNIT_S * of_search.dead_time),
        turning_lag=_log_normal(likeliest.turning_lag, of_search.turning_lag),
        speed_lag=_log_normal(likeliest.speed_lag, of_search.speed_lag),
        turning_gain=_normal(turn_gains[1], turning_std),
        speed_gain=_normal(way_gains[0], speed_std),
        veer=_normal(turn_gains[0], veer_std),
        heading_walk=_log_normal(likeliest.heading_walk, of_search.heading_walk),
        heading_noise=_log_normal(likeliest.heading_noise, of_search.heading_noise),
        way_walk=_log_normal(likeliest.way_walk, of_search.way_walk),
        position_noise=_log_normal(likeliest.position_noise, of_search.position_noise),
        intervals=len(steps.rows),
        left_out=steps.left_out,
    )


def _check_commands(source: str, name: str, steps: _Steps, likeliest: ResponseParameters) -> None:
    """Raise UsageError if the commands do not explain turns and ways as they are stated: v and w
    exchanged, turns reversed, in other units, or not at all."""
    turn_gains = _turns(steps, likeliest).gains()
    way_gains = _ways(steps, likeliest).gains()
    driven = steps.integrals(likeliest)
    sent = steps.integrals(replace(likeliest, turning_lag=LAG_LEAST_S, speed_lag=LAG_LEAST_S))
    turning = _Obeyed.of(steps.turned, driven @ turn_gains, turn_gains[1], sent[:, 1])
    driving = _Obeyed.of(steps.way, driven @ way_gains, way_gains[0], sent[:, 0])
    turns_v, turns_w = np.abs(turn_gains) * np.linalg.norm(driven, axis=0)
    drives_v, drives_w = np.abs(way_gains) * np.linalg.norm(driven, axis=0)
    exchanged = Reading(
        driving.explained if drives_w > drives_v else 0.0,
        f"{source}: {name} drives as w, not as v",
        "are v and w exchanged?",
    )
    if turns_v > turns_w and min(turning.explained, exchanged.share) >= EXPLAINED:
        raise UsageError(exchanged.said, exchanged.hint)
    mirrored = Reading(
        turning.share(-math.inf, 0.0),
        f"{source}: {name} turns right where it is sent left",
        "reverse w; or y and the headings, if the picture is mirrored",
    )
    one_way = Reading(
        _share_of_sizes(steps.turned, sent[:, 1]),
        f"{source}: {name} turns to both sides, and w is never below 0",
        "has w lost its sign? it is below 0 to the right",
    )
    turn_units = turning.readings(f"{source}: the turning gain of {name}", TURN_UNITS)
    turning.check(source, f"turns of {name}", [mirrored, one_way, *turn_units])
    ahead = Reading(
        _share_of_sizes(steps.way, sent[:, 0]),
        f"{source}: {name} drives backwards, too, and v is never below 0",
        "is v a speed without its sign? give it below 0 where the robot drives backwards",
    )
    speed_units = driving.readings(f"{source}: the speed gain of {name}", SPEED_UNITS)
    driving.check(source, f"way of {name}", [exchanged, ahead, *speed_units])


def _share_of_sizes(measured: Floats, sent: Floats) -> float:
    """Return the share of turns or ways (M,) that those sent (M,) explain but for their signs; 0 if
    some of these are below 0."""
    squares = float(np.square(sent).sum())
    total = float(np.square(measured).sum())
    if sent.min() < 0 or not squares or not total:
        return 0.0
    product = float(np.abs(measured) @ sent)
    return product**2 / (squares * total)


@dataclass(frozen=True, slots=True)
class _Obeyed:
    """What commands explain of turns or ways: the `gain`, the share `explained`, and that which
    they would explain with a gain of 1, `if_obeyed`."""

    gain: float
    explained: float
    if_obeyed: float

    @classmethod
    def of(cls, measured: Floats, fitted: Floats, gain: float, sent: Floats) -> "_Obeyed":
        """Return what commands explain of measured turns or ways (M,), by those that the fit makes
        of the commands (M,) and those that were sent (M,)."""
        rest = float(np.square(measured - fitted).sum())
        commanded = float(np.square(sent).sum())
        total = float(np.square(measured).sum())
        return cls(
            gain=gain,
            explained=1 - rest / total if total else 0.0,
            if_obeyed=commanded / (commanded + rest) if commanded else 0.0,
        )

    def share(self, low: float, high: float) -> float:
        """Return the share that commands explain with a gain between two."""
        return self.explained if low < self.gain < high else 0.0

    def readings(self, what: str, units: dict[float, str]) -> list[Reading]:
        """Return what commands explain in other units, `what` being the gain's name."""
        said = f"{what} is {self.gain:.3g}, as of a wrong unit"
        readings = [
            Reading(
                self.share(1 / (UNIT_WITHIN * factor), UNIT_WITHIN / factor),
                f"{said}; {self.gain * factor:.3g} otherwise",
                hint,
            )
            for factor, hint in units.items()
        ]
        of_no_unit = max(self.share(0.0, 1 / GAIN_MOST), self.share(GAIN_MOST, math.inf))
        return [*readings, Reading(of_no_unit, said, NOT_THEIR_WAY)]

    def check(self, source: str, what: str, readings: Sequence[Reading]) -> None:
        """Raise UsageError if commands do not explain `what` moves, though they are large enough,
        or only by another reading."""
        least = min(EXPLAINED, self.if_obeyed - SURELY_MORE)
        check_explained(source, what, self.share(1 / GAIN_MOST, GAIN_MOST), least, readings)


def _deviations(steps: _Steps, units: ResponseParameters, likeliest: Floats) -> Floats:
    """Return the standard deviations (11,) of the likeliest vector, with the gains of turns and of
    ways behind it: the greater of the curvature's and of the jackknife's of blocks.

    With s_b and H_b the slope and curvature of ln of the likelihood of each of B blocks, and H that
    of all, the vector without a block is nearly the likeliest less (H - H_b)^-1 s_b.
    """
    at_best = units.at(likeliest[:SEARCHED])
    unit = np.ones(len(likeliest))
    regressions = (_turns(steps, at_best), _ways(steps, at_best))
    of_gains = [np.diag(np.linalg.inv(whitened.x.T @ whitened.x)) for whitened in regressions]
    unit[SEARCHED:] = np.sqrt(np.concatenate(of_gains))

    def of_blocks(changes: Floats) -> Floats:
        """Return ln of the likelihood of each block (B, V) after changes (1, V, 11) in units."""
        of_changes = []
        for values in likeliest + unit * changes[0]:
            parameters = units.at(values[:SEARCHED])
            turns = _turns(steps, parameters).likelihoods(values[SEARCHED : SEARCHED + 2])
            ways = _ways(steps, parameters).likelihoods(values[SEARCHED + 2 :])
            of_changes.append(np.bincount(steps.block, turns + ways))
        return np.column_stack(of_changes)

    slopes, curvatures = derivatives(of_blocks, len(likeliest))
    curvature = curvatures.sum(axis=0)
    without = [
        _inverse(curvature - of_block) @ slope
        for slope, of_block in zip(slopes, curvatures, strict=True)
    ]
    wider = wider_of_blocks(np.diagonal(curvatures, axis1=1, axis2=2))
    spread = (len(without) - 1) * np.var(without, axis=0)
    variance = np.diag(_inverse(curvature))
    return unit * np.sqrt(np.maximum(variance, wider**2 * spread))


def _inverse(curvature: Floats) -> Floats:
    """Return the inverse of a curvature (K, K), uphill where it is hollow, and with the prior."""
    value, axes = np.linalg.eigh(curvature)
    return (axes / np.maximum(np.abs(value), PRIOR_STD**-2)) @ axes.T


def _normal(value: float, std: float) -> SampleInterval:
    """Return a value with its interval."""
    reach = NORMAL * std
    return SampleInterval(value, value - reach, value + reach)


def _log_normal(value: float, std: float) -> SampleInterval:
    """Return a value with the interval of its logarithm."""
    reach = NORMAL * std
    if reach > UNKNOWN:
        return SampleInterval(value, 0.0, math.inf)
    return SampleInterval(value, value * math.exp(-reach), value * math.exp(reach))


# ---- The table ----


def response_table(responses: Sequence[RobotResponse], title: str, unit: str) -> Table:
    """Return a table of robots' values with their 95 % intervals; a row per value."""
    columns = [Column("quantity", [*labels_of(UNITS, unit), "left out"])]
    for robot in responses:
        values = [cell(value) for value in robot.quantities.values()]
        left_out = f"{robot.left_out} of {robot.left_out + robot.intervals}"
        columns.append(Column(robot.name, [*values, left_out]))
    doubts = [clock_doubt(robot.dead_time) for robot in responses]
    notes = [_lag_for_spec(responses), max(doubts, key=len)]
    low, high = GAIN_OF_BASE
    if any(low < robot.turning_gain.value < high for robot in responses):
        notes.append(
            "a turning gain near 2: is radius, or that of w, the distance between the wheels?"
        )
    gains = np.array([(robot.turning_gain.value, robot.speed_gain.value) for robot in responses])
    is_of_unit = (gains > 1 / UNIT_WITHIN) & (gains < UNIT_WITHIN)
    if not is_of_unit.any(axis=1).all():  # a robot that obeys turns or drives as it is sent
        notes.append(
            "gains far from 1: are commands speeds in their unit, not counts or shares of power?"
        )
    for robot in responses:
        notes += map(str, robot.stood)
    return Table(title, tuple(columns), "\n".join(text for text in notes if text))


def _lag_for_spec(responses: Sequence[RobotResponse]) -> str:
    """Return in words the lag of a spec that fits all robots: the mean of the lags of turning, by
    which a host steers, weighted by their precision."""
    lags = np.array([robot.turning_lag.value for robot in responses])
    widths = [robot.turning_lag.high - robot.turning_lag.low for robot in responses]
    mean = float(np.average(lags, weights=1 / np.clip(widths, LAG_LEAST_S, LAG_MOST_S)))
    if not (abs(lags - mean) <= SAME_LAG_S).all():
        return f"no single lag fits all robots within {SAME_LAG_S:g} s"
    return f"the lag of turning for a spec: lab.lag={mean:.3f} (simulated: wheels.lag)"
