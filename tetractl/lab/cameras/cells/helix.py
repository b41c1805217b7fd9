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

The measurements are the body's middle, which is at (x, y) plus c to the left of the heading, and
the body's axis mod pi, heading - atan(rate s / speed): the projection of Crenshaw's helix into the
picture.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Bools, Floats

X, Y, HEADING, SPEED, C, S, RATE, A, BIAS, TURN, FLOW_X, FLOW_Y = range(12)
STATES = 12

HELIX = 2 * math.pi * 2.5, 2.0  # mean and standard deviation of the rate among cells [rad/s]
HELIX_UM = 6.0  # standard deviation of c and s among cells
NEW = 6.0, 6.0, 0.35, 80.0, HELIX_UM, HELIX_UM, HELIX[1]  # deviations of a new cell's first states
A_PRIOR = 3.0, 3.0
BIAS_PRIOR = 0.15
FLOW_UM_S = 4.0
SLOWEST_UM_S = 60.0  # below this speed a cell rests, and its helix does not give its axis
BACKWARDS_UM_S = -60.0  # speed along the heading below which the heading is reversed
# growth of standard deviations per sqrt(s): x, y, heading, speed, c, s, rate, a, bias
GROWTH = (2.0, 2.0, 0.07, 12.0, 2.0, 2.0, 0.3, 0.02, 0.005)
# additional growth at rest, since a cell may go on in any direction
RESTING = ((HEADING, 0.5), (SPEED, 150.0))
WALL_UM = 60.0  # distance from the arena's edge within which a wall may turn a cell
WALL_TURN = 1.0  # additional growth of the heading's deviation there [rad/sqrt(s)]
TURN_S = 0.5  # time constant with which unexplained turning is forgotten
# standard deviation of unexplained turning [rad/s] with and without a known field
TURN_KNOWN, TURN_UNKNOWN = 0.1, 3.0
TAIL = 8.0  # degrees of freedom of Student's distribution, for which outliers cost little
ODD = 25.0  # squared distance, in standard deviations, above which a measurement gets less weight

Piece = tuple[float, float, float]
"""A constant field: duration [s], and x and y components relative to the reference field."""

NearWall = Callable[[Floats, Floats], Bools]
"""Function that returns whether a wall may turn cells at positions x, y (R,) [um]."""


def open_water(x: Floats, y: Floats) -> Bools:
    """Return False for all positions: there are no walls."""
    return np.zeros(len(x), bool)


@dataclass(slots=True)
class HelixFilter:
    """A filter with one row per cell: `mean` (R, 12) and `covariance` (R, 12, 12); `used` is False
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

    def add(self, x: float, y: float, heading: float, speed: float) -> int:
        """Add a new cell by its position [um], heading [rad] and speed [um/s]; return its row."""
        row = self._free()
        turn = TURN_KNOWN if self.known else TURN_UNKNOWN
        a, a_sd = A_PRIOR if self.known else (0.0, 1e-6)
        self.mean[row] = (x, y, heading, speed, 0, 0, HELIX[0], a, 0, 0, 0, 0)
        deviations = (*NEW, a_sd, BIAS_PRIOR, turn, FLOW_UM_S, FLOW_UM_S)
        self.covariance[row] = np.diag(np.square(deviations))
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
        for seconds, ux, uy in pieces:
            if seconds > 0:
                self._move(seconds, ux, uy)

    def loosen(self, rows: Sequence[int]) -> None:
        """Increase the uncertainty of position, heading, speed, c and s of cells that move
        unexpectedly.
        """
        for state, deviation in ((X, 5), (Y, 5), (HEADING, 0.3), (SPEED, 120), (C, 4), (S, 4)):
            self.covariance[rows, state, state] += deviation**2

    def seen(self, rows: np.ndarray) -> tuple[Floats, Floats]:
        """Return the predicted x, y and axis of the body (M, 3) for rows (M,), and their
        derivatives with respect to the states (M, 3, 12).
        """
        m = self.mean[rows]
        cos, sin = np.cos(m[:, HEADING]), np.sin(m[:, HEADING])
        speed = np.maximum(m[:, SPEED], SLOWEST_UM_S)
        across = m[:, RATE] * m[:, S]
        tilt = np.arctan2(across, speed)
        found = np.column_stack(
            [m[:, X] - m[:, C] * sin, m[:, Y] + m[:, C] * cos, m[:, HEADING] - tilt]
        )
        slopes = np.zeros((len(m), 3, STATES))
        slopes[:, 0, X] = slopes[:, 1, Y] = slopes[:, 2, HEADING] = 1
        slopes[:, 0, HEADING], slopes[:, 1, HEADING] = -m[:, C] * cos, -m[:, C] * sin
        slopes[:, 0, C], slopes[:, 1, C] = -sin, cos
        squared = speed**2 + across**2
        slopes[:, 2, S] = -m[:, RATE] * speed / squared
        slopes[:, 2, RATE] = -m[:, S] * speed / squared
        slopes[:, 2, SPEED] = np.where(m[:, SPEED] > SLOWEST_UM_S, across / squared, 0.0)
        return found, slopes

    def update(
        self, rows: np.ndarray, measured: Floats, deviation: Floats
    ) -> tuple[Floats, Floats]:
        """Update rows (M,) by measurements of x, y [um] and axis [rad] (M, 3) with standard
        deviations (M, 3).

        Returns the measurements' log-likelihoods (M,) by Student's distribution, and their squared
        Mahalanobis distances (M,) from the prediction.
        """
        if len(rows) == 0:
            return np.zeros(0), np.zeros(0)
        expected, slopes = self.seen(rows)
        off = measured - expected
        off[:, 2] = (off[:, 2] + math.pi / 2) % math.pi - math.pi / 2
        covariance = self.covariance[rows]
        cross = covariance @ slopes.transpose(0, 2, 1)
        spread = slopes @ cross
        noise = np.square(deviation)
        index = np.arange(3)
        spread[:, index, index] += noise
        distance = np.einsum("ri,rij,rj->r", off, np.linalg.inv(spread), off)
        likelihood = -(TAIL + 3) / 2 * np.log1p(distance / TAIL)
        likelihood -= 0.5 * np.linalg.slogdet(spread)[1]
        excess = np.maximum(distance / ODD, 1.0) - 1
        spread[:, index, index] += excess[:, None] * spread[:, index, index]
        gain = cross @ np.linalg.inv(spread)
        self.mean[rows] += np.einsum("rij,rj->ri", gain, off)
        updated = covariance - gain @ cross.transpose(0, 2, 1)
        self.covariance[rows] = (updated + updated.transpose(0, 2, 1)) / 2
        self._turn_round(rows)
        return likelihood, distance

    def _turn_round(self, rows: np.ndarray) -> None:
        """Reverse the heading of cells that seem to swim backwards: it points to the wrong end of
        the axis.
        """
        wrong = rows[self.mean[rows, SPEED] < BACKWARDS_UM_S]
        if len(wrong):
            signs = np.ones(STATES)
            signs[[SPEED, C, S]] = -1
            self.mean[wrong] *= signs
            self.mean[wrong, HEADING] += math.pi
            self.covariance[wrong] *= signs[:, None] * signs

    def _free(self) -> int:
        if self.used.all():
            self.mean = np.concatenate([self.mean, np.zeros((16, STATES))])
            self.covariance = np.concatenate([self.covariance, np.zeros((16, STATES, STATES))])
            self.growth = np.concatenate([self.growth, np.zeros((16, len(GROWTH)))])
            self.used = np.concatenate([self.used, np.zeros(16, bool)])
        row = int(np.argmin(self.used))
        self.used[row], self.growth[row] = True, GROWTH
        return row

    def _move(self, seconds: float, ux: float, uy: float) -> None:
        rows = np.flatnonzero(self.used)
        m = self.mean[rows]
        half = seconds / 2
        towards, slope = _field(m[:, HEADING] + m[:, BIAS], ux, uy)
        resting, walled = m[:, SPEED] < SLOWEST_UM_S, self.near_wall(m[:, X], m[:, Y])
        towards, a = np.where(resting, 0.0, towards), np.where(resting, 0.0, m[:, A])
        rate, bend = a * towards + m[:, TURN], a * slope
        middle = m[:, HEADING] + rate * half
        towards_2, slope_2 = _field(middle + m[:, BIAS], ux, uy)
        towards_2, bend_2 = np.where(resting, 0.0, towards_2), a * slope_2
        f = np.zeros((len(rows), STATES, STATES))
        f[:, range(STATES), range(STATES)] = 1
        # derivatives of the headings halfway, along which the cell moves, and at the end
        to_middle = {HEADING: 1 + bend * half, A: towards * half, BIAS: bend * half, TURN: half}
        direct = {A: towards_2, BIAS: bend_2, TURN: 1.0}
        for state in (A, BIAS):
            to_middle[state] = np.where(walled, 0.0, to_middle[state])
            direct[state] = np.where(walled, 0.0, direct[state])
        cos, sin = np.cos(middle), np.sin(middle)
        for state, part in to_middle.items():
            f[:, X, state] = -m[:, SPEED] * sin * seconds * part
            f[:, Y, state] = m[:, SPEED] * cos * seconds * part
            f[:, HEADING, state] += seconds * (direct.get(state, 0.0) + bend_2 * part)
        f[:, X, SPEED], f[:, Y, SPEED] = cos * seconds, sin * seconds
        f[:, X, FLOW_X] = f[:, Y, FLOW_Y] = seconds
        angle = m[:, RATE] * seconds
        cos_h, sin_h = np.cos(angle), np.sin(angle)
        c, s = m[:, C] * cos_h - m[:, S] * sin_h, m[:, C] * sin_h + m[:, S] * cos_h
        f[:, C, C], f[:, C, S], f[:, C, RATE] = cos_h, -sin_h, -s * seconds
        f[:, S, C], f[:, S, S], f[:, S, RATE] = sin_h, cos_h, c * seconds
        forget = math.exp(-seconds / TURN_S)
        f[:, TURN, TURN] = forget
        m[:, X] += (m[:, SPEED] * cos + m[:, FLOW_X]) * seconds
        m[:, Y] += (m[:, SPEED] * sin + m[:, FLOW_Y]) * seconds
        m[:, HEADING] += (a * towards_2 + m[:, TURN]) * seconds
        m[:, C], m[:, S] = c, s
        m[:, TURN] *= forget
        noise = np.zeros((len(rows), STATES))
        noise[:, : len(GROWTH)] = np.square(self.growth[rows]) * seconds
        for state, deviation in RESTING:
            noise[:, state] += deviation**2 * seconds * resting
        noise[:, HEADING] += WALL_TURN**2 * seconds * walled
        noise[:, TURN] = (TURN_KNOWN if self.known else TURN_UNKNOWN) ** 2 * (1 - forget**2)
        if not self.known:
            noise[:, A] = 0.0
        covariance = f @ self.covariance[rows] @ f.transpose(0, 2, 1)
        covariance[:, range(STATES), range(STATES)] += noise
        self.mean[rows], self.covariance[rows] = m, covariance


def _field(dipole: Floats, ux: float, uy: float) -> tuple[Floats, Floats]:
    """Return the turning rate (R,) for a = 1 by equation (3), for dipoles with directions (R,)
    [rad] in the field (ux, uy), and its derivative with respect to the direction.
    """
    cos, sin = np.cos(dipole), np.sin(dipole)
    return uy * cos - ux * sin, -(uy * sin + ux * cos)
