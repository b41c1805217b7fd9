"""The smoothed path of each cell of a film, and its speed, turning rate and bias with 95 %
intervals.

The filter of `lab.cameras.cells.helix` runs over each path again, from the likeliest of some
helices and headings. Newton steps find the likeliest noise of the cell. A second pass starts where
the first found that the cell was; the smoother gives the states given all pictures.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats
from tetractl.experiment.choice import RESPONDS
from tetractl.film.field_file import FieldRecord, no_field
from tetractl.film.follow import CellPath, Followed
from tetractl.lab.cameras.cells.helix import A_ERROR, SPEED_ERROR, Piece, new_cell
from tetractl.lab.cameras.cells.kernels.helix_path import likelihoods, smooth
from tetractl.lab.cameras.cells.kernels.helix_steps import (
    BIAS,
    EXACT,
    FLOW_X,
    FLOW_Y,
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
from tetractl.lab.cameras.cells.readings import MERGED, ODD
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step

START_S, START = 0.5, 5  # time, and least number of pictures, that give the first heading
SHORTEST_S = 2.0  # duration of the shortest path of which a speed is stated [s]
EDGE = 0.6  # distance to the picture's edge, in lengths of the cell, at which it may be cut off
# helices and headings to start from: rates over the organism's, with the deviation among
# organisms, and angles to the first way [rad]
RATES, RATES_SD, ASIDE = (0.4, 0.6, 0.84, 1.12, 1.4), 0.28, (-0.6, 0.0, 0.6)
# usual noise over that of a live cell: walk of the heading; noise of blobs; walks of the speed, and
# of position and helix
USUAL = np.array([1.0, 1.0, 4.0, 0.5])
SPREAD = 1.0  # standard deviation of ln of the noise among cells
ROUNDS = 3
FROM_0 = [FLOW_X, FLOW_Y, WAY]  # states that a second pass does not know beforehand
# deviations of values over those of the fit, since a cell's noise is not the same all the time
WIDER = 1.3
FAR = 3.0  # deviations of a measurement from a smoothed pose at which the measurement is right


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

    A path with fewer than START blobs of its own stays as it is, and has no numbers.
    """
    fits = [_fit(path, followed, field) for path in followed.paths]
    both = list(zip(followed.paths, fits, strict=True))
    paths = tuple(path if fit is None else _smoothed(path, fit) for path, fit in both)
    cells = [
        _summary(path, fit, field is not None, followed.rate_hz)
        for path, fit in zip(paths, fits, strict=True)
    ]
    return replace(followed, paths=paths), tuple(cells)


@dataclass(frozen=True, slots=True)
class _Fit:
    """The fit of one cell: its last state `mean` (n,), standard deviations `sd` (n,) of that, its
    `states` (K, n) and `bodies` (K, 3) given all pictures, and the bodies' `poses` (K, 3), which
    stay within FAR deviations of what was measured.
    """

    mean: Floats
    sd: Floats
    states: Floats
    bodies: Floats
    poses: Floats


def _fit(path: CellPath, followed: Followed, field: FieldRecord | None) -> _Fit | None:
    """Fit the measurements of a path; None if there are too few."""
    measured = _measured(path, followed)
    some = np.flatnonzero(measured[:, 5] < ODD[1])
    if len(some) < START:
        return None
    times = path.times - path.times[0]
    early = some[: max(START, int((times[some] <= times[some[0]] + START_S).sum()))]
    (vx, vy), (x, y) = np.polyfit(times[early], measured[early, :2], 1)
    mean, covariance, model = new_cell(followed.organism, field is not None)
    mean[[X, Y, HEADING, SPEED]] = x, y, math.atan2(vy, vx), math.hypot(vx, vy)
    pieces_of = no_field if field is None else field.pieces
    pieces, first = list[Piece](), [0, 0]
    for start, end in pairwise(path.times.tolist()):
        pieces += pieces_of(start, end)
        first.append(len(pieces))
    values, deviations = map(np.ascontiguousarray, np.hsplit(measured, 2))
    given = values, deviations, np.array(pieces).reshape(-1, 3), np.array(first)

    def likelihood(noise: Floats, means: Floats) -> Floats:
        """Return ln of the likelihood (V,) of V variants of ln of the noise (V, 4) over the usual
        one, and of the first state (V, n).
        """
        found = np.empty(len(noise))
        likelihoods(means.copy(), covariance, _models(model, noise), *given, found)
        return found

    starts = np.tile(mean, (len(RATES) * len(ASIDE), 1))
    starts[:, RATE] *= np.repeat(RATES, len(ASIDE))
    starts[:, HEADING] += np.tile(ASIDE, len(RATES))
    likely = likelihood(np.zeros((len(starts), len(USUAL))), starts)
    likely -= ((starts[:, RATE] / mean[RATE] - 1) / RATES_SD) ** 2 / 2
    begin, noise = starts[likely.argmax()], np.zeros((1, len(USUAL)))
    for _ in range(ROUNDS):
        noise, _ = newton_step(
            lambda tried: likelihood(tried[0], np.tile(begin, (tried.shape[1], 1)))[None],
            noise,
            SPREAD,
        )
    states, bodies = np.empty((len(values), STATES)), np.empty((len(values), 3))
    fitted = _models(model, noise)[0]
    smooth(begin.copy(), covariance, fitted, *given, states, bodies)
    last = states[0].copy()
    last[FROM_0] = 0.0
    spread = smooth(last, covariance, fitted, *given, states, bodies)
    off = values - bodies
    off[:, 2] = (off[:, 2] + math.pi / 2) % math.pi - math.pi / 2
    poses = bodies + np.nan_to_num(off - np.clip(off, -FAR * deviations, FAR * deviations))
    return _Fit(last, np.sqrt(np.diagonal(spread)), states, bodies, poses)


def _measured(path: CellPath, followed: Followed) -> Floats:
    """Return x, y and axis, and their deviations (K, 6), in K pictures; NaN where there is no blob.

    Blobs that the picture's edge may cut off are left out; those that show other cells, too, count
    little.
    """
    measured, shared = (
        np.full((len(path.seen), 6), np.nan),
        MERGED[0] * followed.organism.body_um[0],
    )
    for k, cell in enumerate(path.seen):
        if cell.measured is not None:
            measured[k] = cell.measured
        elif cell.found:
            measured[k] = cell.x, cell.y, cell.axis, shared, shared, MERGED[1]
    span = np.array(followed.size) * followed.um_px
    edge = np.minimum(measured[:, :2], span - measured[:, :2]).min(axis=1)
    lengths = [cell.long_um for cell in path.seen if math.isfinite(cell.long_um)]
    measured[edge < EDGE * np.median(lengths or [0.0])] = np.nan
    return measured


def _models(model: Floats, noise: Floats) -> Floats:
    """Return models (V, 12) like `model` (12,), by ln of the noise (V, 4) over the usual one."""
    found, factors = np.tile(model, (len(noise), 1)), USUAL * np.exp(noise)
    found[:, [HEADING, EXACT, SPEED]] *= factors[:, :3]
    found[:, [X, Y, C, S]] *= factors[:, 3:]
    found[:, [A, BIAS]] = 0.0
    return found


def _smoothed(path: CellPath, fit: _Fit) -> CellPath:
    """Return a path with the poses and states of its fit."""
    rows = np.column_stack([fit.poses, fit.states[:, HEADING]]).tolist()
    seen = tuple(
        replace(cell, x=x, y=y, axis=axis, heading=heading, mean=state)
        for cell, (x, y, axis, heading), state in zip(path.seen, rows, fit.states, strict=True)
    )
    return replace(path, seen=seen)


def _interval(value: float, sd: float, error: float) -> SampleInterval:
    """Return a value's 95 % interval for a standard deviation and a relative one."""
    half = NORMAL * math.hypot(WIDER * sd, error * value)
    return SampleInterval(float(value), float(value - half), float(value + half))


def _summary(path: CellPath, fit: _Fit | None, known: bool, rate_hz: float) -> CellSummary:
    between = float(path.times[-1] - path.times[0])
    count = int(path.frames[-1] - path.frames[0]) + 1
    way = float(np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum())
    speed = a = bias = magnetised = None
    spread = sway = hz = radius = math.nan
    if fit is not None and count >= round(SHORTEST_S * rate_hz):
        states, way = fit.states, float(fit.mean[WAY])
        speed = _interval(way / between, fit.sd[WAY] / between, SPEED_ERROR)
        spread = float(states[:, SPEED].std())
        sway = math.sqrt(2) * float(np.std(states[:, HEADING] - fit.bodies[:, 2]))
        hz = float(np.median(states[:, RATE])) / math.tau
        radius = float(np.median(np.hypot(states[:, C], states[:, S])))
        if known:
            a = _interval(fit.mean[A], fit.sd[A], A_ERROR)
            bias = _interval(fit.mean[BIAS], fit.sd[BIAS], 0.0)
            magnetised = bool(fit.mean[A] > RESPONDS * WIDER * fit.sd[A])
    return CellSummary(
        cell=path.identity,
        since_s=float(path.times[0]),
        seconds=count / rate_hz,
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
