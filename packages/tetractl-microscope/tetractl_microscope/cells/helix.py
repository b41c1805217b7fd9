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
    """Return False for all positions: there are no walls."""
    return np.zeros(len(x), bool)


class NewCell(NamedTuple):
    """The initial estimate of a new cell at the origin.

    Attributes:
        mean: Mean of the state, shape (n,).
        covariance: Covariance of the state, shape (n, n).
        model: Numbers of its model, shape (12,), as in `kernels.helix_steps`.
    """

    mean: Floats
    covariance: Floats
    model: Floats


def new_cell(organism: Organism, field_known: bool) -> NewCell:
    """Return the initial estimate of a new cell. `field_known` is as in `HelixFilter`."""
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
    """A filter with one row for each cell.

    Attributes:
        field_known: Whether the field is known, so that little turning is unexplained.
        near_wall: Tells where a wall may turn cells. Turning there leaves the estimates of a and
            bias unchanged.
        organism: What new cells are like.
        mean: Mean of each state, shape (R, n).
        covariance: Covariance of each state, shape (R, n, n).
        used: Whether each row is in use, shape (R,).
    """

    field_known: bool = True
    near_wall: NearWall = open_water
    organism: Organism = TETRAHYMENA
    mean: Floats = field(default_factory=lambda: np.zeros((0, STATES)))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, STATES, STATES)))
    used: Bools = field(default_factory=lambda: np.zeros(0, bool))
    _new: NewCell = field(init=False)
    _field: Floats | None = None  # the last piece

    def __post_init__(self) -> None:
        """Compile the steps now, and not while pictures wait."""
        self._new = new_cell(self.organism, self.field_known)
        self.add(0.0, 0.0, 0.0, 0.0)
        self.predict([(1.0, 0.0, 0.0)])
        only_row = np.zeros(1, int)
        self.update(only_row, np.zeros((1, 3)), np.ones((1, 3)))
        self.expected(only_row)
        self.drop(0)
        self._field = None

    def add(self, x: float, y: float, heading: float, speed: float) -> int:
        """Add a new cell, and return its row.

        Args:
            x: x of its position [um].
            y: y of its position [um].
            heading: Its heading [rad].
            speed: Its speed [um/s].
        """
        row = self._free()
        self.mean[row] = self._new.mean
        self.covariance[row] = self._new.covariance
        self.mean[row, [X, Y, HEADING, SPEED]] = x, y, heading, speed
        return row

    def copied(self, row: int) -> int:
        """Copy a row to a free row; return the index of the copy."""
        new = self._free()
        self.mean[new] = self.mean[row]
        self.covariance[new] = self.covariance[row]
        return new

    def moved(self, row: int, x: float, y: float, heading: float) -> int:
        """Copy a cell's row to a free row, move the copy to another pose, and return its row.

        The copy keeps its speed, turning and helix rate.

        Args:
            row: The cell's row.
            x: x of the pose [um].
            y: y of the pose [um].
            heading: Heading of the pose [rad].
        """
        new = self.copied(row)
        pose = [X, Y, HEADING, C, S]
        self.mean[new, pose] = x, y, heading, 0.0, 0.0
        self.covariance[new, pose, :] = self.covariance[new, :, pose] = 0.0
        self.covariance[new, pose, pose] = self._new.covariance[pose, pose]
        return new

    def drop(self, row: int) -> None:
        """Free a row."""
        self.used[row] = False

    def predict(self, pieces: Sequence[Piece]) -> None:
        """Predict every row over successive pieces of constant field."""
        if pieces:
            field = np.array(pieces, np.float64)
            walled = self.near_wall(self.mean[:, X], self.mean[:, Y])
            before = field[0] if self._field is None else self._field
            rows = self.mean, self.covariance, self.used
            helix_steps.predict(*rows, self._new.model, walled, before, field)
            self._field = field[-1]

    def loosen(self, rows: Sequence[int]) -> None:
        """Make cells that move unexpectedly as uncertain as new cells.

        This applies to position, heading, speed, c and s.
        """
        for row in rows:
            self.covariance[row, :RATE, :RATE] += self._new.covariance[:RATE, :RATE]

    def expected(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Predict where the bodies of cells are.

        Returns:
            x, y and axis (M, 3) for rows (M,), and the covariances of the positions (M, 2, 2)
            [um^2].
        """
        bodies = np.empty((len(rows), 3))
        slopes = np.empty((len(rows), 3, STATES))
        helix_steps.expected(self.mean, rows, self._new.model[SLOWEST], bodies, slopes)
        places = slopes[:, :2]
        return bodies, places @ self.covariance[rows] @ places.transpose(0, 2, 1)

    def update(
        self, rows: np.ndarray, measured: Floats, deviation: Floats
    ) -> tuple[Floats, Floats]:
        """Update cells with measurements.

        Args:
            rows: The cells' rows, shape (M,).
            measured: Measured x, y [um] and axis [rad], shape (M, 3).
            deviation: Their standard deviations, shape (M, 3).

        Returns:
            The log-likelihoods (M,) by Student's distribution, and the squared Mahalanobis
            distances (M,) from the prediction.
        """
        likelihood = np.empty(len(rows))
        distance = np.empty(len(rows))
        helix_steps.update(
            self.mean,
            self.covariance,
            rows,
            self._new.model,
            np.ascontiguousarray(measured),
            np.ascontiguousarray(deviation),
            likelihood,
            distance,
        )
        return likelihood, distance

    def _free(self) -> int:
        if self.used.all():
            self.mean = np.concatenate([self.mean, np.zeros((16, STATES))])
            self.covariance = np.concatenate([self.covariance, np.zeros((16, STATES, STATES))])
            self.used = np.concatenate([self.used, np.zeros(16, bool)])
        row = int(np.argmin(self.used))
        self.used[row] = True
        return row
