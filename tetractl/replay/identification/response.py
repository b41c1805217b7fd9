"""Fits how robots on two wheels follow commands of speed v and turning rate w: gains, lags, dead
time and noise.

**Model.** A command acts `dead_time` after it is sent; the speed p(t) and turning rate q(t) that it
leads to follow it with first-order lags of their own. From one pose to the next a robot

    turns by   turning_gain * integral of q  +  veer * integral of p  +  a random walk's step
    drives     speed_gain * integral of p    +  a term in q          +  a random walk's step

along its heading. Poses are measured with white noise, which two neighbouring steps share with
opposite signs: the covariance of the steps is tridiagonal.

**Fit.** For given `ResponseParameters` (dead time, lags, noise) the steps are linear in the gains,
so that `regress` has their restricted likelihood in closed form. `_search` finds the likeliest
parameters from a grid by Newton steps. Intervals are normal in dead time, gains and logarithms of
the others; if residuals are correlated by the test of `fit`, they are wider and the table says so.

**Data.** Steps last at least STEP_S. Left out are steps without a command, since a robot that has
none stands, and steps FAR times further off than usual: a tracker that takes a body for another.

Shapes: a robot has S steps in all its tracks, of which M are used; C commands are in one track.
Pairs of a motion's two integrals stand in columns: of p, then of q.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded

from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats
from tetractl.core.table.table import Column, Table
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step, white
from tetractl.replay.identification.identify import INTERVALS_MIN, cell
from tetractl.replay.identification.tracks import Track

STEP_S = 0.1
"""Least duration of a step [s]."""
LONGEST_S = 0.5
"""Duration from which a step is left out: the robot was not seen [s]."""
FAR = 8.0
"""How far off a step is that is left out, in standard deviations."""
STD_OF_MEDIAN = 1.48
"""Standard deviation of normal numbers over the median of their magnitudes."""
SAME_LAG_S = 0.02
"""How well a lag has to be known to be of use in a spec [s]."""
GRID_DEAD_TIMES_S = np.arange(-0.1, 0.5, 0.05)
"""Dead times from which the search may start, less the expected one [s]."""
GRID_TURNING_LAGS_S = (0.03, 0.1, 0.3)
"""Lags of turning from which it may start [s]; that of speed starts at its unit."""
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
"""Shorter lags are taken for this one [s]."""
ROUNDS = 8
"""Newton steps at most; the parameters after the last are used."""
SETTLED = 0.02
"""A step that ends the search, in standard deviations of the parameters."""
PRIOR_STD = 5.0
"""Standard deviation of the prior of each parameter, in its units: hardly any prior."""
LEAST_VARIANCE = 1e-18
"""Added per second, so that the covariance of steps without noise can be inverted."""
EXPONENT_MOST = 50.0
"""Most that an interval's end is from its value, in the logarithm."""

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class RobotResponse:
    """How one robot follows its commands; see the fields of `FittedRobot` for the noise.

    `veer` [rad/length unit] is by how much it turns on its way though w is 0, `intervals` the
    number of steps used and `left_out` that of steps too far off. `misfits` names the motions whose
    residuals are correlated.
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
    misfits: tuple[str, ...]

    @property
    def quantities(self) -> dict[str, SampleInterval]:
        """The values by name, in the order of a table's rows."""
        return {
            "dead_time": self.dead_time,
            "turning_lag": self.turning_lag,
            "speed_lag": self.speed_lag,
            "turning_gain": self.turning_gain,
            "speed_gain": self.speed_gain,
            "veer": self.veer,
            "heading_walk": self.heading_walk,
            "heading_noise": self.heading_noise,
            "way_walk": self.way_walk,
            "position_noise": self.position_noise,
        }


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
    """Return how each robot of the tracks follows its commands, for an expected dead time [s];
    UsageError if it drives too little."""
    responses = []
    for robot, name in enumerate(tracks[0].names):
        driven = [_driven_track(track, robot) for track in tracks]
        steps = _usable_steps(name, driven, dead_time)
        responses.append(_response(name, steps, dead_time))
    return responses


# ---- Steps ----


@dataclass(frozen=True, slots=True)
class _DrivenTrack:
    """One robot in one track: poses measured at `pose_s` (S + 1,) [s], of each step between them
    how far it `turned` [rad] and drove (`way` [length unit]) (S,), and the `commands` (C, 2) of v
    and w sent at `sent_s` (C,) [s].
    """

    pose_s: Floats
    turned: Floats
    way: Floats
    sent_s: Floats
    commands: Floats

    def integrals(self, dead_time: float, lag: float) -> Floats:
        """Return the integrals over each step (S, 2) of the rates r that follow the commands u.

        From lag dr/dt = u - r the integral of r is that of u less lag times the rise of r, hence
        the difference of U(t) - lag r(t) between a step's ends, with U the integral of u. Between
        two commands r tends to u as exp(-t / lag); robots have the first command's rates before it.
        """
        if len(self.pose_s) < 2:
            return np.zeros((0, 2))
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


def _driven_track(track: Track, robot: int) -> _DrivenTrack:
    """Return the steps of a robot in a track, from its first command to the end of the last."""
    commanded = np.isfinite(track.twists[:, robot]).all(axis=1)
    sent_s = track.sent[commanded]
    times_s = track.exposed[:, robot]
    frames: list[int] = []
    last_s = -np.inf
    for frame in np.flatnonzero(track.valid[:, robot]).tolist():
        time_s = times_s[frame]
        commands_act = len(sent_s) > 0 and sent_s[0] <= time_s <= sent_s[-1]
        if commands_act and time_s - last_s >= STEP_S - 1e-9:
            frames.append(frame)
            last_s = time_s
    x, y, heading = track.poses[frames, robot].T
    heading = np.unwrap(heading)
    middle = (heading[1:] + heading[:-1]) / 2
    along_x = np.diff(x) * np.cos(middle)
    along_y = np.diff(y) * np.sin(middle)
    return _DrivenTrack(
        pose_s=times_s[frames],
        turned=np.diff(heading),
        way=along_x + along_y,
        sent_s=sent_s,
        commands=track.twists[commanded, robot],
    )


@dataclass(frozen=True, slots=True)
class _Steps:
    """The M steps of a robot that the fit uses: `rows` (M,) of those of all `tracks`.

    `turned`, `way` and `duration_s` are (M,); `neighbours` (M - 1,) is where the next step begins
    with the pose at which a step ends. `left_out` is the number of steps too far off.
    """

    tracks: list[_DrivenTrack]
    rows: Indices
    turned: Floats
    way: Floats
    duration_s: Floats
    neighbours: Bools
    left_out: int

    @property
    def speed(self) -> float:
        """The median speed [length unit/s]."""
        return float(np.median(np.abs(self.way) / self.duration_s))

    def integrals(self, dead_time: float, lag: float) -> Floats:
        """Return the integrals over each step (M, 2)."""
        return _integrals(self.tracks, dead_time, lag)[self.rows]


def _integrals(tracks: Sequence[_DrivenTrack], dead_time: float, lag: float) -> Floats:
    """Return the integrals over all steps of some tracks (S, 2)."""
    return np.concatenate([track.integrals(dead_time, lag) for track in tracks])


def _usable_steps(name: str, tracks: list[_DrivenTrack], dead_time: float) -> _Steps:
    """Return the steps of a robot to use, by its commands at the expected dead time [s];
    UsageError if they are too few, or too much alike."""
    duration_s = np.concatenate([np.diff(track.pose_s) for track in tracks])
    turned = np.concatenate([track.turned for track in tracks])
    way = np.concatenate([track.way for track in tracks])
    driven = _integrals(tracks, dead_time, LAG_UNIT_S)
    drives = (duration_s < LONGEST_S) & (np.hypot(driven[:, 0], driven[:, 1]) > 1e-9)
    if drives.sum() < INTERVALS_MIN:
        raise UsageError(f"robot {name} drives in only {drives.sum()} steps of {STEP_S:g} s")
    if np.linalg.matrix_rank(driven[drives]) < 2:
        raise UsageError(f"robot {name} is sent one speed and turning rate only")
    far_off = _far_off(turned, driven, drives) | _far_off(way, driven, drives)
    rows = np.flatnonzero(drives & ~far_off)
    ends_of_tracks = np.cumsum([len(track.way) for track in tracks])[:-1]
    return _Steps(
        tracks=tracks,
        rows=rows,
        turned=turned[rows],
        way=way[rows],
        duration_s=duration_s[rows],
        neighbours=(np.diff(rows) == 1) & ~np.isin(rows[1:], ends_of_tracks),
        left_out=int((drives & far_off).sum()),
    )


def _far_off(measured: Floats, driven: Floats, drives: Bools) -> Bools:
    """Return which steps (S,) are FAR from the regression of those that drive."""
    gains = np.linalg.lstsq(driven[drives], measured[drives])[0]
    residuals = np.abs(measured - driven @ gains)
    return residuals > FAR * STD_OF_MEDIAN * np.median(residuals[drives]) + 1e-9


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

    @classmethod
    def of_units(cls, dead_time: float, speed: float) -> "ResponseParameters":
        """Return the parameters of a vector of zeros, for an expected dead time and a speed."""
        return cls(
            dead_time=dead_time,
            turning_lag=LAG_UNIT_S,
            speed_lag=LAG_UNIT_S,
            heading_walk=HEADING_WALK_UNIT,
            way_walk=WAY_WALK_UNIT * speed,
            heading_noise=HEADING_NOISE_UNIT,
            position_noise=POSITION_NOISE_UNIT_S * speed,
        )

    def at(self, vector: Floats) -> "ResponseParameters":
        """Return the parameters of a vector (7,), if these are of a vector of zeros."""
        factor = np.exp(vector)
        return ResponseParameters(
            dead_time=self.dead_time + DEAD_TIME_UNIT_S * vector[0],
            turning_lag=max(self.turning_lag * factor[1], LAG_LEAST_S),
            speed_lag=max(self.speed_lag * factor[2], LAG_LEAST_S),
            heading_walk=self.heading_walk * factor[3],
            way_walk=self.way_walk * factor[4],
            heading_noise=self.heading_noise * factor[5],
            position_noise=self.position_noise * factor[6],
        )


@dataclass(frozen=True, slots=True)
class StepRegression:
    """Turns or ways as sums of a robot's two integrals: the `gains` (2,) of that of p and that of
    q with their standard deviations `gains_std` (2,), the logarithm of the restricted likelihood,
    and the whitened residuals (M,).
    """

    likelihood: float
    gains: Floats
    gains_std: Floats
    residuals: Floats


def regress(
    measured: Floats, integrals: Floats, steps: _Steps, walk: float, noise: float
) -> StepRegression:
    """Return the regression of turns or ways (M,) on integrals (M, 2).

    A step's variance is walk^2 times its duration and twice noise^2, the covariance of neighbours
    -noise^2. With its Cholesky root L, L^-1 (measured - integrals gains) is white.
    """
    covariance = np.zeros((2, len(measured)))  # its diagonal, and the one below
    covariance[0] = (walk**2 + LEAST_VARIANCE) * steps.duration_s + 2 * noise**2
    covariance[1, :-1] = np.where(steps.neighbours, -(noise**2), 0.0)
    root = cholesky_banded(covariance, lower=True)
    whitened = solve_banded((1, 0), root, np.column_stack([measured, integrals]))
    y = whitened[:, 0]
    x = whitened[:, 1:]
    information = x.T @ x
    gains = np.asarray(np.linalg.solve(information, x.T @ y), dtype=np.float64)
    residuals = y - x @ gains
    _, ln_information = np.linalg.slogdet(information)
    likelihood = -np.log(root[0]).sum() - ln_information / 2 - residuals @ residuals / 2
    gains_std = np.sqrt(np.diag(np.linalg.inv(information)))
    return StepRegression(float(likelihood), gains, gains_std, residuals)


def _regress_turns(steps: _Steps, p: ResponseParameters) -> StepRegression:
    integrals = steps.integrals(p.dead_time, p.turning_lag)
    return regress(steps.turned, integrals, steps, p.heading_walk, p.heading_noise)


def _regress_ways(steps: _Steps, p: ResponseParameters) -> StepRegression:
    integrals = steps.integrals(p.dead_time, p.speed_lag)
    return regress(steps.way, integrals, steps, p.way_walk, p.position_noise)


def _search(steps: _Steps, units: ResponseParameters) -> tuple[Floats, Floats]:
    """Return the likeliest vector of parameters (7,), and its standard deviations (7,)."""

    def likelihoods(vectors: Floats) -> Floats:
        """Return ln of the likelihood (1, V) of each of V vectors (1, V, 7)."""
        values = []
        for vector in vectors[0]:
            parameters = units.at(vector)
            turns = _regress_turns(steps, parameters)
            ways = _regress_ways(steps, parameters)
            values.append(turns.likelihood + ways.likelihood)
        return np.array([values])

    grid = np.zeros((1, len(GRID_DEAD_TIMES_S) * len(GRID_TURNING_LAGS_S), 7))
    grid[0, :, 0] = np.repeat(GRID_DEAD_TIMES_S / DEAD_TIME_UNIT_S, len(GRID_TURNING_LAGS_S))
    lags = np.log(np.array(GRID_TURNING_LAGS_S) / LAG_UNIT_S)
    grid[0, :, 1] = np.tile(lags, len(GRID_DEAD_TIMES_S))
    best = grid[:, likelihoods(grid)[0].argmax()]
    std = np.zeros_like(best)
    for _ in range(ROUNDS):
        before = best
        best, std = newton_step(likelihoods, before, PRIOR_STD)
        if (np.abs(best - before) < SETTLED * std).all():
            break
    return best[0], std[0]


def _response(name: str, steps: _Steps, dead_time: float) -> RobotResponse:
    """Fit one robot, for an expected dead time [s], and return its values with their intervals."""
    units = ResponseParameters.of_units(dead_time, steps.speed)
    vector, std_vector = _search(steps, units)
    likeliest = units.at(vector)
    std = ResponseParameters(*std_vector.tolist())  # in the units of the search
    turns = _regress_turns(steps, likeliest)
    ways = _regress_ways(steps, likeliest)
    residuals = np.column_stack([turns.residuals, ways.residuals])
    misfits, wider = white(residuals[:, :, None], np.zeros((2, 1)))
    wider_turns, wider_ways = wider
    misfit_names = []
    if misfits[0]:
        misfit_names.append("turning")
    if misfits[1]:
        misfit_names.append("speed")
    return RobotResponse(
        name=name,
        dead_time=_normal(likeliest.dead_time, DEAD_TIME_UNIT_S * std.dead_time, wider_turns),
        turning_lag=_log_normal(likeliest.turning_lag, std.turning_lag, wider_turns),
        speed_lag=_log_normal(likeliest.speed_lag, std.speed_lag, wider_ways),
        turning_gain=_normal(turns.gains[1], turns.gains_std[1], wider_turns),
        speed_gain=_normal(ways.gains[0], ways.gains_std[0], wider_ways),
        veer=_normal(turns.gains[0], turns.gains_std[0], wider_turns),
        heading_walk=_log_normal(likeliest.heading_walk, std.heading_walk, wider_turns),
        heading_noise=_log_normal(likeliest.heading_noise, std.heading_noise, wider_turns),
        way_walk=_log_normal(likeliest.way_walk, std.way_walk, wider_ways),
        position_noise=_log_normal(likeliest.position_noise, std.position_noise, wider_ways),
        intervals=len(steps.rows),
        left_out=steps.left_out,
        misfits=tuple(misfit_names),
    )


def _normal(value: float, std: float, wider: float) -> SampleInterval:
    """Return a value with its interval, wider by a factor."""
    reach = NORMAL * std * wider
    return SampleInterval(value, value - reach, value + reach)


def _log_normal(value: float, std: float, wider: float) -> SampleInterval:
    """Return a value with the interval of its logarithm, wider by a factor."""
    reach = min(NORMAL * std * wider, EXPONENT_MOST)
    low = float(value * np.exp(-reach))
    high = float(value * np.exp(reach))
    return SampleInterval(float(value), low, high)


# ---- The table ----


def response_table(responses: Sequence[RobotResponse], title: str, unit: str) -> Table:
    """Return a table of robots' values with their 95 % intervals; a row per value."""
    labels = []
    for name, unit_of_value in UNITS.items():
        of_unit = f" [{unit_of_value.format(unit=unit)}]" if unit_of_value else ""
        labels.append(f"{name.replace('_', ' ')}{of_unit}")
    columns = [Column("quantity", [*labels, "left out"])]
    misfits = []
    for robot in responses:
        values = [cell(value) for value in robot.quantities.values()]
        left_out = f"{robot.left_out} of {robot.left_out + robot.intervals}"
        columns.append(Column(robot.name, [*values, left_out]))
        if robot.misfits:
            misfits.append(f"{robot.name} ({', '.join(robot.misfits)})")
    note = "the model fits"
    if misfits:
        wider = "residuals are correlated in time, so intervals are wider"
        note = f"{wider}: {'; '.join(misfits)}"
    return Table(title, tuple(columns), f"{note}\n{_lag_for_spec(responses)}")


def _lag_for_spec(responses: Sequence[RobotResponse]) -> str:
    """Return in words the lag of a spec that fits all robots: the mean of the lags of turning, by
    which a host steers, weighted by their precision."""
    lags = np.array([robot.turning_lag.value for robot in responses])
    widths = [robot.turning_lag.high - robot.turning_lag.low for robot in responses]
    mean = float(np.average(lags, weights=1 / np.maximum(widths, LAG_LEAST_S)))
    if not (abs(lags - mean) <= SAME_LAG_S).all():
        return f"no single lag fits all robots within {SAME_LAG_S:g} s"
    return f"the lag of turning for a spec: lab.lag={mean:.3f}, in a simulation wheels.lag"
