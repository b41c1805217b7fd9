"""The smoothed path of each cell of a film, and its speed, turning rate and bias with 95 %
intervals.

The filter of `lab.cameras.cells.helix` runs over each path again, from the likeliest of some
helices and headings. Newton steps find the likeliest noise of the cell. A second pass starts with
the constants that the first found; the smoother gives the states given all pictures.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.film.field_file import FieldRecord, no_field
from tetractl.film.follow import CellPath, Followed
from tetractl.lab.cameras.cells.helix import (
    HELIX,
    RESPONDS,
    TURN_KNOWN,
    TURN_UNKNOWN,
    Piece,
    new_cell,
)
from tetractl.lab.cameras.cells.kernels.helix_path import likelihoods, smooth
from tetractl.lab.cameras.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
    HEADING,
    RATE,
    SPEED,
    STATES,
    WAY,
    A,
    C,
    S,
    X,
    Y,
)
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step

START_S, START = 0.5, 5  # time, and least number of pictures, that give the first heading
SHORTEST_S = 2.0  # duration of the shortest path that is fitted [s]
OWN_UM = 5.0  # deviation from which a blob is cut off or shows other cells, too [um]
EDGE = 0.55  # distance to the picture's edge, in lengths of the cell, at which it may be cut off
# helices and headings to start from: rates [rad/s], with the deviation among organisms, and angles
# to the first way [rad]
RATES, RATES_SD, ASIDE = 2 * math.pi * np.array([0.8, 1.3, 1.8, 2.4, 3.2]), 4.4, (-0.6, 0.0, 0.6)
# usual noise: walk of the heading [rad/sqrt(s)]; noise of blobs, relative to that stated; walks
# of the speed [um/s per sqrt(s)], and of position and helix [um per sqrt(s)]; turning that the
# field does not explain, relative to TURN_KNOWN or TURN_UNKNOWN
USUAL = np.array([0.07, 1.0, 8.0, 2.0, 1.0])
SPREAD = 1.0  # standard deviation of ln of the noise among cells
RATE_WALK = 0.3  # walk of the helix's rate [rad/s per sqrt(s)]
ROUNDS = 3
CONSTANT = [RATE, A, BIAS, DELAY]


@dataclass(frozen=True, slots=True)
class CellSummary:
    """The results for one cell.

    `seconds` is the number of picture periods from its first to its last picture. `speed` [um/s] is
    the mean over this time of the speed along the helix's axis in the medium, with the interval of
    this mean; `spread` is the standard deviation of the speed over time. `path_um` is the length of
    the way along the helix's axis, `sway_rad` the amplitude of the body's swing about it;
    `helix_hz` and `helix_um` are frequency and radius of the helix. `a` and `bias` are None without
    a known field; `magnetised` is whether `a` exceeds 0 by RESPONDS standard deviations.
    `probability` is the probability that the cell was not mistaken for another, in the picture
    where it is least.
    """

    cell: int
    since_s: float
    seconds: float
    pictures: int
    path_um: float
    speed: SampleInterval | None
    spread: float
    sway_rad: float
    helix_hz: float
    helix_um: float
    a: SampleInterval | None
    bias: SampleInterval | None
    magnetised: bool | None
    probability: float


def fit_cells(
    followed: Followed, field: FieldRecord | None
) -> tuple[Followed, tuple[CellSummary, ...]]:
    """Return the film's cells with smoothed paths, and the results for each cell.

    Paths shorter than SHORTEST_S are not smoothed, and have no speed.
    """
    paths, cells = [], []
    for path in followed.paths:
        pictures = int(path.frames[-1] - path.frames[0]) + 1
        fit = None
        if pictures >= round(SHORTEST_S * followed.rate_hz):
            fit = _Fit.of(path, field, np.array(followed.size) * followed.um_px)
        paths.append(path if fit is None else _smoothed(path, fit.states))
        cells.append(_summary(paths[-1], pictures / followed.rate_hz, fit, field is not None))
    return replace(followed, paths=tuple(paths)), tuple(cells)


@dataclass(frozen=True, slots=True)
class _Measured:
    """The measurements of one cell in K pictures: `values` (K, 3), NaN where it has no blob of its
    own, and their standard deviations. Pieces `first[k]` to `first[k + 1]` of the field (P, 3) are
    before picture k. The filter starts with `mean` (n,) and `covariance` (n, n).
    """

    values: Floats
    deviations: Floats
    pieces: Floats
    first: np.ndarray
    mean: Floats
    covariance: Floats
    turn_sd: float

    @classmethod
    def of(cls, path: CellPath, field: FieldRecord | None, span: Floats) -> Self | None:
        """Return the measurements of a path in a picture of `span` [um]; None if there are too few.

        Blobs that the picture's edge may cut off are left out.
        """
        measured = np.full((len(path.seen), 6), np.nan)
        for k, cell in enumerate(path.seen):
            if cell.measured is not None and cell.measured[3] < OWN_UM:
                measured[k] = cell.measured
        edge = np.minimum(measured[:, :2], span - measured[:, :2]).min(axis=1)
        long = np.nan_to_num(np.nanmedian([cell.long_um for cell in path.seen]))
        measured[edge < EDGE * long] = np.nan
        own = np.flatnonzero(np.isfinite(measured[:, 0]))
        if len(own) < START:
            return None
        times = path.times - path.times[0]
        early = own[: max(START, int((times[own] <= times[own[0]] + START_S).sum()))]
        (vx, vy), (x, y) = np.polyfit(times[early], measured[early, :2], 1)
        mean, covariance = new_cell(
            (x, y, math.atan2(vy, vx), math.hypot(vx, vy)), field is not None
        )
        pieces_of = no_field if field is None else field.pieces
        pieces, first = list[Piece](), [0, 0]
        for start, end in pairwise(path.times.tolist()):
            pieces += [piece for piece in pieces_of(start, end) if piece[0] > 0]
            first.append(len(pieces))
        return cls(
            np.ascontiguousarray(measured[:, :3]),
            np.ascontiguousarray(measured[:, 3:]),
            np.array(pieces).reshape(-1, 3),
            np.array(first),
            mean,
            covariance,
            TURN_UNKNOWN if field is None else TURN_KNOWN,
        )

    def likelihood(self, noise: Floats, mean: Floats) -> Floats:
        """Return ln of the likelihood (V,) of V variants of ln of the noise (V, 5) over the usual
        one, and of the first state (V, n).
        """
        found = np.empty((len(noise), len(self.values)))
        field = self.pieces, self.first
        given = mean.copy(), self.covariance, self.values, self.deviations, *field
        likelihoods(*given, *self._grown(noise), found)
        return found.sum(axis=1)

    def smoothed(self, noise: Floats, mean: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the last state (n,), its covariance (n, n), and all states (K, n) given all
        pictures, for ln of the noise (5,) over the usual one and a first state (n,).
        """
        growth, turn_sd, exact = (each[0] for each in self._grown(noise[None]))
        last, covariance = mean.copy(), self.covariance.copy()
        states = np.empty((len(self.values), STATES))
        field, walks = (self.pieces, self.first), (growth, turn_sd, exact)
        smooth(last, covariance, self.values, self.deviations, *field, *walks, states)
        return last, covariance, states

    def _grown(self, noise: Floats) -> tuple[Floats, Floats, Floats]:
        walk, exact, unsteady, place, turn = (USUAL * np.exp(noise)).T
        none = np.zeros(len(noise))
        constant = none + RATE_WALK, none, none
        growth = np.column_stack([place, place, walk, unsteady, place, place, *constant])
        return growth, turn * self.turn_sd, exact


@dataclass(frozen=True, slots=True)
class _Fit:
    """The fit of one cell: its last state `mean` (n,), standard deviations `sd` (n,) of that, and
    the smoothed `states` (K, n).
    """

    mean: Floats
    sd: Floats
    states: Floats

    @classmethod
    def of(cls, path: CellPath, field: FieldRecord | None, span: Floats) -> Self | None:
        """Fit a path; return None if it has too few measurements."""
        table = _Measured.of(path, field, span)
        if table is None:
            return None
        starts = np.tile(table.mean, (len(RATES) * len(ASIDE), 1))
        starts[:, RATE] = np.repeat(RATES, len(ASIDE))
        starts[:, HEADING] += np.tile(ASIDE, len(RATES))
        likely = table.likelihood(np.zeros((len(starts), len(USUAL))), starts)
        likely -= ((starts[:, RATE] - HELIX[0]) / RATES_SD) ** 2 / 2
        mean, noise = starts[likely.argmax()], np.zeros((1, len(USUAL)))

        def likelihood(tried: Floats) -> Floats:
            return table.likelihood(tried[0], np.tile(mean, (tried.shape[1], 1)))[None]

        for _ in range(ROUNDS):
            noise, _ = newton_step(likelihood, noise, SPREAD)
        states = table.smoothed(noise[0], mean)[2]
        mean[CONSTANT] = states[0, CONSTANT]
        last, covariance, states = table.smoothed(noise[0], mean)
        return cls(last, np.sqrt(np.diagonal(covariance)), states)

    def interval(self, state: int, scale: float = 1.0) -> SampleInterval:
        """Return the last value of a state times a factor, with its 95 % interval."""
        value, half = scale * float(self.mean[state]), scale * NORMAL * float(self.sd[state])
        return SampleInterval(value, value - half, value + half)


def _smoothed(path: CellPath, states: Floats) -> CellPath:
    """Return a path with the smoothed states (K, n)."""
    cos, sin = np.cos(states[:, HEADING]), np.sin(states[:, HEADING])
    x, y = states[:, X] - states[:, C] * sin, states[:, Y] + states[:, C] * cos
    axis = states[:, HEADING] - np.arctan2(states[:, RATE] * states[:, S], states[:, SPEED])
    poses = zip(x.tolist(), y.tolist(), axis.tolist(), states[:, HEADING].tolist(), strict=True)
    seen = tuple(
        replace(cell, x=x, y=y, axis=axis, heading=heading, mean=state)
        for cell, (x, y, axis, heading), state in zip(path.seen, poses, states, strict=True)
    )
    return replace(path, seen=seen)


def _summary(path: CellPath, seconds: float, fit: _Fit | None, known: bool) -> CellSummary:
    between = float(path.times[-1] - path.times[0])
    way = float(np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum())
    speed = a = bias = None
    spread = sway = hz = radius = math.nan
    if fit is not None:
        states, way = fit.states, float(fit.mean[WAY])
        speed, spread = fit.interval(WAY, 1 / between), float(np.std(states[:, SPEED]))
        across = np.arctan2(states[:, RATE] * states[:, S], states[:, SPEED])
        sway = math.sqrt(2) * float(np.std(across))
        hz = float(np.median(states[:, RATE])) / (2 * math.pi)
        radius = float(np.median(np.hypot(states[:, C], states[:, S])))
        if known:
            a, bias = fit.interval(A), fit.interval(BIAS)
    return CellSummary(
        cell=path.identity,
        since_s=float(path.times[0]),
        seconds=seconds,
        pictures=len(path.seen),
        path_um=way,
        speed=speed,
        spread=spread,
        sway_rad=sway,
        helix_hz=hz,
        helix_um=radius,
        a=a,
        bias=bias,
        magnetised=None if fit is None or not known else bool(fit.mean[A] > RESPONDS * fit.sd[A]),
        probability=min(cell.probability for cell in path.seen),
    )
