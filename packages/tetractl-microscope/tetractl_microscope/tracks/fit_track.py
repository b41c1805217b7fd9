"""Estimates the speed, turning rate and bias of each tracked cell, with 95 % intervals.

The filter of `cells.helix` is run over each track. It starts from the most likely of several
helices and headings. A second pass starts from the smoothed state of the first pass, if that is
more likely.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np

from tetractl.core.poses import Floats
from tetractl.tools.likelihood import NORMAL, SampleInterval
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR, Piece, new_cell
from tetractl_microscope.cells.kernels.helix_path import likelihoods, smooth
from tetractl_microscope.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
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
from tetractl_microscope.choice.candidate import RESPONDS
from tetractl_microscope.organisms import Organism
from tetractl_microscope.tracks.field_file import no_field
from tetractl_microscope.tracks.velocities import distance_um, vsl_um_s

START_S = 0.5  # time from which the first heading is computed [s]
START = 5  # minimum number of places for that
# helices and headings to start from: rates as a multiple of the organism's, with the deviation
# among organisms, and angles to the first direction of motion [rad]
RATES = (0.4, 0.6, 0.84, 1.12, 1.4)
RATES_SD = 0.28
ASIDE = (-0.6, 0.0, 0.6)
# noise as a multiple of a live cell's: walks of the speed, and of position and helix
SPEED_WALK = 4.0
PLACE_WALK = 0.5
NO_AXIS = 1e3  # deviation of the body's axis, which a place does not show [rad]
FROM_0 = [FLOW_X, FLOW_Y, DELAY, WAY]  # states that a second pass does not know beforehand
ORDER = 6  # differences of so many successive places leave little of a track but its noise
DIFFERENCED = math.comb(2 * ORDER, ORDER)  # their variance, over that of independent places
MEDIAN_OF_NORMAL = 0.6745  # median absolute deviation of a normal distribution [sd]
NO_FLOW_UM_S = 1e-3  # deviation of a flow, which places alone do not tell from swimming [um/s]
RATE_MIN = 6.9  # minimum rate of images at which a turn of a helix is seen [Hz]
EXACTEST = 1e-3  # minimum deviation of a place in a table, which is rounded [lengths of the cell]
BLOCK_S = 1.5  # duration of the parts of a track from each of which a is estimated [s]
USUAL_BLOCKS = 4.0  # weight of the usual misfit of a table's cells, in blocks
MISFIT_MOST = 5.0  # misfit of a part above which a cell says nothing of the table's others


@dataclass(frozen=True, slots=True)
class CellPath:
    """The track of one cell.

    Attributes:
        number: The track's number in the table.
        times: Times of the images, shape (K,) [s].
        places: Places in these images, shape (K, 2) [um], y upwards.
    """

    number: int
    times: Floats
    places: Floats

    @property
    def rows(self) -> Floats:
        """One row for each image: time, x and y, shape (K, 3) [s, um, um]."""
        return np.column_stack([self.times, self.places])


@dataclass(frozen=True, slots=True)
class CellSummary:
    """The results for one cell, keyed by the names in `cell_tables.QUANTITIES`.

    A cell whose track is too short, or whose images are too rare, is not fitted: its speed and
    response are None, and the numbers of its helix are NaN.

    Attributes:
        cell: The track's number in the table.
        since_s: Time of the first image [s].
        duration_s: Time from the first to the last image, plus one period [s].
        pictures: Number of images.
        speed_um_s: Mean speed along the helix's axis, with its interval [um/s]. None without a
            fit.
        speed_sd_um_s: Standard deviation of the speed over time [um/s].
        vsl_um_s: Velocity along the straight line over one second [um/s]. None for a single image.
        path_um: Distance swum along the helix's axis or, without a fit, through the positions
            [um].
        sway_rad: Amplitude of the body's swing about the axis [rad].
        helix_hz: Frequency of the helix [Hz].
        helix_um: Radius of the helix [um].
        a_rad_s: Turning rate a with its interval [rad/s]. None without a known field.
        bias_rad: Angle from the axis to the magnet with its interval [rad]. None without a field.
        magnetised: Whether a exceeds 0 by RESPONDS standard deviations. None without a field.
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

    def items(self) -> dict[str, Any]:
        """Convert the results to a mapping for JSON.

        An interval becomes a mapping with the keys "value" and "ci95".
        """
        items = asdict(self)
        for name in ("speed_um_s", "a_rad_s", "bias_rad"):
            interval = items[name]
            if interval is not None:
                ends = [interval["low"], interval["high"]]
                items[name] = {"value": interval["value"], "ci95": ends}
        return items


def fit_tracks(
    paths: Sequence[CellPath], organism: Organism, field: FieldRecord | None, period_s: float
) -> tuple[CellSummary, ...]:
    """Estimate speed, helix and response of each tracked cell.

    Args:
        paths: The tracks of one table.
        organism: What swims; its body and helix are the prior of the fit.
        field: The field over time, on the clock of the tracks. None if there was none.
        period_s: Usual time between two images [s]. If images are rarer than RATE_MIN, only the
            velocity along the straight line and the distance are computed.
    """
    fits: list[_Fit | None] = [None] * len(paths)
    if 1 / period_s >= RATE_MIN:
        measured = [_Measured.from_path(path, organism, field) for path in paths]
        fits = [None if table is None else _Fit.fit(table) for table in measured]
    known_fits = [fit for fit in fits if fit is not None]
    squares = sum(min(fit.misfit, MISFIT_MOST * fit.parts) for fit in known_fits)
    usual = max(1.0, squares / max(sum(fit.parts for fit in known_fits), 1))
    return tuple(
        _summary(path, fit, field is not None, usual, period_s)
        for path, fit in zip(paths, fits, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _Measured:
    """The measurements of one cell in K images.

    Attributes:
        values: Places and a meaningless axis, shape (K, 3).
        deviations: Standard deviations of `values`, shape (K, 3).
        pieces: The field as pieces of constant field, shape (P, 3).
        first: Pieces `first[k]` to `first[k + 1]` come before image k, shape (K + 1,).
        mean: State with which the filter starts, shape (n,).
        covariance: Covariance of this state, shape (n, n).
        model: Numbers of the filter's model, shape (12,).
    """

    values: Floats
    deviations: Floats
    pieces: Floats
    first: np.ndarray
    mean: Floats
    covariance: Floats
    model: Floats

    @classmethod
    def from_path(
        cls, path: CellPath, organism: Organism, field: FieldRecord | None
    ) -> Self | None:
        """Return the measurements of a track. None if it has too few places.

        The standard deviation of the places comes from their scatter about a smooth path.

        Args:
            path: The track.
            organism: The organism.
            field: The field. None if it is unknown.
        """
        count = len(path.times)
        if count <= max(ORDER, START):
            return None
        differences = np.diff(path.places, ORDER, axis=0)
        scatter = np.median(np.abs(differences)) / MEDIAN_OF_NORMAL / math.sqrt(DIFFERENCED)
        places_sd = max(float(scatter), EXACTEST * organism.body_um[0])
        deviations = np.tile((places_sd, places_sd, NO_AXIS), (count, 1))
        values = np.column_stack([path.places, np.zeros(count)])
        times = path.times - path.times[0]
        early = slice(0, max(START, int((times <= START_S).sum())))
        (vx, vy), (x, y) = np.polyfit(times[early], path.places[early], 1)
        mean, covariance, model = new_cell(organism, field is not None)
        mean[[X, Y, HEADING, SPEED]] = x, y, math.atan2(vy, vx), math.hypot(vx, vy)
        covariance[[FLOW_X, FLOW_Y], [FLOW_X, FLOW_Y]] = NO_FLOW_UM_S**2
        model[SPEED] *= SPEED_WALK
        model[[X, Y, C, S]] *= PLACE_WALK
        model[[A, BIAS]] = 0.0
        pieces_of = no_field if field is None else field.pieces
        pieces = list[Piece]()
        first = [0, 0]
        for start, end in pairwise(path.times.tolist()):
            pieces += pieces_of(start, end)
            first.append(len(pieces))
        field_of = np.array(pieces).reshape(-1, 3), np.array(first)
        return cls(values, deviations, *field_of, mean, covariance, model)

    def likelihood(self, mean: Floats) -> Floats:
        """Compute the log-likelihood of V variants of the first state (V, n), shape (V,)."""
        totals = np.empty(len(mean))
        likelihoods(
            mean.copy(),
            self.covariance,
            np.tile(self.model, (len(mean), 1)),
            self.values,
            self.deviations,
            self.pieces,
            self.first,
            totals,
        )
        return totals

    def smoothed(
        self, mean: Floats, start: int = 0, end: int | None = None
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Smooth the states of a cell over a range of images.

        Args:
            mean: The first state, shape (n,).
            start: Index of the first image.
            end: Index after the last image. None for all images.

        Returns:
            The last state (n,), its covariance (n, n), all states (K, n), and all bodies (K, 3): x,
            y [um] and axis [rad].
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
            self.model,
            values,
            self.deviations[start:end],
            self.pieces,
            first,
            states,
            bodies,
        )
        return last, covariance, states, bodies


@dataclass(frozen=True, slots=True)
class _Fit:
    """The fit of one cell.

    Attributes:
        mean: The last state, shape (n,).
        sd: Standard deviations of the last state, shape (n,).
        states: The states given all images, shape (K, n).
        bodies: x, y and axis of the body given all images, shape (K, 3).
        misfit: Sum of the squared differences of a in parts of the track from the a of the whole
            track, in their deviations.
        parts: Degrees of freedom of `misfit`.
    """

    mean: Floats
    sd: Floats
    states: Floats
    bodies: Floats
    misfit: float
    parts: int

    @classmethod
    def fit(cls, table: _Measured) -> Self:
        """Fit the states of a cell to the measurements of its track."""
        starts = np.tile(table.mean, (len(RATES) * len(ASIDE), 1))
        starts[:, RATE] *= np.repeat(RATES, len(ASIDE))
        starts[:, HEADING] += np.tile(ASIDE, len(RATES))
        likely = table.likelihood(starts)
        likely -= ((starts[:, RATE] / table.mean[RATE] - 1) / RATES_SD) ** 2 / 2
        mean = starts[likely.argmax()]
        second = table.smoothed(mean)[2][0]
        second[FROM_0] = 0.0
        tried = np.array([mean, second])  # the second pass may lose a cell that turned by itself
        mean = tried[table.likelihood(tried).argmax()]
        last, covariance, states, bodies = table.smoothed(mean)
        parts = max(1, int(table.pieces[:, 0].sum() / BLOCK_S))
        ends = np.linspace(0, len(states), parts + 1).astype(int)
        misfit = 0.0
        for start, end in pairwise(ends.tolist()):
            first_state = states[start] if start else mean
            part, spread, _, _ = table.smoothed(first_state, start, end)
            misfit += (part[A] - last[A]) ** 2 / spread[A, A]
        sd = np.sqrt(np.diagonal(covariance))
        return cls(last, sd, states, bodies, misfit, parts - 1)


def _interval(value: float, sd: float, error: float) -> SampleInterval:
    """Compute a value's 95 % interval from an absolute and a relative standard deviation."""
    value = float(value)
    half = float(NORMAL * math.hypot(sd, error * value))
    return SampleInterval(value, value - half, value + half)


def _summary(
    path: CellPath, fit: _Fit | None, field_known: bool, usual: float, period_s: float
) -> CellSummary:
    """Summarise the fit of a cell.

    Args:
        path: The track.
        fit: The fit. None if there are too few places or images are too rare.
        field_known: Whether the field is known.
        usual: Usual misfit of a part of a track of the table.
        period_s: Usual time between two images [s].
    """
    between = float(path.times[-1] - path.times[0])
    swum_um = distance_um(path.places)
    speed = a = bias = magnetised = None
    spread = sway = hz = radius = math.nan
    if fit is not None:
        states = fit.states
        swum_um = float(fit.mean[WAY])
        misfit = (USUAL_BLOCKS * usual + fit.misfit) / (USUAL_BLOCKS + fit.parts)
        wider = math.sqrt(max(1.0, misfit))
        speed = _interval(swum_um / between, wider * float(fit.sd[WAY]) / between, SPEED_ERROR)
        spread = float(states[:, SPEED].std())
        sway = math.sqrt(2) * float(np.std(states[:, HEADING] - fit.bodies[:, 2]))
        hz = float(np.median(states[:, RATE])) / math.tau
        radius = float(np.median(np.hypot(states[:, C], states[:, S])))
        if field_known:
            a = _interval(fit.mean[A], wider * fit.sd[A], A_ERROR)
            bias = _interval(fit.mean[BIAS], wider * fit.sd[BIAS], 0.0)
            magnetised = bool(fit.mean[A] > RESPONDS * wider * fit.sd[A])
    return CellSummary(
        cell=path.number,
        since_s=float(path.times[0]),
        duration_s=between + period_s,
        pictures=len(path.times),
        speed_um_s=speed,
        speed_sd_um_s=spread,
        vsl_um_s=vsl_um_s(path.times, path.places),
        path_um=swum_um,
        sway_rad=sway,
        helix_hz=hz,
        helix_um=radius,
        a_rad_s=a,
        bias_rad=bias,
        magnetised=magnetised,
    )
