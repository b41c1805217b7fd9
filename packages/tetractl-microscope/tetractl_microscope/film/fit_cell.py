"""The smoothed path of each cell of a film, and its speed, turning rate and bias with 95 %
intervals.

The filter of `cells.helix` runs over each path again, from the likeliest of some
helices and headings. Newton steps find the likeliest noise of the cell. A second pass starts where
the first found that the cell was, if that is likelier; the smoother gives the states given all
pictures.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.replay.identification.fit import NORMAL, SampleInterval, newton_step
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR, Piece, new_cell
from tetractl_microscope.cells.kernels.helix_path import likelihoods, smooth
from tetractl_microscope.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
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
from tetractl_microscope.cells.readings import MERGED
from tetractl_microscope.choice.candidate import RESPONDS
from tetractl_microscope.film.field_file import no_field
from tetractl_microscope.film.follow import Followed
from tetractl_microscope.film.kinematics import vsl_um_s, way_um
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.film.who import CellPath
from tetractl_microscope.organisms import Organism

START_S = 0.5  # time that gives the first heading
START = 5  # least number of pictures that do
SHORTEST_S = 2.0  # duration of the shortest path of which a speed is stated [s]
# distance to the picture's edge, in lengths of the cell, at which it may be cut off: if it has a
# blob of its size, and if not
EDGE_OWN = 0.4
EDGE = 0.6
# helices and headings to start from: rates over the organism's, with the deviation among
# organisms, and angles to the first way [rad]
RATES = (0.4, 0.6, 0.84, 1.12, 1.4)
RATES_SD = 0.28
ASIDE = (-0.6, 0.0, 0.6)
# usual noise over that of a live cell: walk of the heading; noise of blobs; walks of the speed, and
# of position and helix
USUAL = np.array([1.0, 1.0, 4.0, 0.5])
# blobs whose axis is further from the way over this time before and after [s], in the median
# [rad], are too round, or too far out of focus, to show the cell's axis
AROUND_S = 0.1
ASTRAY = 0.6
NO_AXIS = 1e3  # deviation of such an axis [rad]
SPREAD = 1.0  # standard deviation of ln of the noise among cells
ROUNDS = 3
FROM_0 = [FLOW_X, FLOW_Y, DELAY, WAY]  # states that a second pass does not know beforehand
ORDER = 6  # differences of so many successive places leave little of a path but its noise
DIFFERENCED = math.comb(2 * ORDER, ORDER)  # their variance, over that of independent places
MEDIAN_OF_NORMAL = 0.6745  # median absolute deviation of a normal distribution [sd]
NO_FLOW_UM_S = 1e-3  # deviation of a flow, which places alone do not tell from swimming [um/s]
RATE_MIN = 6.9  # rate of pictures of tracks below which a turn of a helix is too short [Hz]
EXACTEST = 1e-3  # least deviation of a place in a table [lengths of the cell]: it is rounded
BLOCK_S = 1.5  # duration of the parts of a path that each give a [s]
USUAL_BLOCKS = 4.0  # weight of the usual misfit of a film's cells, in blocks
FAR = 3.0  # deviations of a measurement from a smoothed pose at which the measurement is right
MISFIT_MOST = 5.0  # misfit of a part above which a cell says nothing of the film's others


@dataclass(frozen=True, slots=True)
class CellSummary:
    """The results for one cell, by the keys of `results.cell_tables.QUANTITIES`.

    `duration_s` is the time from its first to its last picture, with the period of the last one.
    `speed_um_s` is the mean over this time of the speed along the helix's axis in the medium, with
    the interval of this mean; `speed_sd_um_s` is the standard deviation of the speed over time.
    `path_um` is the length of the way along the helix's axis, `sway_rad` the amplitude of the
    body's swing about it; `helix_hz` and `helix_um` are frequency and radius of the helix.
    `a_rad_s` and `bias_rad` are None without a known field; `magnetised` is whether a exceeds 0 by
    RESPONDS standard deviations. `sure` is whether all its pictures surely show the same cell.
    """

    cell: int
    since_s: float
    duration_s: float
    pictures: int
    speed_um_s: SampleInterval | None
    speed_sd_um_s: float
    vsl_um_s: float | None
    path_um: float
    sway_rad: float
    helix_hz: float
    helix_um: float
    a_rad_s: SampleInterval | None
    bias_rad: SampleInterval | None
    magnetised: bool | None
    sure: bool

    def items(self) -> dict[str, Any]:
        """Return the results as records have them: an interval by its value and its ends."""
        items = asdict(self)
        for name in ("speed_um_s", "a_rad_s", "bias_rad"):
            interval = items[name]
            if interval is not None:
                ends = [interval["low"], interval["high"]]
                items[name] = {"value": interval["value"], "ci95": ends}
        return items


def fit_cells(
    followed: Followed, field: FieldRecord | None
) -> tuple[Followed, tuple[CellSummary, ...]]:
    """Return the film's cells with smoothed paths, and the results for each cell.

    A path with fewer than START blobs of its own stays as it is, and has no numbers.
    """
    measured = [_Measured.of(path, followed, field) for path in followed.paths]
    exact = _exact([table for table in measured if table is not None])
    paths, cells = _fitted(followed.paths, measured, exact, field, followed.timing)
    return replace(followed, paths=paths), cells


def fit_tracks(
    paths: Sequence[CellPath],
    organism: Organism,
    field: FieldRecord | None,
    timing: PictureTimes,
) -> tuple[CellSummary, ...]:
    """Return the results for each cell of the tracks of another program, which show no bodies; VSL
    is that of the places given; no speed and helix if pictures are rarer than RATE_MIN."""
    measured: list[_Measured | None] = [None] * len(paths)
    if timing.nominal_hz >= RATE_MIN:
        measured = [_Measured.of_track(path, organism, field) for path in paths]
    _, cells = _fitted(paths, measured, np.ones(3), field, timing)
    return tuple(
        replace(cell, vsl_um_s=vsl_um_s(path.times, path.places))
        for cell, path in zip(cells, paths, strict=True)
    )


def _fitted(
    seen_paths: Sequence[CellPath],
    measured: "Sequence[_Measured | None]",
    exact: Floats,
    field: FieldRecord | None,
    timing: PictureTimes,
) -> tuple[tuple[CellPath, ...], tuple[CellSummary, ...]]:
    """Return smoothed paths and results of cells that are measured `exact` (3,) times as well as
    stated."""
    fits = [None if table is None else _Fit.of(table, exact) for table in measured]
    known_fits = [fit for fit in fits if fit is not None]
    squares = sum(min(fit.misfit, MISFIT_MOST * fit.parts) for fit in known_fits)
    usual = max(1.0, squares / max(sum(fit.parts for fit in known_fits), 1))
    paths = [
        path if fit is None else fit.smoothed(path)
        for path, fit in zip(seen_paths, fits, strict=True)
    ]
    among = (
        float(np.std([fit.states[:, SPEED].mean() for fit in known_fits])) if known_fits else 0.0
    )
    cells = [
        _summary(path, fit, field is not None, usual, among, timing)
        for path, fit in zip(paths, fits, strict=True)
    ]
    return tuple(paths), tuple(cells)


@dataclass(frozen=True, slots=True)
class _Measured:
    """The measurements of one cell in K pictures: `values` (K, 3), NaN where it has no blob, and
    their `deviations`; `is_own` is whether the blob shows just this cell. Pieces `first[k]` to
    `first[k + 1]` of the field (P, 3) are before picture k. The filter of `model` (12,) starts with
    `mean` (n,) and `covariance` (n, n).
    """

    values: Floats
    deviations: Floats
    is_own: np.ndarray
    pieces: Floats
    first: np.ndarray
    mean: Floats
    covariance: Floats
    model: Floats

    @classmethod
    def of(cls, path: CellPath, followed: Followed, field: FieldRecord | None) -> Self | None:
        """Return the measurements of a path; None if there are too few.

        Blobs that the picture's edge may cut off are left out; those that show other cells, too,
        count little. The axis of a cell's blobs counts little if it is not along the cell's way.
        """
        body = followed.organism.body_um[0]
        shared_um = MERGED[0] * body
        measured = _measurements(path, shared_um)
        span = np.array(followed.size) * followed.um_px
        edge = np.minimum(measured[:, :2], span - measured[:, :2]).min(axis=1)
        lengths = [cell.long_um for cell in path.sightings if math.isfinite(cell.long_um)]
        is_own = measured[:, 3] < shared_um
        cut = edge < np.where(is_own, EDGE_OWN, EDGE) * np.median(lengths or [0.0])
        measured[cut] = np.nan
        is_own = is_own & ~cut
        if not _shows_axis(path.times, measured, is_own):
            measured[:, 5] = NO_AXIS
        return cls._of_values(path.times, measured, is_own, followed.organism, field)

    @classmethod
    def of_track(cls, path: CellPath, organism: Organism, field: FieldRecord | None) -> Self | None:
        """Return the measurements of a path of places alone; None if there are too few.

        Their deviation is that by which they scatter about a smooth path.
        """
        if len(path.times) <= ORDER:
            return None
        least = EXACTEST * organism.body_um[0]
        differences = np.diff(path.places, ORDER, axis=0)
        scatter = np.median(np.abs(differences)) / MEDIAN_OF_NORMAL / math.sqrt(DIFFERENCED)
        places_sd = max(float(scatter), least)
        count = len(path.times)
        deviations = np.tile((places_sd, places_sd, NO_AXIS), (count, 1))
        measured = np.column_stack([path.places, np.zeros(count), deviations])
        table = cls._of_values(path.times, measured, np.ones(count, bool), organism, field)
        if table is not None:
            table.covariance[[FLOW_X, FLOW_Y], [FLOW_X, FLOW_Y]] = NO_FLOW_UM_S**2
        return table

    @classmethod
    def _of_values(
        cls,
        seconds: Floats,
        measured: Floats,
        is_own: np.ndarray,
        organism: Organism,
        field: FieldRecord | None,
    ) -> Self | None:
        """Return what was measured (K, 6) at times (K,) [s], with the filter's start; None if there
        are too few blobs of the cell's own."""
        own_rows = np.flatnonzero(is_own)
        if len(own_rows) < START:
            return None
        times = seconds - seconds[0]
        early = own_rows[: max(START, int((times[own_rows] <= times[own_rows[0]] + START_S).sum()))]
        (vx, vy), (x, y) = np.polyfit(times[early], measured[early, :2], 1)
        mean, covariance, model = new_cell(organism, field is not None)
        mean[[X, Y, HEADING, SPEED]] = x, y, math.atan2(vy, vx), math.hypot(vx, vy)
        pieces_of = no_field if field is None else field.pieces
        pieces = list[Piece]()
        first = [0, 0]
        for start, end in pairwise(seconds.tolist()):
            pieces += pieces_of(start, end)
            first.append(len(pieces))
        values, deviations = map(np.ascontiguousarray, np.hsplit(measured, 2))
        field_of = np.array(pieces).reshape(-1, 3), np.array(first)
        return cls(values, deviations, is_own, *field_of, mean, covariance, model)

    def models(self, noise: Floats) -> Floats:
        """Return the numbers (V, 12) of models by ln of the noise (V, 4) over the usual one."""
        models = np.tile(self.model, (len(noise), 1))
        models[:, [HEADING, EXACT, SPEED]] *= (USUAL * np.exp(noise))[:, :3]
        models[:, [X, Y, C, S]] *= (USUAL * np.exp(noise))[:, 3:]
        models[:, [A, BIAS]] = 0.0
        return models

    def likelihood(self, noise: Floats, mean: Floats) -> Floats:
        """Return ln of the likelihood (V,) of V variants of ln of the noise (V, 4) over the usual
        one, and of the first state (V, n).
        """
        totals = np.empty(len(noise))
        likelihoods(
            mean.copy(),
            self.covariance,
            self.models(noise),
            self.values,
            self.deviations,
            self.pieces,
            self.first,
            totals,
        )
        return totals

    def smoothed(
        self, noise: Floats, mean: Floats, start: int = 0, end: int | None = None
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the last state (n,), its covariance (n, n), and all states (K, n) and bodies
        (K, 3) given all pictures from `start` to `end`, for ln of the noise (4,) over the usual one
        and a first state (n,).
        """
        last = mean.copy()
        values = self.values[start:end]
        first = self.first[start : end and end + 1].copy()
        first[0] = first[1]
        states = np.empty((len(values), STATES))
        bodies = np.empty((len(values), 3))
        covariance = smooth(
            last,
            self.covariance,
            self.models(noise[None])[0],
            values,
            self.deviations[start:end],
            self.pieces,
            first,
            states,
            bodies,
        )
        return last, covariance, states, bodies


def _measurements(path: CellPath, shared_um: float) -> Floats:
    """Return x, y [um] and axis [rad] of a path's blobs and their deviations (K, 6), NaN where it
    has none; the place of a blob that shows other cells, too, deviates by `shared_um`.
    """
    measured = np.full((len(path.sightings), 6), np.nan)
    for k, cell in enumerate(path.sightings):
        if cell.measured is not None:
            measured[k] = cell.measured
        elif cell.has_blob:
            measured[k] = cell.x, cell.y, cell.axis, shared_um, shared_um, MERGED[1]
    return measured


def _shows_axis(times: Floats, measured: Floats, is_own: np.ndarray) -> bool:
    """Return whether the axes of a cell's own blobs are along its way, in the median."""
    before, after = _around(times, AROUND_S)
    way = measured[after, :2] - measured[before, :2]
    off = measured[:, 2] - np.arctan2(way[:, 1], way[:, 0])
    counts = is_own & (before < after) & np.isfinite(off)
    aside = np.abs(np.arcsin(np.sin(off)))[counts]
    return not len(aside) or bool(np.median(aside) <= ASTRAY)


def _around(times: Floats, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each of a path's times (K,), the indices of pictures as many before as after,
    which are this time away, at least one; the own index twice where there are none.
    """
    index = np.arange(len(times))
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else seconds
    reach = max(seconds, step) + step / 2
    count = np.minimum(
        index - np.searchsorted(times, times - reach),
        np.searchsorted(times, times + reach, side="right") - 1 - index,
    )
    return index - count, index + count


def _exact(measured: Sequence[_Measured]) -> Floats:
    """Return the factors (3,) from the stated deviations of cells' own blobs to those of the
    film's, at most 1 for places, by differences of successive blobs, in which a smooth path leaves
    little.
    """
    differences = [np.zeros((0, 3))]
    for table in measured:
        values = table.values.copy()
        values[:, 2] = np.unwrap(np.nan_to_num(values[:, 2]), period=math.pi)
        values[~table.is_own | (table.deviations[:, 2] == NO_AXIS)] = np.nan
        differences.append(np.diff(values, ORDER, axis=0) / table.deviations[ORDER:])
    off = np.abs(np.concatenate(differences)) / math.sqrt(DIFFERENCED)
    off = off[np.isfinite(off).all(axis=1)]
    if not len(off):
        return np.ones(3)
    place = np.median(off[:, :2]) / MEDIAN_OF_NORMAL
    axis = np.median(off[:, 2]) / MEDIAN_OF_NORMAL
    return np.array([min(place, 1.0), min(place, 1.0), axis])


@dataclass(frozen=True, slots=True)
class _Fit:
    """The fit of one cell: its last state `mean` (n,), standard deviations `sd` (n,) of that, and
    the `states` (K, n) and `bodies` (K, 3) given all pictures; `misfit` is the sum of the squared
    differences of a in parts of the path from the a of the whole path, in their deviations, and
    `parts` its degrees of freedom.
    """

    measured: _Measured
    mean: Floats
    sd: Floats
    states: Floats
    bodies: Floats
    misfit: float
    parts: int

    @classmethod
    def of(cls, table: _Measured, exact: Floats) -> Self:
        """Fit the measurements of a path, whose deviations are `exact` (3,) times those stated."""
        table.deviations[table.is_own] *= exact
        starts = np.tile(table.mean, (len(RATES) * len(ASIDE), 1))
        starts[:, RATE] *= np.repeat(RATES, len(ASIDE))
        starts[:, HEADING] += np.tile(ASIDE, len(RATES))
        usual_noise = np.zeros((len(starts), len(USUAL)))
        likely = table.likelihood(usual_noise, starts)
        likely -= ((starts[:, RATE] / table.mean[RATE] - 1) / RATES_SD) ** 2 / 2
        mean = starts[likely.argmax()]
        noise = np.zeros((1, len(USUAL)))

        def likelihood(tried: Floats) -> Floats:
            return table.likelihood(tried[0], np.tile(mean, (tried.shape[1], 1)))[None]

        for _ in range(ROUNDS):
            noise, _ = newton_step(likelihood, noise, SPREAD)
        second = table.smoothed(noise[0], mean)[2][0]
        second[FROM_0] = 0.0
        tried = np.array([mean, second])  # the second pass may lose a cell that turned by itself
        mean = tried[table.likelihood(np.tile(noise, (2, 1)), tried).argmax()]
        last, covariance, states, bodies = table.smoothed(noise[0], mean)
        parts = max(1, int(table.pieces[:, 0].sum() / BLOCK_S))
        ends = np.linspace(0, len(states), parts + 1).astype(int)
        misfit = 0.0
        for start, end in pairwise(ends.tolist()):
            first_state = states[start] if start else mean
            part, spread, _, _ = table.smoothed(noise[0], first_state, start, end)
            misfit += (part[A] - last[A]) ** 2 / spread[A, A]
        sd = np.sqrt(np.diagonal(covariance))
        return cls(table, last, sd, states, bodies, misfit, parts - 1)

    def smoothed(self, path: CellPath) -> CellPath:
        """Return the path with the smoothed poses, which stay within FAR deviations of what was
        measured.
        """
        off = self.measured.values - self.bodies
        off[:, 2] = (off[:, 2] + math.pi / 2) % math.pi - math.pi / 2
        reach = FAR * self.measured.deviations
        poses = self.bodies + np.nan_to_num(off - np.clip(off, -reach, reach))
        rows = np.column_stack([poses, self.states[:, HEADING]]).tolist()
        cells = tuple(
            replace(cell, x=x, y=y, axis=axis, heading=heading, mean=state).on_blob()
            for cell, (x, y, axis, heading), state in zip(
                path.sightings, rows, self.states, strict=True
            )
        )
        return replace(path, sightings=cells)


def _interval(value: float, sd: float, error: float) -> SampleInterval:
    """Return a value's 95 % interval for a standard deviation and a relative one."""
    value = float(value)
    half = float(NORMAL * math.hypot(sd, error * value))
    return SampleInterval(value, value - half, value + half)


def _summary(
    path: CellPath,
    fit: _Fit | None,
    field_known: bool,
    usual: float,
    among: float,
    timing: PictureTimes,
) -> CellSummary:
    between = float(path.times[-1] - path.times[0])
    seconds = timing.duration(int(path.frames[0]), int(path.frames[-1]))
    way = way_um(path.places)
    speed = a = bias = magnetised = None
    spread = sway = hz = radius = math.nan
    if fit is not None and seconds >= SHORTEST_S - 0.5 / timing.rate_hz:
        states = fit.states
        way = float(fit.mean[WAY])
        misfit = (USUAL_BLOCKS * usual + fit.misfit) / (USUAL_BLOCKS + fit.parts)
        wider = math.sqrt(max(1.0, misfit))
        # the part of the way that may be another cell's, whose speed differs
        doubt = among * float(np.mean([1 - cell.probability for cell in path.sightings]))
        sd = math.hypot(wider * float(fit.sd[WAY]) / between, doubt)
        speed = _interval(way / between, sd, SPEED_ERROR)
        spread = float(states[:, SPEED].std())
        sway = math.sqrt(2) * float(np.std(states[:, HEADING] - fit.bodies[:, 2]))
        hz = float(np.median(states[:, RATE])) / math.tau
        radius = float(np.median(np.hypot(states[:, C], states[:, S])))
        if field_known:
            a = _interval(fit.mean[A], wider * fit.sd[A], A_ERROR)
            bias = _interval(fit.mean[BIAS], wider * fit.sd[BIAS], 0.0)
            magnetised = bool(fit.mean[A] > RESPONDS * wider * fit.sd[A])
    return CellSummary(
        cell=path.identity,
        since_s=float(path.times[0]),
        duration_s=seconds,
        pictures=len(path.sightings),
        speed_um_s=speed,
        speed_sd_um_s=spread,
        vsl_um_s=vsl_um_s(path.times, path.places),
        path_um=way,
        sway_rad=sway,
        helix_hz=hz,
        helix_um=radius,
        a_rad_s=a,
        bias_rad=bias,
        magnetised=magnetised,
        sure=all(cell.sure for cell in path.sightings),
    )
