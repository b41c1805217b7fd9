"""Estimates the speed, turning rate and heading bias of each tracked cell, with 95 % intervals.

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
from tetractl.tools.likelihood import Z_95, SampleInterval
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.helix import A_ERROR, SPEED_ERROR, Piece, new_cell
from tetractl_microscope.cells.kernels.helix_path import log_likelihoods_of, smooth
from tetractl_microscope.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
    FLOW_X,
    FLOW_Y,
    HEADING,
    PATH_LENGTH,
    RATE,
    SPEED,
    STATE_SIZE,
    A,
    C,
    S,
    X,
    Y,
)
from tetractl_microscope.choice.candidate import RESPONDS
from tetractl_microscope.organisms import Organism
from tetractl_microscope.tracks.field_file import no_field
from tetractl_microscope.tracks.velocities import compute_vsl_um_s, measure_path_um

START_DURATION_S = 0.5  # duration of the start of a track, from which its first heading is computed
START_PLACES_MIN = 5  # minimum number of places in the start of a track
# The fit starts from several helices and headings.
RATE_FACTORS = (0.4, 0.6, 0.84, 1.12, 1.4)  # rates of the helix, as multiples of the organism's
RATE_FACTOR_SD = 0.28  # standard deviation of this multiple among cells
HEADING_OFFSETS = (-0.6, 0.0, 0.6)  # headings, as angles to the first direction of motion [rad]
# Process noise of a track, as a multiple of the noise of a live cell.
SPEED_GROWTH_FACTOR = 4.0  # of the speed
PLACE_GROWTH_FACTOR = 0.5  # of the position and the helix
UNKNOWN_AXIS_SD = 1e3  # standard deviation of the body's axis, which a place does not show [rad]
# States that start at 0 again in the second pass.
RESET_STATES = [FLOW_X, FLOW_Y, DELAY, PATH_LENGTH]
# Differences of this order between successive places contain little of a track but its noise.
DIFFERENCE_ORDER = 6
# Variance of these differences, relative to the variance of independent places.
DIFFERENCE_VARIANCE = math.comb(2 * DIFFERENCE_ORDER, DIFFERENCE_ORDER)
NORMAL_MAD = 0.6745  # median absolute deviation of a normal distribution [sd]
# Standard deviation of a flow [um/s]. Places alone do not distinguish a flow from swimming.
FLOW_SD_UM_S = 1e-3
IMAGE_RATE_MIN_HZ = 6.9  # minimum rate of images at which the turns of a helix are visible
# Minimum standard deviation of a place in a table, because tables are rounded [body lengths].
PLACE_SD_MIN = 1e-3
BLOCK_S = 1.5  # duration of the parts of a track, in each of which a is estimated
USUAL_MISFIT_WEIGHT = 4.0  # weight of the usual misfit of a table's cells, in parts of a track
# Maximum misfit of a part that one cell contributes to the usual misfit of a table.
MISFIT_MAX = 5.0


@dataclass(frozen=True, slots=True)
class CellPath:
    """The track of one cell.

    Attributes:
        number: Number of the track in the table.
        times: Times of the images, shape (K,) [s].
        places: Positions in these images, shape (K, 2) [um], with y pointing up.
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
    """The speed, helix and response that were estimated for one cell.

    The attributes have the names of the keys in `cell_tables.QUANTITIES`.

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
        summary_by_key = asdict(self)
        for name in ("speed_um_s", "a_rad_s", "bias_rad"):
            interval = summary_by_key[name]
            if interval is not None:
                bounds = [interval["low"], interval["high"]]
                summary_by_key[name] = {"value": interval["value"], "ci95": bounds}
        return summary_by_key


def fit_tracks(
    paths: Sequence[CellPath], organism: Organism, field: FieldRecord | None, period_s: float
) -> tuple[CellSummary, ...]:
    """Estimate speed, helix and response of each tracked cell.

    Args:
        paths: The tracks of one table.
        organism: What swims; its body and helix are the prior of the fit.
        field: The field over time, on the clock of the tracks. None if there was none.
        period_s: Usual time between two images [s]. If images are rarer than IMAGE_RATE_MIN_HZ,
            only the velocity along the straight line and the distance are computed.
    """
    cell_fits: list[_Fit | None] = [None] * len(paths)
    if 1 / period_s >= IMAGE_RATE_MIN_HZ:
        measured_tracks = [_MeasuredTrack.from_path(path, organism, field) for path in paths]
        cell_fits = [None if track is None else _Fit.fit(track) for track in measured_tracks]
    known_fits = [fit for fit in cell_fits if fit is not None]
    misfit_sum = sum(min(fit.misfit, MISFIT_MAX * fit.parts) for fit in known_fits)
    usual_misfit = max(1.0, misfit_sum / max(sum(fit.parts for fit in known_fits), 1))
    return tuple(
        _summarise(path, fit, field is not None, usual_misfit, period_s)
        for path, fit in zip(paths, cell_fits, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _MeasuredTrack:
    """The measurements of one cell in K images.

    Attributes:
        values: Places and a meaningless axis, shape (K, 3).
        deviations: Standard deviations of `values`, shape (K, 3).
        pieces: The field as pieces of constant field, shape (P, 3).
        piece_starts: Pieces `piece_starts[k]` to `piece_starts[k + 1]` come before image k, shape
            (K + 1,).
        mean: State with which the filter starts, shape (n,).
        covariance: Covariance of this state, shape (n, n).
        model: Numbers of the filter's model, shape (12,).
    """

    values: Floats
    deviations: Floats
    pieces: Floats
    piece_starts: np.ndarray
    mean: Floats
    covariance: Floats
    model: Floats

    @classmethod
    def from_path(
        cls, path: CellPath, organism: Organism, field: FieldRecord | None
    ) -> Self | None:
        """Compute the measurements of a track and the first state of the filter.

        The standard deviation of the places comes from their scatter about a smooth path.

        Args:
            path: The track.
            organism: The organism.
            field: The field over time. None if it is unknown.

        Returns:
            The measurements. None if the track has too few positions.
        """
        n_images = len(path.times)
        if n_images <= max(DIFFERENCE_ORDER, START_PLACES_MIN):
            return None
        differences = np.diff(path.places, DIFFERENCE_ORDER, axis=0)
        scatter = np.median(np.abs(differences)) / NORMAL_MAD / math.sqrt(DIFFERENCE_VARIANCE)
        place_sd_um = max(float(scatter), PLACE_SD_MIN * organism.body_um[0])
        deviations = np.tile((place_sd_um, place_sd_um, UNKNOWN_AXIS_SD), (n_images, 1))
        values = np.column_stack([path.places, np.zeros(n_images)])
        times = path.times - path.times[0]
        first_places = slice(0, max(START_PLACES_MIN, int((times <= START_DURATION_S).sum())))
        (speed_x, speed_y), (x, y) = np.polyfit(times[first_places], path.places[first_places], 1)
        mean, covariance, model = new_cell(organism, field is not None)
        mean[[X, Y, HEADING, SPEED]] = (
            x,
            y,
            math.atan2(speed_y, speed_x),
            math.hypot(speed_x, speed_y),
        )
        covariance[[FLOW_X, FLOW_Y], [FLOW_X, FLOW_Y]] = FLOW_SD_UM_S**2
        model[SPEED] *= SPEED_GROWTH_FACTOR
        model[[X, Y, C, S]] *= PLACE_GROWTH_FACTOR
        model[[A, BIAS]] = 0.0
        pieces_between = no_field if field is None else field.pieces
        pieces = list[Piece]()
        piece_starts = [0, 0]
        for start_s, end_s in pairwise(path.times.tolist()):
            pieces += pieces_between(start_s, end_s)
            piece_starts.append(len(pieces))
        field_arrays = np.array(pieces).reshape(-1, 3), np.array(piece_starts)
        return cls(values, deviations, *field_arrays, mean, covariance, model)

    def likelihood(self, first_states: Floats) -> Floats:
        """Compute the log-likelihood of V variants of the first state (V, n), shape (V,)."""
        log_likelihoods = np.empty(len(first_states))
        log_likelihoods_of(
            first_states.copy(),
            self.covariance,
            np.tile(self.model, (len(first_states), 1)),
            self.values,
            self.deviations,
            self.pieces,
            self.piece_starts,
            log_likelihoods,
        )
        return log_likelihoods

    def smoothed(
        self, first_state: Floats, start_image: int = 0, stop_image: int | None = None
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Smooth the states of a cell over a range of images.

        Args:
            first_state: The first state, shape (n,).
            start_image: Index of the first image.
            stop_image: Index after the last image. None for all images.

        Returns:
            The last state (n,), its covariance (n, n), all states (K, n), and all bodies (K, 3): x,
            y [um] and axis [rad].
        """
        last_state = first_state.copy()
        values = self.values[start_image:stop_image]
        piece_starts = self.piece_starts[start_image : stop_image and stop_image + 1].copy()
        piece_starts[0] = piece_starts[1]
        states = np.empty((len(values), STATE_SIZE))
        bodies = np.empty((len(values), 3))
        covariance = smooth(
            last_state,
            self.covariance,
            self.model,
            values,
            self.deviations[start_image:stop_image],
            self.pieces,
            piece_starts,
            states,
            bodies,
        )
        return last_state, covariance, states, bodies


@dataclass(frozen=True, slots=True)
class _Fit:
    """The states of one cell that were fitted to its track.

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
    def fit(cls, track: _MeasuredTrack) -> Self:
        """Fit the states of a cell to the measurements of its track."""
        start_states = np.tile(track.mean, (len(RATE_FACTORS) * len(HEADING_OFFSETS), 1))
        start_states[:, RATE] *= np.repeat(RATE_FACTORS, len(HEADING_OFFSETS))
        start_states[:, HEADING] += np.tile(HEADING_OFFSETS, len(RATE_FACTORS))
        log_posteriors = track.likelihood(start_states)
        log_posteriors -= ((start_states[:, RATE] / track.mean[RATE] - 1) / RATE_FACTOR_SD) ** 2 / 2
        start_state = start_states[log_posteriors.argmax()]
        smoothed_start = track.smoothed(start_state)[2][0]
        smoothed_start[RESET_STATES] = 0.0
        # the second pass may lose a cell that turned by itself
        candidates = np.array([start_state, smoothed_start])
        start_state = candidates[track.likelihood(candidates).argmax()]
        last_state, covariance, states, bodies = track.smoothed(start_state)
        n_parts = max(1, int(track.pieces[:, 0].sum() / BLOCK_S))
        part_bounds = np.linspace(0, len(states), n_parts + 1).astype(int)
        misfit = 0.0
        for start_image, stop_image in pairwise(part_bounds.tolist()):
            first_state = states[start_image] if start_image else start_state
            part_state, part_covariance, _, _ = track.smoothed(first_state, start_image, stop_image)
            misfit += (part_state[A] - last_state[A]) ** 2 / part_covariance[A, A]
        sd = np.sqrt(np.diagonal(covariance))
        return cls(last_state, sd, states, bodies, misfit, n_parts - 1)


def _compute_interval(value: float, sd: float, relative_sd: float) -> SampleInterval:
    """Compute a value's 95 % interval from an absolute and a relative standard deviation."""
    value = float(value)
    half_width = float(Z_95 * math.hypot(sd, relative_sd * value))
    return SampleInterval(value, value - half_width, value + half_width)


def _summarise(
    path: CellPath, fit: _Fit | None, is_field_known: bool, usual_misfit: float, period_s: float
) -> CellSummary:
    """Summarise the fit of a cell.

    Args:
        path: The track.
        fit: The fit. None if there are too few places or images are too rare.
        is_field_known: Whether the field is known.
        usual_misfit: Usual misfit of a part of a track of the table.
        period_s: Usual time between two images [s].
    """
    between_s = float(path.times[-1] - path.times[0])
    swum_um = measure_path_um(path.places)
    speed_um_s = a_rad_s = bias_rad = magnetised = None
    speed_sd_um_s = sway_rad = helix_hz = helix_um = math.nan
    if fit is not None:
        states = fit.states
        swum_um = float(fit.mean[PATH_LENGTH])
        misfit = (USUAL_MISFIT_WEIGHT * usual_misfit + fit.misfit) / (
            USUAL_MISFIT_WEIGHT + fit.parts
        )
        sd_factor = math.sqrt(max(1.0, misfit))
        speed_um_s = _compute_interval(
            swum_um / between_s, sd_factor * float(fit.sd[PATH_LENGTH]) / between_s, SPEED_ERROR
        )
        speed_sd_um_s = float(states[:, SPEED].std())
        sway_rad = math.sqrt(2) * float(np.std(states[:, HEADING] - fit.bodies[:, 2]))
        helix_hz = float(np.median(states[:, RATE])) / math.tau
        helix_um = float(np.median(np.hypot(states[:, C], states[:, S])))
        if is_field_known:
            a_rad_s = _compute_interval(fit.mean[A], sd_factor * fit.sd[A], A_ERROR)
            bias_rad = _compute_interval(fit.mean[BIAS], sd_factor * fit.sd[BIAS], 0.0)
            magnetised = bool(fit.mean[A] > RESPONDS * sd_factor * fit.sd[A])
    return CellSummary(
        cell=path.number,
        since_s=float(path.times[0]),
        duration_s=between_s + period_s,
        pictures=len(path.times),
        speed_um_s=speed_um_s,
        speed_sd_um_s=speed_sd_um_s,
        vsl_um_s=compute_vsl_um_s(path.times, path.places),
        path_um=swum_um,
        sway_rad=sway_rad,
        helix_hz=helix_hz,
        helix_um=helix_um,
        a_rad_s=a_rad_s,
        bias_rad=bias_rad,
        magnetised=magnetised,
    )
