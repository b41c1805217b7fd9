"""A Kalman filter for many swimming cells at once: position, heading, helix and turning.

State of one cell, in um, s and rad:

    x, y      position on the helix's axis next to the body
    heading   direction of the helix's axis, which turns by equation (3) of the paper
    speed     along the axis
    c, s      the body's offset from the axis: in the picture, to the left, and in depth
    rate      angular rate of the helix [rad/s]: c' = -rate s, s' = rate c
    a         turning rate at the reference field, as in equation (3)
    bias      the dipole's angle from the axis
    turn      turning rate that the field does not explain [rad/s]
    flow      velocity of the medium, x and y
    delay     time after which the field acts on the cell [s]
    path      distance travelled along the helix's axis since the row was added [um]
    sway      swing of the body's axis, relative to that of a body that points along its path
    lead      the same for the part of the swing that is a quarter turn ahead

The measurements are the body's middle, which is at (x, y) plus c to the left of the heading, and
the body's axis mod pi, heading - atan(rate (sway s + lead c) / speed): the projection of Crenshaw's
helix into the picture. The steps for one cell are compiled (`kernels.helix_steps`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl_microscope.cells.kernels import helix_steps
from tetractl_microscope.cells.kernels.helix_steps import (
    BIAS,
    DELAY,
    DEVIATION_SCALE,
    FLOW_X,
    FLOW_Y,
    HEADING,
    LEAD,
    MODEL_SIZE,
    RATE,
    SPEED,
    SPEED_MIN,
    STATE_SIZE,
    SWAY,
    TURN,
    A,
    C,
    S,
    X,
    Y,
)
from tetractl_microscope.organisms import TETRAHYMENA, Organism

# Means and standard deviations of the state of a new cell.
POSITION_SD = 0.115  # [lengths of a cell]
HEADING_SD = 0.35  # [rad]
SPEED_SD = 1.33  # relative to the speed below which a cell rests
A_MEAN = 3.0  # [rad/s]
A_SD = 3.0  # [rad/s]
A_SD_UNKNOWN = 1e-6  # in an unknown field, a stays 0
BIAS_SD = 0.15
FLOW_SD_UM_S = 4.0
DELAY_SD_S = 0.015
SWAY_MEAN = 0.8
SWAY_SD = 0.3
LEAD_SD = 0.3
# Growth of the standard deviations per sqrt(s), in the same units. RATE_GROWTH is in rad/s.
POSITION_GROWTH = 0.038
HEADING_GROWTH = 0.07
SPEED_GROWTH = 0.2
RATE_GROWTH = 0.3
A_GROWTH = 0.02
BIAS_GROWTH = 0.005
# Standard deviation of the turning that the field does not explain [rad/s].
TURN_SD_KNOWN = 0.1  # if the field is known
TURN_SD_UNKNOWN = 3.0  # if the field is unknown
WALL_REACH_UM = 60.0  # distance from the arena's edge within which a wall may turn a cell
# Relative standard deviations that are added to those of the filter, for effects that an image does
# not show, such as a tilt of the helix out of the image plane.
SPEED_ERROR = 0.004  # of a mean speed
A_ERROR = 0.02  # of a

Piece = tuple[float, float, float]
"""A constant field: duration [s], and x and y components relative to the reference field."""

NearWall = Callable[[Floats, Floats], Bools]
"""Function that returns whether a wall may turn cells at positions x, y (R,) [um]."""


def nowhere_near_wall(x: Floats, y: Floats) -> Bools:
    """Return False for every position (R,): the `NearWall` function of water without walls."""
    return np.zeros(len(x), bool)


class NewCell(NamedTuple):
    """The initial estimate of a new cell at the origin.

    Attributes:
        mean: Mean of the state, shape (n,).
        covariance: Covariance of the state, shape (n, n).
        model: Constants of the cell's model, shape (12,), as in `kernels.helix_steps`.
    """

    mean: Floats
    covariance: Floats
    model: Floats


def new_cell(organism: Organism, field_known: bool) -> NewCell:
    """Create the initial estimate of a new cell, from what is typical of its organism.

    Args:
        organism: The organism.
        field_known: Whether the field is known. If not, the field is assumed to turn no cell (a =
            0), and most turning is unexplained.
    """
    body_um = organism.body_um[0]
    slowest_um_s = organism.slowest_um_s
    rate, rate_sd = math.tau * np.array(organism.helix_hz)
    turn_sd = TURN_SD_KNOWN if field_known else TURN_SD_UNKNOWN

    mean = np.zeros(STATE_SIZE)
    mean[RATE] = rate
    mean[A] = A_MEAN if field_known else 0.0
    mean[SWAY] = SWAY_MEAN

    state_sd = np.zeros(STATE_SIZE)
    state_sd[[X, Y]] = POSITION_SD * body_um
    state_sd[HEADING] = HEADING_SD
    state_sd[SPEED] = SPEED_SD * slowest_um_s
    state_sd[[C, S]] = math.hypot(*organism.helix_um) / math.sqrt(2)
    state_sd[RATE] = rate_sd
    state_sd[A] = A_SD if field_known else A_SD_UNKNOWN
    state_sd[BIAS] = BIAS_SD
    state_sd[TURN] = turn_sd
    state_sd[[FLOW_X, FLOW_Y]] = FLOW_SD_UM_S
    state_sd[DELAY] = DELAY_SD_S
    state_sd[SWAY] = SWAY_SD
    state_sd[LEAD] = LEAD_SD

    model = np.zeros(MODEL_SIZE)
    model[[X, Y, C, S]] = POSITION_GROWTH * body_um
    model[HEADING] = HEADING_GROWTH
    model[SPEED] = SPEED_GROWTH * slowest_um_s
    model[RATE] = RATE_GROWTH
    model[A] = A_GROWTH
    model[BIAS] = BIAS_GROWTH
    model[TURN] = turn_sd
    model[DEVIATION_SCALE] = 1.0
    model[SPEED_MIN] = slowest_um_s
    return NewCell(mean, np.diag(np.square(state_sd)), model)


@dataclass(slots=True)
class HelixFilter:
    """An extended Kalman filter that tracks many cells, with one row for each cell.

    Attributes:
        field_known: Whether the field is known. If so, little of a cell's turning is unexplained.
        near_wall: Function that finds the positions where a wall may turn cells. Turning there
            leaves the estimates of a and bias unchanged.
        organism: The organism, which determines the initial estimate of a new cell.
        means: Mean of the state in each row, shape (R, n).
        covariances: Covariance of the state in each row, shape (R, n, n).
        is_used: Whether each row holds a cell, shape (R,).
    """

    field_known: bool = True
    near_wall: NearWall = nowhere_near_wall
    organism: Organism = TETRAHYMENA
    means: Floats = field(default_factory=lambda: np.zeros((0, STATE_SIZE)))
    covariances: Floats = field(default_factory=lambda: np.zeros((0, STATE_SIZE, STATE_SIZE)))
    is_used: Bools = field(default_factory=lambda: np.zeros(0, bool))
    _new_cell: NewCell = field(init=False)
    _last_piece: Floats | None = None  # the piece of the field before the next prediction

    def __post_init__(self) -> None:
        """Run each compiled kernel once, so that no image has to wait for a compilation."""
        self._new_cell = new_cell(self.organism, self.field_known)
        self.add(0.0, 0.0, 0.0, 0.0)
        self.predict([(1.0, 0.0, 0.0)])
        only_row = np.zeros(1, int)
        self.update(only_row, np.zeros((1, 3)), np.ones((1, 3)))
        self.predict_bodies(only_row)
        self.free_row(0)
        self._last_piece = None

    def add(self, x: float, y: float, heading: float, speed: float) -> int:
        """Add a new cell.

        Args:
            x: x of its position [um].
            y: y of its position [um].
            heading: Its heading [rad].
            speed: Its speed [um/s].

        Returns:
            The row of the cell.
        """
        row = self._reserve_row()
        self.means[row] = self._new_cell.mean
        self.covariances[row] = self._new_cell.covariance
        self.means[row, [X, Y, HEADING, SPEED]] = x, y, heading, speed
        return row

    def copy_row(self, row: int) -> int:
        """Copy a row to a free row, and return the index of the copy.

        If no row is free, the arrays grow and are replaced.
        """
        copy = self._reserve_row()
        self.means[copy] = self.means[row]
        self.covariances[copy] = self.covariances[row]
        return copy

    def copy_row_to(self, row: int, x: float, y: float, heading: float) -> int:
        """Copy a cell to a free row, and move the copy to another pose.

        The copy keeps its speed, its turning rate and the rate of its helix.

        Args:
            row: The cell's row.
            x: x of the new pose [um].
            y: y of the new pose [um].
            heading: Heading of the new pose [rad].

        Returns:
            The row of the copy.
        """
        copy = self.copy_row(row)
        pose_states = [X, Y, HEADING, C, S]
        self.means[copy, pose_states] = x, y, heading, 0.0, 0.0
        self.covariances[copy, pose_states, :] = self.covariances[copy, :, pose_states] = 0.0
        self.covariances[copy, pose_states, pose_states] = self._new_cell.covariance[
            pose_states, pose_states
        ]
        return copy

    def free_row(self, row: int) -> None:
        """Remove a cell from the filter, so that its row becomes free."""
        self.is_used[row] = False

    def predict(self, pieces: Sequence[Piece]) -> None:
        """Run the time update for every cell, over successive intervals of constant field.

        Args:
            pieces: The successive pieces of constant field: duration [s], x and y. Nothing happens
                if the sequence is empty.
        """
        if pieces:
            field_pieces = np.array(pieces, np.float64)
            is_near_wall = self.near_wall(self.means[:, X], self.means[:, Y])
            previous_piece = field_pieces[0] if self._last_piece is None else self._last_piece
            filter_rows = self.means, self.covariances, self.is_used
            helix_steps.predict(
                *filter_rows, self._new_cell.model, is_near_wall, previous_piece, field_pieces
            )
            self._last_piece = field_pieces[-1]

    def widen(self, rows: Sequence[int]) -> None:
        """Make cells that moved unexpectedly about as uncertain as new cells.

        The initial variances of position, heading, speed, c and s are added to their covariances.
        """
        for row in rows:
            self.covariances[row, :RATE, :RATE] += self._new_cell.covariance[:RATE, :RATE]

    def predict_bodies(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Predict the positions and axes of some cells' bodies, as the camera will measure them.

        Args:
            rows: Rows of the cells, shape (M,).

        Returns:
            x, y [um] and the axis [rad] of each body, shape (M, 3), and the covariances of the
            positions [um^2], shape (M, 2, 2).
        """
        bodies = np.empty((len(rows), 3))
        jacobians = np.empty((len(rows), 3, STATE_SIZE))
        helix_steps.predict_bodies(
            self.means, rows, self._new_cell.model[SPEED_MIN], bodies, jacobians
        )
        position_jacobians = jacobians[:, :2]
        return bodies, position_jacobians @ self.covariances[rows] @ position_jacobians.transpose(
            0, 2, 1
        )

    def update(
        self, rows: np.ndarray, measured: Floats, measured_sd: Floats
    ) -> tuple[Floats, Floats]:
        """Run the measurement update for some of the cells.

        Args:
            rows: Rows of the measured cells, shape (M,).
            measured: Measured x, y [um] and axis [rad], shape (M, 3).
            measured_sd: Standard deviations of the measurements, shape (M, 3).

        Returns:
            The log-likelihoods under Student's t distribution, shape (M,), and the squared
            Mahalanobis distances from the prediction, shape (M,).
        """
        log_likelihoods = np.empty(len(rows))
        squared_distances = np.empty(len(rows))
        helix_steps.update(
            self.means,
            self.covariances,
            rows,
            self._new_cell.model,
            np.ascontiguousarray(measured),
            np.ascontiguousarray(measured_sd),
            log_likelihoods,
            squared_distances,
        )
        return log_likelihoods, squared_distances

    def _reserve_row(self) -> int:
        """Reserve a free row and return its index. If there is none, the arrays grow by 16 rows."""
        if self.is_used.all():
            self.means = np.concatenate([self.means, np.zeros((16, STATE_SIZE))])
            self.covariances = np.concatenate(
                [self.covariances, np.zeros((16, STATE_SIZE, STATE_SIZE))]
            )
            self.is_used = np.concatenate([self.is_used, np.zeros(16, bool)])
        row = int(np.argmin(self.is_used))
        self.is_used[row] = True
        return row
