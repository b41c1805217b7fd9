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

The measurements are the body's middle, which is at (x, y) plus c to the left of the heading, and
the body's axis mod pi, heading - sway atan(rate s / speed): the projection of Crenshaw's helix into
the picture. The steps for one cell are compiled (`kernels.helix_steps`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.lab.cameras.cells.kernels import helix_steps
from tetractl.lab.cameras.cells.kernels.helix_path import LOOSE
from tetractl.lab.cameras.cells.kernels.helix_steps import (
    HEADING,
    RATE,
    SPEED,
    STATES,
    SWAY,
    A,
    C,
    S,
    X,
    Y,
)

HELIX = 2 * math.pi * 2.5, 2.0  # mean and standard deviation of the rate among cells [rad/s]
HELIX_UM = 6.0  # standard deviation of c and s among cells
NEW = 6.0, 6.0, 0.35, 80.0, HELIX_UM, HELIX_UM, HELIX[1]  # deviations of a new cell's first states
A_PRIOR = 3.0, 3.0
BIAS_PRIOR = 0.15
FLOW_UM_S = 4.0
# growth of standard deviations per sqrt(s): x, y, heading, speed, c, s, rate, a, bias
GROWTH = (2.0, 2.0, 0.07, 12.0, 2.0, 2.0, 0.3, 0.02, 0.005)
WALL_UM = 60.0  # distance from the arena's edge within which a wall may turn a cell
# standard deviation of unexplained turning [rad/s] with and without a known field
TURN_KNOWN, TURN_UNKNOWN = 0.1, 3.0
DELAY_S = 0.015  # standard deviation of the delay
SWAY_PRIOR = 0.8, 0.3
# relative deviations of a mean speed and of a for what a picture does not show, as an axis that
# leaves the picture's plane
SPEED_ERROR, A_ERROR = 0.004, 0.02

Piece = tuple[float, float, float]
"""A constant field: duration [s], and x and y components relative to the reference field."""

NearWall = Callable[[Floats, Floats], Bools]
"""Function that returns whether a wall may turn cells at positions x, y (R,) [um]."""


def open_water(x: Floats, y: Floats) -> Bools:
    """Return False for all positions: there are no walls."""
    return np.zeros(len(x), bool)


def new_cell(pose: tuple[float, float, float, float], known: bool) -> tuple[Floats, Floats]:
    """Return the state (n,) and covariance (n, n) of a new cell: x, y [um], heading [rad] and speed
    [um/s] are `pose`; `known` as in `HelixFilter`.
    """
    turn = TURN_KNOWN if known else TURN_UNKNOWN
    a, a_sd = A_PRIOR if known else (0.0, 1e-6)
    mean = np.zeros(STATES)
    mean[[X, Y, HEADING, SPEED]], mean[RATE], mean[A], mean[SWAY] = pose, HELIX[0], a, SWAY_PRIOR[0]
    deviations = (*NEW, a_sd, BIAS_PRIOR, turn, FLOW_UM_S, FLOW_UM_S, DELAY_S, 0.0, SWAY_PRIOR[1])
    return mean, np.diag(np.square(deviations))


@dataclass(slots=True)
class HelixFilter:
    """A filter with one row per cell: `mean` (R, n) and `covariance` (R, n, n); `used` is False
    for free rows.

    `known`: whether the field is known, so that little turning is unexplained. `growth` (R, 9) is
    the growth of the standard deviations of the first nine states per sqrt(s). `near_wall` says
    where a wall may turn cells: turning there leaves the estimates of states a and bias unchanged.
    """

    known: bool = True
    near_wall: NearWall = open_water
    growth: Floats = field(default_factory=lambda: np.zeros((0, len(GROWTH))))
    mean: Floats = field(default_factory=lambda: np.zeros((0, STATES)))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, STATES, STATES)))
    used: Bools = field(default_factory=lambda: np.zeros(0, bool))
    _field: Floats | None = None  # the last piece's x, y

    def __post_init__(self) -> None:
        """Compile the steps now, and not while pictures wait."""
        self.add(0.0, 0.0, 0.0, 0.0)
        self.predict([(1.0, 0.0, 0.0)])
        self.update(np.zeros(1, int), np.zeros((1, 3)), np.ones((1, 3)))
        self.seen(np.zeros(1, int))
        self.drop(0)
        self._field = None

    def add(self, x: float, y: float, heading: float, speed: float) -> int:
        """Add a new cell by its position [um], heading [rad] and speed [um/s]; return its row."""
        row = self._free()
        pose = x, y, heading, speed
        self.mean[row], self.covariance[row] = new_cell(pose, self.known)
        return row

    def copied(self, row: int) -> int:
        """Copy a row to a free row; return the index of the copy."""
        new = self._free()
        self.mean[new], self.covariance[new] = self.mean[row], self.covariance[row]
        self.growth[new] = self.growth[row]
        return new

    def moved(self, row: int, x: float, y: float, heading: float) -> int:
        """Copy a cell's row to a free row and move the copy to another pose, keeping speed, turning
        and helix rate; return the index of the copy.
        """
        new = self.copied(row)
        for state, value in ((X, x), (Y, y), (HEADING, heading), (C, 0.0), (S, 0.0)):
            self.mean[new, state] = value
            self.covariance[new, state, :] = self.covariance[new, :, state] = 0.0
            self.covariance[new, state, state] = NEW[state] ** 2
        return new

    def drop(self, row: int) -> None:
        """Free a row."""
        self.used[row] = False

    def predict(self, pieces: Sequence[Piece]) -> None:
        """Predict every row over successive pieces of constant field."""
        turn_sd = TURN_KNOWN if self.known else TURN_UNKNOWN
        for piece in np.array(pieces, np.float64).reshape(-1, 3):
            if piece[0] > 0:
                walled = self.near_wall(self.mean[:, X], self.mean[:, Y])
                before = piece[1:] if self._field is None else self._field
                rows = self.mean, self.covariance, self.used, self.growth
                helix_steps.predict(*rows, turn_sd, walled, before, piece)
                self._field = piece[1:]

    def loosen(self, rows: Sequence[int]) -> None:
        """Increase the uncertainty of position, heading, speed, c and s of cells that move
        unexpectedly.
        """
        for state, deviation in enumerate(LOOSE):
            self.covariance[rows, state, state] += deviation**2

    def seen(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Return the predicted x, y and axis of the body (M, 3) for rows (M,), and their
        derivatives with respect to the states (M, 3, n).
        """
        expected, slopes = np.empty((len(rows), 3)), np.empty((len(rows), 3, STATES))
        helix_steps.seen(self.mean, rows, expected, slopes)
        return expected, slopes

    def expected(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Return the predicted x, y and axis of the body (M, 3) for rows (M,), and the covariances
        of its position (M, 2, 2) [um^2].
        """
        expected, slopes = self.seen(rows)
        places = slopes[:, :2]
        return expected, places @ self.covariance[rows] @ places.transpose(0, 2, 1)

    def update(
        self, rows: np.ndarray, measured: Floats, deviation: Floats
    ) -> tuple[Floats, Floats]:
        """Update rows (M,) by measurements of x, y [um] and axis [rad] (M, 3) with standard
        deviations (M, 3).

        Returns the measurements' log-likelihoods (M,) by Student's distribution, and their squared
        Mahalanobis distances (M,) from the prediction.
        """
        likelihood, distance = np.empty(len(rows)), np.empty(len(rows))
        given = rows, np.ascontiguousarray(measured), np.ascontiguousarray(deviation)
        helix_steps.update(self.mean, self.covariance, *given, likelihood, distance)
        return likelihood, distance

    def _free(self) -> int:
        if self.used.all():
            self.mean = np.concatenate([self.mean, np.zeros((16, STATES))])
            self.covariance = np.concatenate([self.covariance, np.zeros((16, STATES, STATES))])
            self.growth = np.concatenate([self.growth, np.zeros((16, len(GROWTH)))])
            self.used = np.concatenate([self.used, np.zeros(16, bool)])
        row = int(np.argmin(self.used))
        self.used[row], self.growth[row] = True, GROWTH
        return row
