"""Fits a dead time that all robots share, and each robot's turning rate a, speed, heading bias and
noise, by maximising the likelihood of the controller's filter (`control.filter`).

A first pass of the filter over the longest track has a grid of dead times, and each of RATES as
factors on the expected turning rates a. The fit starts from the likeliest. In each of ROUNDS
rounds, passes over all tracks

- with the noise varied give gradient and curvature of the likelihood in the noise of measurements
  and the random walks, for a Newton step;
- with dead times around the likeliest give a parabola, whose maximum and width are the dead time
  and its standard deviation, and each robot's a, speed and bias with theirs.

The filter estimates a, speed and bias as constant states with wide priors, so that the likelihood
is the restricted one, which accounts for their fit. Intervals are normal in ln a, ln of the speed,
bias, dead time, ln of the measurement noise, and the random walks.

The residuals of a model that fits are white. Where they are not, by the test of Ljung and Box ("On
a measure of lack of fit in time series models", Biometrika 65, 1978), intervals of a, speed and
bias are widened by the ratio of the residuals' long-run deviation to their own, and that of the
dead time by the greatest such ratio.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from tetractl.control.body_model import USUAL
from tetractl.core.errors import UsageError
from tetractl.core.poses import Floats
from tetractl.replay.identification.passes import (
    UNKNOWN_S,
    Belief,
    Passed,
    TrackFrames,
    marginal,
    run,
)

ROUNDS = 6
RATES = (1.0, 0.4, 2.5)  # factors on the expected a, from which the first pass starts
REACH_S, APART_S = 0.3, 0.02  # half width and spacing of the first pass's dead times [s]
SEARCHED_S = (-0.5, 2.0, 0.05)
"""Dead times that are searched if it is unknown, and their spacing [s]. Below 0, times are of two
clocks."""
EARLY_S = 0.1  # time by which robots may seem to turn before they are sent a direction [s]
# prior standard deviations of ln a, ln of the speed and bias [rad]: of the first pass, and at most
FIRST, WEAK = np.array([0.5, 0.5, 0.2]), np.array([2.0, 0.5, 1.0])
WIDER = 10.0  # prior standard deviation of a pass, over the deviation after the pass before
LOOSE = 5.0  # prior standard deviation of the noise's parameters
NORMAL = 1.96  # standard deviations to either end of a 95 % interval
FAR = np.array([3.0, 1.0, 1.5])  # half widths from which ends of ln a, ln speed, bias are unknown
UNLIKELY = -1e12  # ln of the likelihood of variants for which it cannot be computed
LAGS, DOUBT = 5, 0.001  # lags of the test of residuals, and its level
# deviations of residuals below which no camera shows that a model does not fit: of positions over
# the speed [s], and of headings [rad]
RESOLVED_S, RESOLVED = 5e-4, 1e-3
DELAY_S = 7e-4
"""How far the radio's delay may be from that which a host assumes [s]. Hosts of lagging wheels send
rates of the headings after that delay, so that robots turn as if a were larger by its share a
DELAY_S: the bench's host assumes 7 ms of 7.7. With it, intervals of a held the truth in 344 of 360
of the bench's logs (n = 120, three robots each; benchmarks/identify_coverage.py --bench)."""
HEADING = "heading"
RESIDUALS = ("along the path", "across the path", HEADING)


@dataclass(frozen=True, slots=True)
class SampleInterval:
    """A value and its 95 % interval; an end is infinite if the data do not bound the value."""

    value: float
    low: float
    high: float


class Fitted(NamedTuple):
    """The likeliest values with their 95 % intervals: the dead time [s], and of each robot a, speed
    and heading bias as `motion`, and standard deviations of measured positions, of their random
    walk, of measured headings and of theirs as `noise`.

    `lost` (N,) is the expected number of commands that a robot lost; `misfits` names, for each
    robot, the residuals that are not white.
    """

    dead_time: SampleInterval
    motion: list[list[SampleInterval]]
    noise: list[list[SampleInterval]]
    lost: Floats
    misfits: list[list[str]]


def fit(frames: list[TrackFrames], a: Floats, speed: Floats, dead_time: float | None) -> Fitted:
    """Fit the parameters to the frames of some tracks, from expected turning rates a (N,) [rad/s],
    speeds (N,) [length unit/s] and dead time [s], None if that is unknown.
    """
    state = _Fit(frames, a, speed, dead_time)
    for _ in range(ROUNDS):
        state.fit_noise()
        state.fit_motion()
    return state.result()


def _searched(frames: TrackFrames, rows: np.ndarray, first: Belief) -> float:
    """Return the likeliest dead time of those that are possible [s], for robots `rows` (R,) with
    each of RATES; UsageError if it is at an end of these."""
    tau = np.arange(*SEARCHED_S)
    found = run([frames], rows, first, tau, SEARCHED_S[2])
    at = _likeliest(found, len(rows) // len(RATES))
    if tau[at] < -EARLY_S or at == len(tau) - 1:
        way = "before" if tau[at] < 0 else "after"
        raise UsageError(
            f"robots seem to turn {abs(tau[at]):.2g} s {way} they are sent a direction",
            "are all times of one clock, and in s?",
        )
    return max(0.0, float(tau[at]))


def _likeliest(found: Passed, count: int) -> int:
    """Return the index of the likeliest dead time of a pass of robots with each of RATES."""
    by_rate = found.likelihood.reshape(len(found.likelihood), count, -1)
    return int(by_rate.max(axis=2).sum(axis=1).argmax())


class _Fit:
    """The parameters of a fit, improved round by round.

    The noise of a robot has four parameters (N, 4): the logarithms of the noise of measured
    positions and headings over `unit` (N, 4), and their random walks over theirs, which may be 0
    and count by their magnitudes.
    """

    def __init__(
        self, frames: list[TrackFrames], a: Floats, speed: Floats, dead_time: float | None
    ) -> None:
        self.frames, count = frames, len(a)
        usual = USUAL.position_noise_s * speed, USUAL.slip * speed
        self._unit = np.column_stack(
            [*usual, np.tile((USUAL.heading_noise, USUAL.walk), (count, 1))]
        )
        self.noise = np.tile((0.0, 1.0, 0.0, 1.0), (count, 1))
        self.noise_std = np.ones_like(self.noise)
        self.std = np.tile(FIRST / WIDER, (count, 1))
        self.mean = np.column_stack([np.log(a), np.log(speed), np.zeros(count)])
        rows = np.repeat(np.arange(count), len(RATES))
        first = self._belief(rows, self.noise[rows])
        first.mean[:, 0] += np.tile(np.log(RATES), count)
        longest = max(frames, key=lambda one: len(one.time))
        if dead_time is None:
            dead_time = _searched(longest, rows, first)
        tau = np.arange(max(0.0, dead_time - REACH_S), dead_time + REACH_S, APART_S)
        found = run([longest], rows, first, tau, APART_S)
        at = _likeliest(found, count)
        best = np.arange(count) * len(RATES)
        best += found.likelihood[at].reshape(count, -1).argmax(axis=1)
        self.tau, self.tau_std = float(tau[at]), APART_S / 2
        self.mean, self.std = found.mean[at, best], found.std[at, best]

    def fit_noise(self) -> None:
        """Do a Newton step in the noise's parameters."""
        self.noise, self.noise_std = newton_step(self._likelihood, self.noise, LOOSE)

    def _likelihood(self, noise: Floats) -> Floats:
        """Return ln of the likelihoods (N, V) of variants of the noise (N, V, 4)."""
        rows = np.repeat(np.arange(len(noise)), noise.shape[1])
        belief = self._belief(rows, noise.reshape(-1, 4))
        found = run(self.frames, rows, belief, np.array([self.tau])).likelihood
        return found.reshape(noise.shape[:2])

    def fit_motion(self, watched: bool = False) -> Passed:
        """Find the likeliest dead time, a, speed and bias at the present noise."""
        belief = self._belief(np.arange(len(self.mean)), self.noise)
        found = marginal(self.frames, belief, self.tau, self.tau_std, watched)
        self.tau, self.tau_std, self.mean, self.std, passed = found
        return passed

    def _belief(self, rows: np.ndarray, noise: Floats) -> Belief:
        std, unit = np.minimum(WIDER * self.std, WEAK)[rows], self._deviations(rows, noise)
        return Belief(self.mean[rows], std, unit[:, ::2], unit[:, 1::2])

    def _deviations(self, rows: np.ndarray, noise: Floats) -> Floats:
        """Return the standard deviations (R, 4) for parameters of the noise (R, 4)."""
        return self._unit[rows] * np.where([True, False] * 2, np.exp(noise), np.abs(noise))

    def result(self) -> Fitted:
        """Return the fit with its intervals."""
        watched = self.fit_motion(watched=True)
        speed = np.exp(self.mean[:, 1])
        resolved = np.stack([RESOLVED_S * speed, RESOLVED_S * speed, RESOLVED + 0 * speed], axis=1)
        misfits, wider = white(watched.residuals, resolved)
        deviations = self.std * wider[:, None]
        if any(track.lag > 0 for track in self.frames):
            deviations[:, 0] = np.hypot(deviations[:, 0], np.exp(self.mean[:, 0]) * DELAY_S)
        half = NORMAL * deviations
        half = np.where(half > FAR, np.inf, half)
        motion = np.stack([self.mean, self.mean - half, self.mean + half], axis=-1)
        motion[:, :2] = np.exp(motion[:, :2])
        size, rows = np.abs(self.noise), np.arange(len(self.noise))
        size[:, ::2] = self.noise[:, ::2]
        ends = [size + sign * NORMAL * self.noise_std for sign in (0, -1, 1)]
        ends[1][:, 1::2] = np.maximum(ends[1][:, 1::2], 0.0)
        noise = np.stack([self._deviations(rows, one) for one in ends], axis=-1)
        reach = NORMAL * self.tau_std * wider.max() if self.tau_std < UNKNOWN_S else np.inf
        return Fitted(
            SampleInterval(*(max(0.0, self.tau + end) for end in (0.0, -reach, reach))),
            [[SampleInterval(*v) for v in robot] for robot in motion.tolist()],
            [[SampleInterval(*v) for v in robot] for robot in noise.tolist()],
            watched.lost,
            misfits,
        )


def white(residuals: Floats, resolved: Floats) -> tuple[list[list[str]], Floats]:
    """Return the kinds of each robot's residuals (F, N, 3) that are not white though their
    deviation is above `resolved` (N, 3), and the greatest ratio of their long-run deviation to it
    (N,), at least 1.
    """
    misfits: list[list[str]] = [[] for _ in range(residuals.shape[1])]
    wider = np.ones(len(misfits))
    for robot, kind in np.ndindex(residuals.shape[1:]):
        r = residuals[:, robot, kind]
        seen = np.isfinite(r)
        if np.std(r[seen]) < resolved[robot, kind]:
            continue
        r = np.nan_to_num(np.clip(r, *np.std(r[seen]) * np.array([-4.0, 4.0])))
        rho = np.array([r[lag:] @ r[:-lag] for lag in range(1, LAGS + 1)]) / (r @ r + 1e-300)
        if chdtrc(LAGS, seen.sum() * (rho**2).sum()) < DOUBT / residuals[0].size:
            misfits[robot].append(RESIDUALS[kind])
            wider[robot] = max(wider[robot], np.sqrt(max(1 + 2 * rho.sum(), 1.0)))
    return misfits, wider


STEP, LONGEST = 0.1, 1.0  # steps of the parameters, for derivatives, and at most
SHARES = np.array([0.0, 0.05, 0.2, 0.5, 1.0])  # tried shares of a step


def newton_step(
    likelihood: Callable[[Floats], Floats], at: Floats, prior_std: float
) -> tuple[Floats, Floats]:
    """Return better parameters (N, P), and their standard deviations (N, P) by the curvature.

    `likelihood` returns its logarithm (N, V) for V variants of the parameters (N, V, P); each
    parameter has a normal prior around 0. Derivatives are differences.
    """

    def score(change: Floats) -> Floats:
        tried = at[:, None] + change
        found = likelihood(tried) - np.square(tried).sum(axis=2) / (2 * prior_std**2)
        return np.where(np.isfinite(found), found, UNLIKELY)

    size = at.shape[1]
    one, (i, j) = STEP * np.eye(size), np.triu_indices(size, 1)
    found = score(np.vstack([np.zeros(size), one, -one, one[i] + one[j]])[None])
    base, up, down, both = np.split(found, (1, 1 + size, 1 + 2 * size), axis=1)
    bend = np.zeros((len(at), size, size))
    bend[:, range(size), range(size)] = (2 * base - up - down) / STEP**2
    bend[:, i, j] = bend[:, j, i] = (up[:, i] + up[:, j] - base - both) / STEP**2
    value, vector = np.linalg.eigh(bend)
    value = np.maximum(np.abs(value), prior_std**-2)  # a step uphill where the curve is hollow
    step = np.einsum("nij,nj,nkj,nk->ni", vector, 1 / value, vector, (up - down) / (2 * STEP))
    step = np.clip(step, -LONGEST, LONGEST)
    best = score(SHARES[:, None] * step[:, None]).argmax(axis=1)
    return at + SHARES[best][:, None] * step, np.sqrt(np.einsum("nij,nj->ni", vector**2, 1 / value))
