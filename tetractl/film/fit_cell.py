"""Speed, turning rate and bias of each cell of a film, with 95 % intervals.

The filter of `lab.cameras.cells.helix` runs over the whole film again. Newton steps find each
cell's likeliest noise of heading, speed and blobs, variants of a cell being further cells of one
pass. The filter's covariance after a cell's last picture gives the uncertainty of turning rate a,
bias and speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats
from tetractl.film.field_file import FieldRecord, no_field
from tetractl.film.follow import CellPath, Followed
from tetractl.lab.cameras.cells.helix import (
    BIAS,
    RATE,
    SPEED,
    STATES,
    A,
    C,
    HelixFilter,
    Piece,
    S,
)
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step

START = 5  # number of pictures from which the first heading is computed
SETTLED_S = 1.0  # time after which the filter has estimated a cell's helix [s]
SHORTEST_S = 2.0  # duration of the shortest path that is fitted [s]
# usual noise: walk of the heading [rad/sqrt(s)]; noise of blobs, relative to that stated; walks
# of the speed [um/s per sqrt(s)], and of position and helix [um per sqrt(s)]
USUAL = np.array([0.07, 0.7, 3.0, 2.0])
SPREAD = 1.0  # standard deviation of ln of the noise among cells
RATE_WALK = 0.3  # walk of the helix's rate [rad/s per sqrt(s)]
ROUNDS = 3
CONSTANT = [RATE, A, BIAS]
WIDE_A = 0.3  # prior deviation of a (relative, and in rad/s) in the second run of the filter


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
    speed: SampleInterval | None
    sway_rad: float
    helix_hz: float
    helix_um: float
    a: SampleInterval | None
    bias: SampleInterval | None
    magnetised: bool | None
    probability: float


def summarise(followed: Followed, field: FieldRecord | None) -> tuple[CellSummary, ...]:
    """Return the results for each cell."""
    long = [path for path in followed.paths if path.times[-1] - path.times[0] >= SHORTEST_S]
    fits: dict[int, tuple[Floats, Floats]] = {}
    if long:
        table = _Measured.of(long, field)
        noise = np.zeros((len(long), len(USUAL)))
        for _ in range(ROUNDS):
            noise, _ = newton_step(table.likelihood, noise, SPREAD)
        rows = np.arange(len(long))
        means, _, _ = table.filtered(rows, noise)
        means, covariances, _ = table.filtered(rows, noise, means)
        for i, path in enumerate(long):
            fits[path.identity] = means[i], covariances[i]
    return tuple(
        _summary(path, fits.get(path.identity), field is not None) for path in followed.paths
    )


@dataclass(frozen=True, slots=True)
class _Measured:
    """Measurements of N cells in K pictures: `values` (K, N, 3), NaN where a cell has no blob of
    its own, and their standard deviations.

    `starts` (N, 5) are the number of each cell's first picture, and its x, y, heading and speed
    there. `pieces` (K,) are the field from the previous picture to each picture, if it is `known`.
    """

    values: Floats
    deviations: Floats
    starts: Floats
    pieces: Sequence[Sequence[Piece]]
    known: bool

    @classmethod
    def of(cls, paths: Sequence[CellPath], field: FieldRecord | None) -> "_Measured":
        pieces = no_field if field is None else field.pieces
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
        return cls(values, deviations, np.array(starts), [(), *between], field is not None)

    def likelihood(self, noise: Floats) -> Floats:
        """Return ln of the likelihood (N, V) of variants of the noise (N, V, 4) of each cell."""
        rows = np.repeat(np.arange(len(noise)), noise.shape[1])
        return self.filtered(rows, noise.reshape(-1, len(USUAL)))[2].reshape(noise.shape[:2])

    def filtered(
        self, cells: NDArray[np.int64], noise: Floats, about: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Run the filter for `cells` (R,) with ln of their noise (R, 4) over the usual one; return
        their means (R, 12) and covariances (R, 12, 12) after the last measurement, and their
        log-likelihood (R,).

        The constant states (rate of the helix, turning rate a, bias) start at their values in
        `about` (R, 12), the means of an earlier run; without `about`, the filter has to estimate
        them first, with a slightly larger error.
        """
        count, bank = len(cells), HelixFilter(self.known)
        walk, exact, unsteady, place = (USUAL * np.exp(noise)).T
        constant = np.full(count, RATE_WALK), np.zeros(count), np.zeros(count)
        growth = np.column_stack([place, place, walk, unsteady, place, place, *constant])
        values, starts = self.values[:, cells], self.starts[cells]
        deviations = self.deviations[:, cells] * exact[:, None]
        rows, total = np.full(count, -1), np.zeros(count)
        last = np.array([_last(values[:, i, 0]) for i in range(count)])
        means = np.full((count, STATES), np.nan)
        covariances = np.full((count, STATES, STATES), np.nan)
        for k, pieces in enumerate(self.pieces):
            bank.predict(pieces)
            there = np.flatnonzero((rows >= 0) & np.isfinite(values[k, :, 0]))
            likelihood, _ = bank.update(rows[there], values[k, there], deviations[k, there])
            total[there] += likelihood
            for i in np.flatnonzero(starts[:, 0] == k):
                rows[i] = bank.add(*starts[i, 1:])
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
        ends = np.stack([mean, mean - NORMAL * deviation, mean + NORMAL * deviation], axis=1)
        speed = SampleInterval(*ends[SPEED].tolist())
        if known:
            a, bias = SampleInterval(*ends[A].tolist()), SampleInterval(*ends[BIAS].tolist())
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
