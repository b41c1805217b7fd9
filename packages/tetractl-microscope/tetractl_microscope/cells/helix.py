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
    way       length of the way along the helix's axis since the row was added [um]
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
    EXACT,
    FLOW_X,
    FLOW_Y,
    HEADING,
    LEAD,
    MODEL,
    RATE,
    SLOWEST,
    SPEED,
    STATES,
    SWAY,
    TURN,
    A,
    C,
    S,
    X,
    Y,
)
from tetractl_microscope.organisms import TETRAHYMENA, Organism

# what is thought of a new cell: standard deviations of its position [lengths of a cell], heading,
# and speed [relative to that below which it rests]; mean and standard deviation of a [rad/s]
POSITION_SD = 0.115
HEADING_SD = 0.35
SPEED_SD = 1.33
A_USUAL = 3.0
A_SD = 3.0
A_SD_UNKNOWN = 1e-6  # in an unknown field, a stays 0
BIAS_SD = 0.15
FLOW_SD_UM_S = 4.0
DELAY_SD_S = 0.015
SWAY_USUAL = 0.8
SWAY_SD = 0.3
LEAD_SD = 0.3
# growth of these standard deviations per sqrt(s), in the same units; that of the rate [rad/s]
POSITION_GROWTH = 0.038
HEADING_GROWTH = 0.07
SPEED_GROWTH = 0.2
RATE_GROWTH = 0.3
A_GROWTH = 0.02
BIAS_GROWTH = 0.005
# standard deviation of unexplained turning [rad/s] with and without a known field
TURN_KNOWN = 0.1
TURN_UNKNOWN = 3.0
WALL_UM = 60.0  # distance from the arena's edge within which a wall may turn a cell
# relative deviations of a mean speed and of a for what a picture does not show, as an axis that
# leaves the picture's plane
SPEED_ERROR = 0.004
A_ERROR = 0.02

Piece = tuple[float, float, float]
"""A constant field: duration [s], and x and y components relative to the reference field."""

NearWall = Callable[[Floats, Floats], Bools]
"""Function that returns whether a wall may turn cells at positions x, y (R,) [um]."""


def open_water(x: Floats, y: Floats) -> Bools:
    """Return False for every position: there are no walls."""
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
    turn_sd = TURN_KNOWN if field_known else TURN_UNKNOWN

    mean = np.zeros(STATES)
    mean[RATE] = rate
    mean[A] = A_USUAL if field_known else 0.0
    mean[SWAY] = SWAY_USUAL

    sd = np.zeros(STATES)
    sd[[X, Y]] = POSITION_SD * body_um
    sd[HEADING] = HEADING_SD
    sd[SPEED] = SPEED_SD * slowest_um_s
    sd[[C, S]] = math.hypot(*organism.helix_um) / math.sqrt(2)
    sd[RATE] = rate_sd
    sd[A] = A_SD if field_known else A_SD_UNKNOWN
    sd[BIAS] = BIAS_SD
    sd[TURN] = turn_sd
    sd[[FLOW_X, FLOW_Y]] = FLOW_SD_UM_S
    sd[DELAY] = DELAY_SD_S
    sd[SWAY] = SWAY_SD
    sd[LEAD] = LEAD_SD

    model = np.zeros(MODEL)
    model[[X, Y, C, S]] = POSITION_GROWTH * body_um
    model[HEADING] = HEADING_GROWTH
    model[SPEED] = SPEED_GROWTH * slowest_um_s
    model[RATE] = RATE_GROWTH
    model[A] = A_GROWTH
    model[BIAS] = BIAS_GROWTH
    model[TURN] = turn_sd
    model[EXACT] = 1.0
    model[SLOWEST] = slowest_um_s
    return NewCell(mean, np.diag(np.square(sd)), model)


@dataclass(slots=True)
class HelixFilter:
    """An extended Kalman filter that tracks many cells, with one row for each cell.

    Attributes:
        field_known: Whether the field is known. If so, little of a cell's turning is unexplained.
        near_wall: Function that finds the positions where a wall may turn cells. Turning there
            leaves the estimates of a and bias unchanged.
        organism: The organism, which determines the initial estimate of a new cell.
        mean: Mean of the state in each row, shape (R, n).
        covariance: Covariance of the state in each row, shape (R, n, n).
        used: Whether each row holds a cell, shape (R,).
    """

    field_known: bool = True
    near_wall: NearWall = open_water
    organism: Organism = TETRAHYMENA
    mean: Floats = field(default_factory=lambda: np.zeros((0, STATES)))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, STATES, STATES)))
    used: Bools = field(default_factory=lambda: np.zeros(0, bool))
    _new_cell: NewCell = field(init=False)
    _last_piece: Floats | None = None  # the last piece

    def __post_init__(self) -> None:
        """Run each compiled kernel once, so that no image has to wait for a compilation."""
        self._new_cell = new_cell(self.organism, self.field_known)
        self.add(0.0, 0.0, 0.0, 0.0)
        self.predict([(1.0, 0.0, 0.0)])
        only_row = np.zeros(1, int)
        self.update(only_row, np.zeros((1, 3)), np.ones((1, 3)))
        self.expected(only_row)
        self.drop(0)
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
        self.mean[row] = self._new_cell.mean
        self.covariance[row] = self._new_cell.covariance
        self.mean[row, [X, Y, HEADING, SPEED]] = x, y, heading, speed
        return row

    def copied(self, row: int) -> int:
        """Copy a row to a free row, and return the index of the copy.

        If no row is free, the arrays grow and are replaced.
        """
        copy = self._reserve_row()
        self.mean[copy] = self.mean[row]
        self.covariance[copy] = self.covariance[row]
        return copy

    def moved(self, row: int, x: float, y: float, heading: float) -> int:
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
        copy = self.copied(row)
        pose_states = [X, Y, HEADING, C, S]
        self.mean[copy, pose_states] = x, y, heading, 0.0, 0.0
        self.covariance[copy, pose_states, :] = self.covariance[copy, :, pose_states] = 0.0
        self.covariance[copy, pose_states, pose_states] = self._new_cell.covariance[
            pose_states, pose_states
        ]
        return copy

    def drop(self, row: int) -> None:
        """Remove a cell: its row becomes free."""
        self.used[row] = False

    def predict(self, pieces: Sequence[Piece]) -> None:
        """Run the time update for every cell, over successive intervals of constant field.

        Each piece has its duration [s], x and y. Nothing happens if there are none.
        """
        if pieces:
            field_pieces = np.array(pieces, np.float64)
            walled = self.near_wall(self.mean[:, X], self.mean[:, Y])
            previous_piece = field_pieces[0] if self._last_piece is None else self._last_piece
            rows = self.mean, self.covariance, self.used
            helix_steps.predict(*rows, self._new_cell.model, walled, previous_piece, field_pieces)
            self._last_piece = field_pieces[-1]

    def loosen(self, rows: Sequence[int]) -> None:
        """Make cells that moved unexpectedly about as uncertain as new cells.

        The initial variances of position, heading, speed, c and s are added to their covariances.
        """
        for row in rows:
            self.covariance[row, :RATE, :RATE] += self._new_cell.covariance[:RATE, :RATE]

    def expected(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Predict the measurements of cells' bodies.

        Args:
            rows: Rows of the cells, shape (M,).

        Returns:
            x, y [um] and the axis [rad] of each body, shape (M, 3), and the covariances of the
            positions [um^2], shape (M, 2, 2).
        """
        bodies = np.empty((len(rows), 3))
        slopes = np.empty((len(rows), 3, STATES))
        helix_steps.expected(self.mean, rows, self._new_cell.model[SLOWEST], bodies, slopes)
        position_slopes = slopes[:, :2]
        return bodies, position_slopes @ self.covariance[rows] @ position_slopes.transpose(0, 2, 1)

    def update(
        self, rows: np.ndarray, measured: Floats, deviation: Floats
    ) -> tuple[Floats, Floats]:
        """Run the measurement update for some of the cells.

        Args:
            rows: Rows of the measured cells, shape (M,).
            measured: Measured x, y [um] and axis [rad], shape (M, 3).
            deviation: Standard deviations of the measurements, shape (M, 3).

        Returns:
            The log-likelihoods under Student's t distribution, shape (M,), and the squared
            Mahalanobis distances from the prediction, shape (M,).
        """
        likelihood = np.empty(len(rows))
        distance = np.empty(len(rows))
        helix_steps.update(
            self.mean,
            self.covariance,
            rows,
            self._new_cell.model,
            np.ascontiguousarray(measured),
            np.ascontiguousarray(deviation),
            likelihood,
            distance,
        )
        return likelihood, distance

    def _reserve_row(self) -> int:
        """Reserve a free row and return its index. If there is none, the arrays grow by 16 rows."""
        if self.used.all():
            self.mean = np.concatenate([self.mean, np.zeros((16, STATES))])
            self.covariance = np.concatenate([self.covariance, np.zeros((16, STATES, STATES))])
            self.used = np.concatenate([self.used, np.zeros(16, bool)])
        row = int(np.argmin(self.used))
        self.used[row] = True
        return row
