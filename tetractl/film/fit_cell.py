"""Speed, turning rate and bias of each cell of a film, with 95 % intervals.

The filter of `lab.cameras.cells.helix` runs over the whole film again, with each cell's most likely
noise of heading, speed and blobs. The filter's covariance after a cell's last picture gives the
uncertainty of turning rate a, bias and speed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats
from tetractl.film.field_file import FieldRecord, no_field
from tetractl.film.follow import CellPath, Followed
from tetractl.lab.cameras.cells.helix import (
    BIAS,
    HEADING,
    RATE,
    SPEED,
    STATES,
    A,
    C,
    HelixFilter,
    S,
)

START = 5  # number of pictures from which the first heading is computed
NORMAL = 1.96  # standard deviations to either end of a 95 % interval
SETTLED_S = 1.0  # time after which the filter has estimated a cell's helix [s]
SHORTEST_S = 2.0  # duration of the shortest path that is fitted [s]
WALKS = (0.02, 0.035, 0.05, 0.07, 0.1, 0.15, 0.25)  # candidate walks of the heading [rad/sqrt(s)]
EXACTNESS = (0.2, 0.3, 0.45, 0.7, 1.0, 1.5)  # candidate noise of blobs, relative to the usual noise
UNSTEADY = (1.0, 3.0, 8.0, 20.0)  # candidate walks of the speed [um/s per sqrt(s)]
STRAY = (0.5, 2.0, 6.0)  # candidate walks of position and helix [um per sqrt(s)]
ROUNDS = 2
CONSTANT = [RATE, A, BIAS]
WIDE_A = 0.3  # prior deviation of a (relative, and in rad/s) in the second run of the filter


@dataclass(frozen=True, slots=True)
class Estimated:
    """A value and half the width of its 95 % interval."""

    value: float
    half: float

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - self.half

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + self.half


@dataclass(frozen=True, slots=True)
class CellSummary:
    """The results for one cell.

    `path_um` is the length of the path along the helix's axis, `sway_rad` the amplitude of the
    body's swing about it; `helix_hz` and `helix_um` are frequency and radius of the helix. `a` and
    `bias` are None without a known field; `magnetised` is whether the interval of `a` lies above 0.
    `probability` is the probability that the cell was not mistaken for another, in the picture
    where it is least.
    """

    cell: int
    since_s: float
    seconds: float
    pictures: int
    path_um: float
    speed: Estimated | None
    sway_rad: float
    helix_hz: float
    helix_um: float
    a: Estimated | None
    bias: Estimated | None
    magnetised: bool | None
    probability: float


@dataclass(frozen=True, slots=True)
class TrackNoise:
    """The noise of each of N cells, (N,): `walk` of the heading [rad/sqrt(s)], `exactness`, the
    blobs' noise relative to the usual noise, walks `unsteady` of the speed [um/s per sqrt(s)] and
    `stray` of position and helix [um per sqrt(s)].
    """

    walk: Floats
    exactness: Floats
    unsteady: Floats
    stray: Floats

    @classmethod
    def usual(cls, count: int) -> "TrackNoise":
        """Return the noise from which the fit starts."""
        return cls(*(np.full(count, value) for value in (0.07, 0.7, 3.0, 2.0)))

    def repeated(self, times: int) -> "TrackNoise":
        """Return the noise of `times` copies of the cells."""
        return TrackNoise(*(np.tile(getattr(self, name), times) for name in self.__slots__))

    @property
    def growth(self) -> Floats:
        """The filter's `growth` (N, 9): standard deviation of each state's random walk per
        sqrt(s).
        """
        none, rate = np.zeros(len(self.walk)), np.full(len(self.walk), 0.3)
        place = self.stray
        return np.column_stack(
            [place, place, self.walk, self.unsteady, place, place, rate, none, none]
        )


def summarise(
    followed: Followed,
    field: FieldRecord | None,
) -> tuple[tuple[CellSummary, ...], TrackNoise]:
    """Return the results for each cell, and the fitted noise."""
    pieces = no_field if field is None else field.pieces
    long = [path for path in followed.paths if path.times[-1] - path.times[0] >= SHORTEST_S]
    fits: dict[int, tuple[Floats, Floats]] = {}
    noise = TrackNoise.usual(len(long))
    if long:
        table = _Measured.of(long, pieces)
        noise = _likeliest(table, field is not None)
        means, _, _ = table.filtered(noise, field is not None)
        means, covariances, _ = table.filtered(noise, field is not None, means)
        for i, path in enumerate(long):
            fits[path.identity] = means[i], covariances[i]
    done = tuple(
        _summary(path, fits.get(path.identity), field is not None) for path in followed.paths
    )
    return done, noise


@dataclass(frozen=True, slots=True)
class _Measured:
    """Measurements of N cells in K pictures: `values` (K, N, 3), NaN where a cell has no blob of
    its own, and their standard deviations.

    `starts` (N, 5) are the number of each cell's first picture, and its x, y, heading and speed
    there. `pieces` (K,) are the field from the previous picture to each picture.
    """

    values: Floats
    deviations: Floats
    starts: Floats
    pieces: Sequence[Sequence[tuple[float, float, float]]]

    @classmethod
    def of(
        cls,
        paths: Sequence[CellPath],
        pieces: Callable[[float, float], Sequence[tuple[float, float, float]]],
    ) -> "_Measured":
        times = np.unique(np.concatenate([path.times for path in paths]))
        values = np.full((len(times), len(paths), 3), np.nan)
        deviations = np.ones_like(values)
        starts = []
        for i, path in enumerate(paths):
            at = np.searchsorted(times, path.times)
            for k, cell in zip(at, path.seen, strict=True):
                if (
                    cell.measured is not None and cell.measured[3] < 5
                ):  # the blob is complete and shows one cell
                    values[k, i], deviations[k, i] = cell.measured[:3], cell.measured[3:]
            own = np.flatnonzero(np.isfinite(values[:, i, 0]))[:START]
            if len(own) < START:
                starts.append((len(times), 0.0, 0.0, 0.0, 0.0))
                continue
            vx, vy = np.polyfit(times[own], values[own, i, :2], 1)[0]
            last = own[-1]
            x, y = values[last, i, :2]
            starts.append((last, x, y, math.atan2(vy, vx), math.hypot(vx, vy)))
        between = [pieces(a, b) for a, b in pairwise(times.tolist())]
        return cls(values, deviations, np.array(starts), [(), *between])

    def repeated(self, times: int) -> "_Measured":
        """Return the measurements of `times` copies of the cells."""
        values, deviations = (np.tile(v, (1, times, 1)) for v in (self.values, self.deviations))
        return _Measured(values, deviations, np.tile(self.starts, (times, 1)), self.pieces)

    def filtered(
        self, noise: TrackNoise, known: bool, about: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Run the filter; return each cell's means (N, 12) and covariances (N, 12, 12) after its
        last measurement, and its log-likelihood (N,).

        `known` is whether the field is known. The constant states (rate of the helix, turning rate
        a, bias) start at their values in `about` (N, 12), the means of an earlier run; without
        `about`, the filter has to estimate them first, with a slightly larger error.
        """
        count = self.values.shape[1]
        bank, growth = HelixFilter(known), noise.growth
        rows = np.full(count, -1)
        total = np.zeros(count)
        first = self.starts[:, 0].astype(int)
        last = np.array([_last(self.values[:, i, 0]) for i in range(count)])
        means = np.full((count, STATES), np.nan)
        covariances = np.full((count, STATES, STATES), np.nan)
        for k, pieces in enumerate(self.pieces):
            bank.predict(pieces)
            there = np.flatnonzero((rows >= 0) & np.isfinite(self.values[k, :, 0]))
            if len(there):
                deviation = self.deviations[k, there] * noise.exactness[there, None]
                likelihood, _ = bank.update(rows[there], self.values[k, there], deviation)
                total[there] += likelihood
            for i in np.flatnonzero(first == k):
                rows[i] = bank.add(*self.starts[i, 1:])
                bank.growth[rows[i]] = growth[i]
                if about is not None and np.isfinite(about[i]).all():
                    bank.mean[rows[i], CONSTANT] = about[i, CONSTANT]
                    bank.covariance[rows[i], A, A] = (WIDE_A * abs(about[i, A]) + WIDE_A) ** 2
            for i in np.flatnonzero((last == k) & (rows >= 0)):
                means[i], covariances[i] = bank.mean[rows[i]], bank.covariance[rows[i]]
                bank.drop(int(rows[i]))
                rows[i] = -1
        return means, covariances, total


def _last(values: Floats) -> int:
    known = np.flatnonzero(np.isfinite(values))
    return int(known[-1]) if len(known) else -1


def _likeliest(table: _Measured, known: bool) -> TrackNoise:
    """Return the most likely noise of each cell, fitted one component after another."""
    count = table.values.shape[1]
    best = TrackNoise.usual(count)
    for _ in range(ROUNDS):
        for name, options in (
            ("exactness", EXACTNESS),
            ("walk", WALKS),
            ("unsteady", UNSTEADY),
            ("stray", STRAY),
        ):
            tried = best.repeated(len(options))
            tried = replace(tried, **{name: np.repeat(options, count)})
            score = table.repeated(len(options)).filtered(tried, known)[2]
            chosen = score.reshape(len(options), count).argmax(axis=0)
            best = replace(best, **{name: np.array(options)[chosen]})
    return best


def _summary(path: CellPath, fit: tuple[Floats, Floats] | None, known: bool) -> CellSummary:
    means = np.array([cell.mean for cell in path.seen])
    settled = np.isfinite(means[:, SPEED]) & (path.times > path.times[0] + SETTLED_S)
    way = np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum()
    axes = np.array([cell.axis - cell.heading for cell in path.seen])[settled]
    sway = math.sqrt(2) * float(np.std((axes + math.pi / 2) % math.pi)) if len(axes) else math.nan
    helix = np.hypot(means[settled, C], means[settled, S])
    if len(means[settled]):  # the path of the helix's axis replaces the body's
        way = float(np.nanmean(means[settled, SPEED]) * (path.times[-1] - path.times[0]))
    speed = a = bias = None
    if fit is not None and np.isfinite(fit[0]).all():
        mean, deviation = fit[0], np.sqrt(np.diagonal(fit[1]))
        speed = Estimated(float(mean[SPEED]), float(NORMAL * deviation[SPEED]))
        if known:
            a = Estimated(float(mean[A]), float(NORMAL * deviation[A]))
            bias = Estimated(float(mean[BIAS]), float(NORMAL * deviation[BIAS]))
    return CellSummary(
        cell=path.identity,
        since_s=float(path.times[0]),
        seconds=float(path.times[-1] - path.times[0]),
        pictures=len(path.seen),
        path_um=float(way),
        speed=speed,
        sway_rad=sway,
        helix_hz=float(np.median(means[settled, RATE])) / (2 * math.pi)
        if settled.any()
        else math.nan,
        helix_um=float(np.median(helix)) if len(helix) else math.nan,
        a=a,
        bias=bias,
        magnetised=None if a is None else a.low > 0,
        probability=min(cell.probability for cell in path.seen),
    )


def headings(path: CellPath) -> Floats:
    """Return the heading of the helix in each picture (K,) [rad]."""
    return np.array([cell.heading for cell in path.seen])


assert HEADING == 2  # TrackNoise.growth has the order of the filter's states
