"""The tracks of the cells in a dish, and the inference of which cell is on which track."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import BodySize, PathBlob
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.cells.helix import HelixFilter

DECIDED_PROBABILITY = 0.998  # probability of an assignment above which a question is decided
OPEN_MIN_S = 0.5  # minimum time for which a question is open
OPEN_MAX_S = 10.0  # maximum time for which a question is open
SETTLED_S = 0.3  # time after which the filter rows of a question have settled on their tracks
# Exponent of likelihoods. Errors of successive images are not independent.
LIKELIHOOD_EXPONENT = 0.3
# Maximum by which one image lowers the log-likelihood of a cell, relative to the likeliest cell.
LOG_PENALTY_MAX = 4.0
# Degrees of freedom of Student's t distribution of positions and of the logarithms of sizes.
STUDENT_DOF = 2.0
# Factor on the filter's standard deviations of positions. The filter does not know well how cells
# swim while they share a blob.
SPREAD_FACTOR = 1.4
LOG_SIZE_SD = 0.1  # scale of the distribution of the logarithm of a size
SIZE_IMAGES = 6  # number of images of a question in which sizes count
SELF_TURN_PROBABILITY = 0.2  # probability that a cell turns by itself while it is with others


@dataclass(slots=True)
class TrackBlob:
    """The blob that shows a cell in the newest image.

    Attributes:
        index: Index of the blob among the image's blobs.
        blob: The blob as found in the image [px].
        place: x, y [um], axis [rad], length and width [um] of the blob, shape (5,).
        is_shared: Whether the blob also shows other tracked cells.
        is_large: Whether the blob shows only this tracked cell, but is too large for one cell.
    """

    index: int
    blob: Blob
    place: Floats
    is_shared: bool = False
    is_large: bool = False

    @property
    def whole_place(self) -> Floats:
        """The place of the blob, shape (5,): x, y [um], axis [rad], length and width [um].

        Length and width are NaN if the image's edge cuts the blob off.
        """
        if not self.blob.at_edge:
            return self.place
        return np.array((*self.place[:3], math.nan, math.nan))


@dataclass(slots=True, eq=False)
class CellTrack:
    """A cell that is tracked from image to image.

    Attributes:
        number: Number of the track.
        row: Row of the filter that predicts the cell.
        size: Size of the cell.
        last_um: Position of the cell's last blob [um], shape (2,).
        path: The newest blobs that show only this cell.
        missed_s: Time since the cell's last blob [s].
        newest_blob: The cell's blob in the newest image. None if no blob shows the cell.
        size_seen_s: When a blob that shows only this cell last had the cell's size [s]. The size
            of a blob shows how many cells it contains.
        start_um: First position of the cell [um], shape (2,). None once the cell has swum far
            enough to be accepted as a cell.
        began_s: When the track began [s].
        outliers_in_row: Number of successive blobs far from the filter's prediction.
        identity: Number of the cell that is most probably on the track; see `CellIdentities`.
        certainty: Probability of that identity while the track is in no meeting and no question.
        meeting: The meeting of the track with others. None if there is none.
        question: The open question about the track's identity. None if there is none.
        together_s: When the cell was last too close to another cell to be distinguished [s].
            Minus infinity if it never was.
    """

    number: int
    row: int
    size: BodySize
    last_um: Floats
    path: list[PathBlob] = field(default_factory=list)
    missed_s: float = 0.0
    newest_blob: TrackBlob | None = None
    size_seen_s: float = 0.0
    start_um: Floats | None = None
    began_s: float = 0.0
    outliers_in_row: int = 0
    identity: int = 0
    certainty: float = 1.0
    meeting: "Meeting | None" = None
    question: "IdentityQuestion | None" = None
    together_s: float = -math.inf

    @property
    def is_new(self) -> bool:
        """Whether the cell has not yet swum far enough to be accepted as a cell."""
        return self.start_um is not None

    @property
    def is_shared(self) -> bool:
        """Whether the blob that shows this cell in the newest image also shows other cells.

        It is False if no blob shows the cell.
        """
        return self.newest_blob is not None and self.newest_blob.is_shared

    @property
    def rows(self) -> Sequence[int]:
        """The rows of the Kalman filter that follow the track.

        While its identity is an open question, there is one row for each cell that it may be.
        """
        if self.question is None:
            return [self.row]
        return self.question.rows[self.question.tracks.index(self)].tolist()

    def move_by(self, x: float, y: float) -> None:
        """Move all stored positions by x and y [um], with the content of the image."""
        self.path = [blob.moved(x, y) for blob in self.path]
        shift_um = np.array((x, y))
        self.last_um = self.last_um + shift_um
        if self.start_um is not None:
            self.start_um = self.start_um + shift_um


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A track in a meeting, and the cell that was on the track when it joined the meeting.

    Attributes:
        track: The track.
        row: The filter's row that predicts the cell without measurements.
        identity: Number of the cell.
        certainty: Probability that it is this cell.
        size: Size of the cell.
    """

    track: CellTrack
    row: int
    identity: int
    certainty: float
    size: BodySize


@dataclass(slots=True, eq=False)
class Meeting:
    """Tracks that are too close together to distinguish their cells.

    Attributes:
        members: The tracks, with the cell that was on each of them when it joined.
        with_unknown: Whether an unknown object may have joined them.
    """

    members: list[Member]
    with_unknown: bool

    @property
    def tracks(self) -> list[CellTrack]:
        """The tracks that are too close together now, one for each member."""
        return [member.track for member in self.members]

    @property
    def rows(self) -> list[int]:
        """The rows of the Kalman filter that predict the cells of the members."""
        return [member.row for member in self.members]


@dataclass(slots=True, eq=False)
class IdentityQuestion:
    """The open question of which cell is on which track, after K cells were in a meeting.

    Attributes:
        members: The K cells and tracks.
        rows: `rows[i, j]` is the filter row that follows track i as cell j, shape (K, K).
        log_prior: Log-probability of each of `assignments` when the question arose, shape (P,).
        known_probability: `known_probability[i, j]` is the probability that cell j, and not an
            unknown object, is on track i if one of them is, shape (K, K).
        since_s: When the question arose [s].
        log_likelihoods: Sum of the log-likelihoods of the measurements for each of `rows`, shape
            (K, K).
        assignments: The possible assignments, shape (P, K): the index of the cell on each track.
    """

    members: Sequence[Member]
    rows: np.ndarray
    log_prior: Floats
    known_probability: Floats
    since_s: float
    log_likelihoods: Floats = field(init=False)
    assignments: np.ndarray = field(init=False)
    _n_sizes: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.log_likelihoods = np.zeros(self.rows.shape)
        self.assignments = list_assignments(len(self.members))
        self._n_sizes = np.zeros(len(self.members), int)

    @property
    def tracks(self) -> list[CellTrack]:
        """The tracks that have separated, and for which it is open which cell is which."""
        return [member.track for member in self.members]

    def add_measurement(
        self,
        track: CellTrack,
        log_likelihoods: Floats,
        size: Sequence[float] | None,
        seconds: float,
    ) -> None:
        """Use a measurement of a track in one image as evidence for which cell is on it.

        The likelihood counts only after SETTLED_S, when the filter rows have settled on the track.
        The measurements before are part of the prior.

        Args:
            track: The track.
            log_likelihoods: Log-likelihood of the measurement for each cell, shape (K,).
            size: Length and width of the blob [um]. None if it is cut off.
            seconds: Time of the image [s].
        """
        i = self.tracks.index(track)
        if seconds - self.since_s > SETTLED_S:
            self.log_likelihoods[i] += LIKELIHOOD_EXPONENT * np.maximum(
                log_likelihoods - log_likelihoods.max(), -LOG_PENALTY_MAX
            )
        if size is not None and self._n_sizes[i] < SIZE_IMAGES:
            self._n_sizes[i] += 1
            sizes = np.array([member.size for member in self.members])
            squared_deviations = np.square(np.log(np.array(size) / sizes) / LOG_SIZE_SD)
            size_likelihoods = (
                -(STUDENT_DOF + 1) / 2 * np.log1p(squared_deviations / STUDENT_DOF).sum(axis=1)
            )
            self.log_likelihoods[i] += size_likelihoods / SIZE_IMAGES

    def probabilities(self) -> Floats:
        """Compute the probability of each assignment of cells to tracks, shape (P,)."""
        return normalise_log_probabilities(
            self.log_prior
            + compute_log_assignment_probabilities(self.assignments, self.log_likelihoods)
        )

    def best_assignment(self) -> tuple[tuple[int, ...], Floats]:
        """Find the most probable assignment of cells to tracks.

        Returns:
            The index of the cell on each track, and for each track the probability that this cell
            is on it, shape (K,).
        """
        probabilities = self.probabilities()
        assignment = self.assignments[int(np.argmax(probabilities))]
        not_unknown = self.known_probability[np.arange(len(assignment)), assignment]
        return tuple(assignment.tolist()), not_unknown * (
            probabilities @ (self.assignments == assignment)
        )

    def is_decided(self, now_s: float) -> bool:
        """Check whether the question of which cell is which can be closed at a time [s].

        The question is decided if its best answer is certain enough after OPEN_MIN_S, and in any
        case after OPEN_MAX_S.
        """
        open_s = now_s - self.since_s
        return open_s > OPEN_MAX_S or (
            open_s > OPEN_MIN_S and self.probabilities().max() > DECIDED_PROBABILITY
        )


def list_assignments(n_tracks: int) -> np.ndarray:
    """List all assignments of n cells to n tracks, shape (n!, n).

    Column i contains the index of the cell that track i shows.
    """
    permuted = list(permutations(range(n_tracks)))
    return np.array(permuted, int).reshape(-1, n_tracks)


def compute_log_assignment_probabilities(assignments: np.ndarray, log_table: Floats) -> Floats:
    """Compute the log-probability of each assignment of cells to tracks, up to a constant.

    Args:
        assignments: The assignments, shape (P, K).
        log_table: Log-probability of each cell (columns) on each track (rows), shape (K, K).

    Returns:
        The sum of `log_table[i, assignments[p, i]]` over i, shape (P,).
    """
    return log_table[np.arange(len(log_table)), assignments].sum(axis=1)


def normalise_log_probabilities(log_probabilities: Floats) -> Floats:
    """Convert log-probabilities, known up to a constant, to probabilities that add up to 1."""
    probabilities = np.exp(log_probabilities - log_probabilities.max())
    return probabilities / probabilities.sum()


def compute_log_densities(
    cell_filter: HelixFilter, rows: Sequence[int], places: Floats, sd_um: Floats, log_unknown: float
) -> Floats:
    """Compute the log-density of cells at given places [1/um^2], shape (K, M).

    Args:
        cell_filter: The filter.
        rows: Filter rows of the M cells.
        places: The places, shape (K, 3): x, y [um] and axis [rad].
        sd_um: Additional standard deviations of the positions [um], shape (K,).
        log_unknown: Log-density [ln of 1/um^2] of an object that may be anywhere near. A cell that
            has turned by itself counts as such an object.
    """
    expected, covariances = cell_filter.predict_bodies(np.array(rows, int))
    covariances = SPREAD_FACTOR**2 * (
        covariances + np.square(sd_um)[:, None, None, None] * np.eye(2)
    )
    offsets = places[:, None, :2] - expected[None, :, :2]
    squared_distances = np.einsum("tij,tijk,tik->ti", offsets, np.linalg.inv(covariances), offsets)
    log_density = -(STUDENT_DOF + 2) / 2 * np.log1p(squared_distances / STUDENT_DOF) - math.log(
        math.tau
    )
    log_density -= 0.5 * np.linalg.slogdet(covariances)[1]
    return np.logaddexp(log_density, log_unknown + math.log(SELF_TURN_PROBABILITY))
