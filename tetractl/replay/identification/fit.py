"""Fits a dead time that all robots share, and each robot's turning rate a and heading bias, by
maximum likelihood.

The controller's filters (`control.filter`) run over the longest track, once for each factor of
RATES, starting from the expected turning rates a times that factor. The fit starts from the final
estimates of the run that predicts the turns best. Each of ROUNDS rounds then infers lost commands
from the robots' turns, leaves out intervals that deviate from the model by more than OUTLYING
standard deviations, fits the measurement noise and the random walk of the headings, and fits the
parameters by Gauss-Newton steps on the whitened residuals. A parameter's 95 % interval contains the
values for which the deviance, minimised over all other parameters, is at most LIMIT above its
minimum.

Normal priors around the fit's starting values, with the wide standard deviations WEAK, keep a
parameter bounded if the data do not determine it.
"""

from dataclasses import dataclass

import numpy as np

from tetractl.control.filter import FilterBank
from tetractl.control.prior import Prior
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.poses import Bools, Floats, Observation, Poses
from tetractl.replay.identification.chain import LIMIT, Chain, ChainNoise
from tetractl.replay.identification.tracks import Drives, Track
from tetractl.replay.identification.turning import Turning, Turns

OUTLYING = 4.0  # largest deviation of a used interval [standard deviations]
ROUNDS = 5
RATES = (1.0, 0.4, 2.5)  # factors on the expected a, from which the filters start
WEAK = (0.5, 2.0, 1.0)  # prior standard deviations of tau [s], ln a and beta [rad]
# largest distances from tau, ln a and beta at which an interval's end is searched
FAR = 1.0, 3.0, 1.5
STEP = (0.03, 0.3, 0.3)  # longest Gauss-Newton step of tau, ln a and beta
NEWTON = 3  # Gauss-Newton steps at each point of a profile
POINTS = 6  # number of points on each side of a profile


@dataclass(frozen=True, slots=True)
class Fitted:
    """The most likely parameters and the ends of their 95 % intervals; an end that was not found is
    infinite.

    `chains` and `noises` describe each robot's turns; `used` (K, N) is True for intervals in the
    fit.
    """

    best: Turning
    low: Turning
    high: Turning
    turns: Turns
    chains: list[Chain]
    noises: list[ChainNoise]
    used: Bools


def fit(tracks: list[Track], drives: Drives, prior: Prior) -> Fitted:
    """Fit the parameters to tracks; `drives` are the same tracks joined, `prior` the expected
    values.
    """
    longest = max(tracks, key=lambda track: len(track.time))
    starts = [_filtered(longest, prior._replace(a=prior.a * rate)) for rate in RATES]
    first = min((_Fit(drives, start) for start in starts), key=_Fit.misfit)
    for _ in range(ROUNDS):
        first.improve()
    return first.result()


def _filtered(track: Track, prior: Prior) -> Turning:
    """Return the final estimates of the controller's filters, run over the frames and commands of a
    track.
    """
    bank, every = FilterBank(prior), (True,) * len(prior.a)
    sent, at = (track.sent * SECOND).round().astype(np.int64).tolist(), 0
    for k in np.flatnonzero(track.time <= track.until).tolist():
        now = round(track.time[k] * SECOND)
        while at < len(sent) and sent[at] <= now:
            bank.sent(Command(float(track.u[at]), sent[at], every))
            at += 1
        poses = Poses.of(np.nan_to_num(track.poses[k]))
        bank.seen(Observation(k, now, now, poses, track.valid[k]))
    found = bank.estimate()
    assert found.dead_time is not None and found.heading_bias is not None
    return Turning(found.dead_time, np.log(found.a), found.heading_bias)


class _Fit:
    """The parameters, noise and used intervals of a fit, improved round by round."""

    def __init__(self, drives: Drives, start: Turning) -> None:
        self.turns, self.p = Turns(drives), start
        self.used = drives.intervals.usable
        n = self.used.shape[1]
        self._weak, self._far, self._step = (np.repeat(v, [1, n, n]) for v in (WEAK, FAR, STEP))
        self._center = start.vector()
        self._chains: list[Chain] = []
        self._noises: list[ChainNoise] = []
        self._factors: list[Floats] = []

    def misfit(self) -> float:
        """Return the mean absolute error of the predicted turns [rad]; an error above 0.2 rad
        counts as 0.2 rad.
        """
        r = np.abs(self.turns.missed(self.p))
        return float(np.minimum(r, 0.2)[self.used].mean()) if self.used.any() else np.inf

    def improve(self) -> None:
        """Do one round: infer losses, leave out outliers, fit the noise, fit the parameters."""
        usable = self.turns.drives.intervals.usable
        if not self._noises:
            r = self.turns.missed(self.p)
            spread = [_spread(r[usable[:, i], i]) for i in range(r.shape[1])]
            self._chains = self.turns.chains(self.p, usable)
            self._noises = [ChainNoise(one / np.sqrt(2), one) for one in spread]
        self.turns.believe(self.p, self._chains, self._noises)
        r = self.turns.missed(self.p)
        limits = [
            OUTLYING * np.sqrt(c.variance(n))
            for c, n in zip(self._chains, self._noises, strict=True)
        ]
        self.used = usable & (np.abs(r) <= np.column_stack(limits))
        self._chains = self.turns.chains(self.p, self.used)
        by = self.turns.derivatives(self.p)
        self._noises = [c.noise_of(r[:, i], by[:, i]) for i, c in enumerate(self._chains)]
        self._factors = [c.factor(n) for c, n in zip(self._chains, self._noises, strict=True)]
        for _ in range(NEWTON):
            self.p = self._newton(self.p, None)

    def _whitened(self, p: Turning, derivatives: bool) -> tuple[Floats, Floats]:
        """Return the whitened residuals y (N K,) and, if `derivatives`, the whitened derivatives of
        the predicted turns with respect to the parameters (N K, 1 + 2 N), otherwise an empty array.
        """
        r, count = self.turns.missed(p), self.used.shape[1]
        by = self.turns.derivatives(p) if derivatives else np.empty((*r.shape, 0))
        ys, rows = [], []
        for i, (chain, factor) in enumerate(zip(self._chains, self._factors, strict=True)):
            y = chain.whiten(factor, np.column_stack([r[:, i], by[:, i]]))
            ys.append(y[:, 0])
            if derivatives:
                row = np.zeros((len(r), 1 + 2 * count))
                row[:, 0], row[:, 1 + i], row[:, 1 + count + i] = y[:, 1:].T
                rows.append(row)
        return np.concatenate(ys), np.concatenate(rows) if rows else np.empty((0, 0))

    def _newton(self, p: Turning, fixed: int | None) -> Turning:
        """Return the parameters after a Gauss-Newton step, which leaves the parameter of index
        `fixed` unchanged.
        """
        y, by = self._whitened(p, True)
        v = p.vector()
        normal = by.T @ by + np.diag(self._weak**-2.0)
        right = by.T @ y - (v - self._center) / self._weak**2
        if fixed is not None:
            normal[fixed], normal[:, fixed], right[fixed] = 0.0, 0.0, 0.0
            normal[fixed, fixed] = 1.0
        self._deviations = np.sqrt(np.diag(np.linalg.inv(normal)))
        v = v + np.clip(np.linalg.solve(normal, right), -self._step, self._step)
        v[0] = max(v[0], 0.0)
        return Turning.of(v)

    def _deviance(self, p: Turning) -> float:
        y, _ = self._whitened(p, False)
        return float(y @ y + (((p.vector() - self._center) / self._weak) ** 2).sum())

    def _end(self, which: int, sign: int, deviation: float, least: float) -> float:
        """Return the lower (`sign` -1) or upper (+1) end of the interval of parameter `which`: the
        value at which the deviance, minimised over all other parameters, is LIMIT above `least`.
        """
        best = self.p.vector()
        p, reach = self.p, 1.96 * deviation
        inside, outside = 0.0, np.inf
        for _ in range(POINTS):
            if reach > self._far[which]:
                return sign * np.inf
            v = p.vector()
            v[which] = best[which] + sign * reach
            if which == 0 and v[0] <= 0:
                if inside == outside:
                    break
                v[0] = 0.0
            p = Turning.of(v)
            for _ in range(NEWTON):
                p = self._newton(p, which)
            above = self._deviance(p) - least
            if which == 0 and v[0] == 0.0 and above <= LIMIT:
                return 0.0
            if above <= LIMIT:
                inside = reach
            else:
                outside = reach
            if abs(above - LIMIT) < 0.02:
                break
            guess = reach * np.sqrt(LIMIT / max(above, LIMIT / 9))
            if not inside < guess < outside:
                guess = 2 * reach if np.isinf(outside) else (inside + outside) / 2
            reach = float(guess)
        return float(best[which] + sign * reach)

    def result(self) -> Fitted:
        """Return the fit with the intervals of its parameters."""
        best = self.p.vector()
        self._newton(self.p, None)
        deviations, least = self._deviations, self._deviance(self.p)
        low, high = (
            np.array([self._end(j, sign, deviations[j], least) for j in range(len(best))])
            for sign in (-1, 1)
        )
        return Fitted(
            self.p,
            Turning.of(low),
            Turning.of(high),
            self.turns,
            self._chains,
            self._noises,
            self.used,
        )


def _spread(r: Floats) -> float:
    """Return the standard deviation of residuals, estimated from the median of their magnitudes."""
    return max(float(np.median(np.abs(r))) / 0.6745, 1e-6) if r.size else 1.0
