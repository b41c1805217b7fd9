"""Fits how robots on two wheels follow commands of speed v and turning rate w: gains, lags, dead
time and noise.

A command acts `dead_time` after it is sent; speed p and turning rate q follow it with first-order
lags of their own. Between two poses a robot

    turns by   turning_gain * integral of q  +  veer * integral of p  +  a random walk's step
    drives     speed_gain * integral of p    +  a term in q          +  a random walk's step

along its heading. Poses are measured with white noise, which two neighbouring steps share with
opposite signs: the covariance of the steps is tridiagonal. They are linear in the gains, so that
the restricted likelihood of dead time, lags and noise has a closed form; its maximum is found from
a grid by Newton steps, and intervals are normal in dead time, gains and logarithms of the others.
If residuals are correlated by the test of `fit`, intervals are wider and the table says so.

Steps last at least STEP_S, and where a robot has no command it stands, which is left out, as are
steps that are FAR times further off than usual: a tracker that takes a body for another.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.core.table.table import Column, Table
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step, white
from tetractl.replay.identification.identify import INTERVALS_MIN, cell
from tetractl.replay.identification.tracks import Track

STEP_S, LONGEST_S = 0.1, 0.5  # duration of steps [s]
SAME_LAG_S = 0.02  # to which a lag has to be known to be of use [s]
FAR = 8.0  # of a step that is left out, in deviations by the median
TAUS, LAGS = np.arange(-0.1, 0.5, 0.05), (0.03, 0.1, 0.3)  # the grid, about the expected time [s]
TAU_S, LAG_S, SHORT_S = 0.05, 0.1, 1e-3  # units of the parameters, and the shortest lag [s]
ROUNDS, SETTLED, LOOSE, TINY = 8, 0.02, 5.0, 1e-18
# units of the noise: around [rad], and along over the speed [s]
WALK, NOISE = np.array([0.02, 0.02]), np.array([0.003, 0.002])


@dataclass(frozen=True, slots=True)
class RobotResponse:
    """How one robot follows its commands; see the fields of `RobotFound` for the noise. `veer`
    [rad/length unit] is by how much it turns on its way though w is 0, `left_out` the number of
    steps too far off."""

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
    def values(self) -> tuple[SampleInterval, ...]:
        """The intervals of ROWS."""
        times = self.dead_time, self.turning_lag, self.speed_lag
        gains = self.turning_gain, self.speed_gain, self.veer
        noise = self.heading_walk, self.heading_noise, self.way_walk, self.position_noise
        return (*times, *gains, *noise)


class _Part(NamedTuple):
    """Steps of one track of a robot: times (M,) of poses, what it turned and drove (M - 1,), and
    its commands (C, 2), sent `when` (C,)."""

    time: Floats
    moved: Floats
    when: Floats
    command: Floats


def respond(tracks: Sequence[Track], dead_time: float = 0.1) -> list[RobotResponse]:
    """Return how each robot of the tracks follows its commands, for an expected dead time [s];
    UsageError if it drives too little."""
    return [
        _Response(name, [_part(track, i) for track in tracks], dead_time).result()
        for i, name in enumerate(tracks[0].names)
    ]


class _Response:
    """The fit of one robot. Parameters (7,): dead time, lags of turning and speed, walks and noises
    of heading and way, in their units, all but the first as logarithms."""

    def __init__(self, name: str, parts: list[_Part], dead_time: float) -> None:
        self.name, self.parts, self.dead_time = name, parts, dead_time
        self.span = np.concatenate([np.diff(part.time) for part in parts])
        moved = np.concatenate([part.moved for part in parts])
        first = self._driven(dead_time, LAG_S)
        good = self.span < LONGEST_S
        ends = np.cumsum([len(part.moved) for part in parts])[:-1]
        good &= np.hypot(*first.T) > 1e-9
        if good.sum() < INTERVALS_MIN:
            raise UsageError(f"robot {name} drives in only {good.sum()} steps of {STEP_S:g} s")
        if np.linalg.matrix_rank(first[good]) < 2:
            raise UsageError(f"robot {name} is sent one speed and turning rate only")
        off = np.zeros(len(good), dtype=np.bool_)
        for k in (0, 1):
            rest = moved[:, k] - first @ np.linalg.lstsq(first[good], moved[good, k])[0]
            off |= np.abs(rest) > FAR * 1.48 * np.median(np.abs(rest[good])) + 1e-9
        self.left_out, self.rows = int((good & off).sum()), np.flatnonzero(good & ~off)
        self.shared = (np.diff(self.rows) == 1) & ~np.isin(self.rows[1:], ends)
        self.moved, self.span = moved[self.rows], self.span[self.rows]
        speed = float(np.median(np.abs(self.moved[:, 1]) / self.span))
        self.walk, self.noise = WALK * (1, speed), NOISE * (1, speed)
        grid = [(tau / TAU_S, np.log(lag / LAG_S)) for tau in TAUS for lag in LAGS]
        tried = np.zeros((1, len(grid), 7))
        tried[0, :, 0], tried[0, :, 1] = np.array(grid).T
        self.at = tried[:, self._likelihood(tried)[0].argmax()]
        for _ in range(ROUNDS):
            before = self.at
            self.at, self.std = newton_step(self._likelihood, before, LOOSE)
            if (np.abs(self.at - before) < SETTLED * self.std).all():
                break

    def _driven(self, tau: float, lag: float) -> Floats:
        """Return the integrals of p and q over each step (M, 2)."""
        return np.concatenate([_integrals(part, tau, lag) for part in self.parts])

    def _likelihood(self, at: Floats) -> Floats:
        return np.array([[sum(self._kind(p, k)[0] for k in (0, 1)) for p in at[0]]])

    def _times(self, p: Floats) -> tuple[float, Floats]:
        """Return dead time and lags of turning and speed [s] for parameters (7,)."""
        return self.dead_time + TAU_S * p[0], np.maximum(LAG_S * np.exp(p[1:3]), SHORT_S)

    def _kind(self, p: Floats, k: int) -> tuple[float, Floats, Floats, Floats]:
        """Return the likelihood's logarithm of turns (k = 0) or ways (1), the coefficients (2,) of
        the integrals of p and q with their deviations, and the whitened residuals."""
        tau, lags = self._times(p)
        walk, noise = np.exp(p[3 + k]) * self.walk[k], np.exp(p[5 + k]) * self.noise[k]
        band = np.zeros((2, len(self.span)))
        band[0] = (walk**2 + TINY) * self.span + 2 * noise**2
        band[1, :-1] = -(noise**2) * self.shared
        root = cholesky_banded(band, lower=True)
        basis = self._driven(tau, float(lags[k]))[self.rows]
        even = solve_banded((1, 0), root, np.column_stack([self.moved[:, k], basis]))
        y, x = even[:, 0], even[:, 1:]
        square = x.T @ x
        found = np.asarray(np.linalg.solve(square, x.T @ y), dtype=np.float64)
        rest = y - x @ found
        fit = -np.log(root[0]).sum() - np.linalg.slogdet(square)[1] / 2 - rest @ rest / 2
        return float(fit), found, np.sqrt(np.diag(np.linalg.inv(square))), rest

    def result(self) -> RobotResponse:
        """Return the fit with its intervals."""
        _, turn, turn_std, one = self._kind(self.at[0], 0)
        _, way, way_std, two = self._kind(self.at[0], 1)
        misfits, wider = white(np.column_stack([one, two])[:, :, None], np.zeros((2, 1)))
        scale = NORMAL * self.std[0] * np.array([*wider[:1], *wider, *wider, *wider])

        def normal(value: float, std: float, k: int) -> SampleInterval:
            return SampleInterval(value, *(value + s * NORMAL * std * wider[k] for s in (-1, 1)))

        def grown(value: float, k: int) -> SampleInterval:
            ends = (float(value * np.exp(s * min(scale[k], 50.0))) for s in (-1, 1))
            return SampleInterval(float(value), *ends)

        tau, lags = self._times(self.at[0])
        walk, noise = np.exp(self.at[0, 3:5]) * self.walk, np.exp(self.at[0, 5:]) * self.noise
        return RobotResponse(
            self.name,
            normal(tau, TAU_S * self.std[0, 0], 0),
            grown(lags[0], 1),
            grown(lags[1], 2),
            normal(turn[1], turn_std[1], 0),
            normal(way[0], way_std[0], 1),
            normal(turn[0], turn_std[0], 0),
            grown(walk[0], 3),
            grown(noise[0], 5),
            grown(walk[1], 4),
            grown(noise[1], 6),
            len(self.rows),
            self.left_out,
            tuple(what for what, why in zip(("turning", "speed"), misfits, strict=True) if why),
        )


def _part(track: Track, i: int) -> _Part:
    """Return the steps of robot i of a track, from its first command to the end of the last."""
    known = np.isfinite(track.twists[:, i]).all(axis=1)
    when, command = track.sent[known], track.twists[known, i]
    seen, last, least, at = list[int](), -np.inf, STEP_S - 1e-9, track.exposed[:, i]
    for k in np.flatnonzero(track.valid[:, i]).tolist():
        if len(when) and when[0] <= at[k] <= when[-1] and at[k] - last >= least:
            seen.append(k)
            last = at[k]
    x, y, raw = track.poses[seen, i].T
    heading = np.unwrap(raw)
    middle, dx, dy = (heading[1:] + heading[:-1]) / 2, np.diff(x), np.diff(y)
    along = dx * np.cos(middle) + dy * np.sin(middle)
    return _Part(at[seen], np.column_stack([np.diff(heading), along]), when, command)


def _integrals(part: _Part, tau: float, lag: float) -> Floats:
    """Return the integrals over each step (M - 1, 2) of commands that act after `tau` and a first
    order lag [s]: that of u - lag dp/dt."""
    if len(part.time) < 2:
        return np.zeros((0, 2))
    when, u = part.when, part.command
    apart = np.diff(when)
    kept = np.exp(-apart / lag)
    band = np.ones((2, len(u)))
    band[1, :-1], band[1, -1] = -kept, 0.0
    follows = solve_banded((1, 0), band, np.vstack([u[:1], (1 - kept)[:, None] * u[:-1]]))
    total = np.vstack([np.zeros((1, 2)), np.cumsum(apart[:, None] * u[:-1], axis=0)])
    t = part.time - tau
    k = np.maximum(np.searchsorted(when, t, side="right") - 1, 0)
    since = (t - when[k])[:, None]
    now = u[k] + (follows[k] - u[k]) * np.exp(-np.maximum(since, 0.0) / lag)
    return np.diff(total[k] + since * u[k] - lag * now, axis=0)


ROWS = {
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
"""The fields of a robot in a table, with their units."""


def response_table(found: Sequence[RobotResponse], title: str, unit: str) -> Table:
    """Return a table of robots' values with their 95 % intervals; a row per value."""
    labels = [f"{name.replace('_', ' ')} [{of.format(unit=unit)}]" for name, of in ROWS.items()]
    columns = [
        Column(one.name, [*map(cell, one.values), f"{one.left_out} of {one.intervals}"])
        for one in found
    ]
    misfits = [f"{one.name} ({', '.join(one.misfits)})" for one in found if one.misfits]
    note = f"residuals are correlated in time, so intervals are wider: {'; '.join(misfits)}"
    first = Column("quantity", [*(label.removesuffix(" []") for label in labels), "left out"])
    note = f"{note if misfits else 'the model fits'}\n{_lag(found)}"
    return Table(title, (first, *columns), note)


def _lag(found: Sequence[RobotResponse]) -> str:
    """Return in words the lag of a spec that fits all robots: the mean of the lags of turning, by
    which a host steers, weighted by their precision."""
    lags = np.array([one.turning_lag.value for one in found])
    width = [one.turning_lag.high - one.turning_lag.low for one in found]
    mean = float(np.average(lags, weights=1 / np.maximum(width, SHORT_S)))
    if not (abs(lags - mean) <= SAME_LAG_S).all():
        return f"no single lag fits all robots within {SAME_LAG_S:g} s"
    return f"the lag of turning for a spec: lab.lag={mean:.3f}, in a simulation wheels.lag"
