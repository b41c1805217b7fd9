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
from tetractl.experiment.choice import RESPONDS
from tetractl.film.field_file import FieldRecord, no_field
from tetractl.film.follow import CellPath, Followed
from tetractl.lab.cameras.cells.helix import (
    A_ERROR,
    HELIX,
    SPEED_ERROR,
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
    SWAY,
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
# deviations of x, y [um], axis [rad] for a cell whose blob shows other cells, too
SHARED = 8.0, 8.0, 10.0
EDGE = 0.6  # distance to the picture's edge, in lengths of the cell, at which it may be cut off
# helices and headings to start from: rates [rad/s], with the deviation among organisms, and angles
# to the first way [rad]
RATES, RATES_SD, ASIDE = 2 * math.pi * np.array([1.0, 1.5, 2.1, 2.8, 3.5]), 4.4, (-0.6, 0.0, 0.6)
# usual noise: walk of the heading [rad/sqrt(s)]; noise of blobs, relative to that stated; walks
# of the speed [um/s per sqrt(s)], and of position and helix [um per sqrt(s)]; turning that the
# field does not explain, relative to TURN_KNOWN or TURN_UNKNOWN
USUAL = np.array([0.07, 1.0, 8.0, 2.0, 1.0])
SPREAD = 1.0  # standard deviation of ln of the noise among cells
RATE_WALK = 0.3  # walk of the helix's rate [rad/s per sqrt(s)]
ROUNDS = 3
CONSTANT = [RATE, A, BIAS, DELAY, SWAY]
BLOCK_S = 1.5  # duration of the parts of a path that each give a [s]
USUAL_BLOCKS = 4.0  # weight of the usual misfit of a film's cells, in blocks
FAR = 3.0  # deviations of a measurement from a smoothed pose at which the measurement is right
MISFIT_MOST = 5.0  # misfit of a part above which a cell says nothing of the film's others


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
    span, known = np.array(followed.size) * followed.um_px, field is not None
    counts = [int(path.frames[-1] - path.frames[0]) + 1 for path in followed.paths]
    fits = [
        _Fit.of(path, field, span) if count >= round(SHORTEST_S * followed.rate_hz) else None
        for path, count in zip(followed.paths, counts, strict=True)
    ]
    misfits = np.array([fit.misfit for fit in fits if fit is not None] or [(0.0, 0)])
    squares = np.minimum(misfits[:, 0], MISFIT_MOST * misfits[:, 1])
    usual = max(1.0, float(squares.sum() / max(misfits[:, 1].sum(), 1)))
    paths, cells = [], []
    for path, count, fit in zip(followed.paths, counts, fits, strict=True):
        paths.append(path if fit is None else fit.smoothed(path))
        cells.append(_summary(paths[-1], count / followed.rate_hz, fit, known, usual))
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

        Blobs that the picture's edge may cut off are left out; those that show other cells, too,
        count little.
        """
        measured = np.full((len(path.seen), 6), np.nan)
        for k, cell in enumerate(path.seen):
            if cell.measured is not None:
                measured[k] = cell.measured
            elif cell.found:
                measured[k] = cell.x, cell.y, cell.axis, *SHARED
        edge = np.minimum(measured[:, :2], span - measured[:, :2]).min(axis=1)
        long = np.nan_to_num(np.nanmedian([cell.long_um for cell in path.seen]))
        measured[edge < EDGE * long] = np.nan
        own = np.flatnonzero(measured[:, 3] < SHARED[0])
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

    def smoothed(
        self, noise: Floats, mean: Floats, start: int = 0, end: int | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Return the last state (n,), its covariance (n, n), and all states (K, n) given all
        pictures from `start` to `end`, for ln of the noise (5,) over the usual one and a first
        state (n,).
        """
        growth, turn_sd, exact = (each[0] for each in self._grown(noise[None]))
        last, covariance = mean.copy(), self.covariance.copy()
        values, first = self.values[start:end], self.first[start : end and end + 1].copy()
        first[0] = first[1]
        states = np.empty((len(values), STATES))
        given = values, self.deviations[start:end], self.pieces, first
        smooth(last, covariance, *given, growth, turn_sd, exact, states)
        return last, covariance, states

    def misfit(self, noise: Floats, states: Floats, a: float, seconds: float) -> tuple[float, int]:
        """Return the sum of the squared differences of a in parts of a path from the a of the whole
        path, in their deviations, and its degrees of freedom.
        """
        parts = max(1, int(seconds / BLOCK_S))
        cuts = np.linspace(0, len(states), parts + 1).astype(int).tolist()
        found = 0.0
        for start, end in pairwise(cuts):
            mean = states[start].copy()
            last, covariance, _ = self.smoothed(noise, mean, start, end)
            found += (last[A] - a) ** 2 / covariance[A, A]
        return found, parts - 1

    def _grown(self, noise: Floats) -> tuple[Floats, Floats, Floats]:
        walk, exact, unsteady, place, turn = (USUAL * np.exp(noise)).T
        none = np.zeros(len(noise))
        constant = none + RATE_WALK, none, none
        growth = np.column_stack([place, place, walk, unsteady, place, place, *constant])
        return growth, turn * self.turn_sd, exact


@dataclass(frozen=True, slots=True)
class _Fit:
    """The fit of one cell: its last state `mean` (n,), standard deviations `sd` (n,) of that, and
    the `states` (K, n) given all pictures; `measured` (K, 6) are the measurements and their
    deviations, `misfit` as in `_Measured.misfit`.
    """

    mean: Floats
    sd: Floats
    states: Floats
    measured: Floats
    misfit: tuple[float, int]

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
        seconds = float(path.times[-1] - path.times[0])
        misfit = table.misfit(noise[0], states, float(last[A]), seconds)
        measured = np.hstack([table.values, table.deviations])
        return cls(last, np.sqrt(np.diagonal(covariance)), states, measured, misfit)

    def smoothed(self, path: CellPath) -> CellPath:
        """Return the path with the smoothed poses, which stay within FAR deviations of what was
        measured or, without that, shown.
        """
        states = self.states
        cos, sin = np.cos(states[:, HEADING]), np.sin(states[:, HEADING])
        poses = np.column_stack(
            [
                states[:, X] - states[:, C] * sin,
                states[:, Y] + states[:, C] * cos,
                states[:, HEADING] - _sway(states),
            ]
        )
        shown = np.array([(cell.x, cell.y, cell.axis, *SHARED) for cell in path.seen])
        near = np.where(np.isfinite(self.measured), self.measured, shown)
        off = near[:, :3] - poses
        off[:, 2] = (off[:, 2] + math.pi / 2) % math.pi - math.pi / 2
        reach = FAR * near[:, 3:]
        poses += off - np.clip(off, -reach, reach)
        rows = np.column_stack([poses, states[:, HEADING]]).tolist()
        seen = tuple(
            replace(cell, x=x, y=y, axis=axis, heading=heading, mean=state)
            for cell, (x, y, axis, heading), state in zip(path.seen, rows, states, strict=True)
        )
        return replace(path, seen=seen)


def _sway(states: Floats) -> Floats:
    """Return the angle (K,) from the body's axis to the heading in each state (K, n) [rad]."""
    return states[:, SWAY] * np.arctan2(states[:, RATE] * states[:, S], states[:, SPEED])


def _interval(value: float, sd: float, error: float) -> SampleInterval:
    """Return a value's 95 % interval for a standard deviation and a relative one."""
    half = NORMAL * math.hypot(sd, error * value)
    return SampleInterval(float(value), float(value - half), float(value + half))


def _summary(
    path: CellPath, seconds: float, fit: _Fit | None, known: bool, usual: float
) -> CellSummary:
    between = float(path.times[-1] - path.times[0])
    way = float(np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum())
    speed = a = bias = magnetised = None
    spread = sway = hz = radius = math.nan
    if fit is not None:
        states, way = fit.states, float(fit.mean[WAY])
        squares, parts = fit.misfit
        wider = math.sqrt(max(1.0, (USUAL_BLOCKS * usual + squares) / (USUAL_BLOCKS + parts)))
        speed = _interval(way / between, wider * fit.sd[WAY] / between, SPEED_ERROR)
        spread = float(states[:, SPEED].std())
        sway = math.sqrt(2) * float(np.std(_sway(states)))
        hz = float(np.median(states[:, RATE])) / (2 * math.pi)
        radius = float(np.median(np.hypot(states[:, C], states[:, S])))
        if known:
            a = _interval(fit.mean[A], wider * fit.sd[A], A_ERROR)
            bias = _interval(fit.mean[BIAS], wider * fit.sd[BIAS], 0.0)
            magnetised = bool(fit.mean[A] > RESPONDS * wider * fit.sd[A])
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
        magnetised=magnetised,
        probability=min(cell.probability for cell in path.seen),
    )
