"""Cells that are not seen any more and may come back.

A new cell is one of them, lost cell n, or one that was never seen, with the probability

    p(n) = f_n / (f_1 + ... + f_N + e)

where f_n [1/um^2] is the density with which lost cell n comes back at this place
and e that with which other cells appear there.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell_tracks import CellTrack, Known
from tetractl_microscope.cells.helix import SPEED, HelixFilter

BACK_WITHIN_S = 3.0  # time for which a lost cell can come back
LOST_MOST = 16  # most cells remembered
AWAY = 0.77  # standard deviation of a lost cell's place, in addition to the filter's [lengths]
REACH = 1.15  # largest distance of a lost cell from its last place, besides speed times time
SAME = 0.08  # standard deviation of log(size) of one cell
ALIKE = 0.25  # among cells
RETURNS = 0.25  # probability of each: a lost cell has swum on, rests, or has turned


@dataclass(frozen=True, slots=True, eq=False)
class LostCell:
    """A `cell` that was `last` seen at x, y [um], at the time `since_s` [s]; the filter's `row`
    predicts it.
    """

    cell: Known
    row: int
    last: Floats
    since_s: float


class LostCells:
    """The cells that may come back, in the order in which they were lost; their filter rows are
    freed when they are removed. `bank` is the filter; a cell is `body_um` long.
    """

    def __init__(self, bank: HelixFilter, body_um: float) -> None:
        self._bank = bank
        self._body_um = body_um
        self._cells: list[LostCell] = []

    def add(self, lost: LostCell) -> None:
        """Add a cell that was just lost."""
        self._cells.append(lost)

    def remove(self, lost: LostCell) -> None:
        """Remove a cell that is back, or that will not come back, and free its filter row."""
        self._cells.remove(lost)
        self._bank.drop(lost.row)

    def remove_late(self, seconds: float) -> None:
        """Remove cells that were lost too long before a time [s], and the oldest of too many."""
        while self._cells:
            oldest = self._cells[0]
            if len(self._cells) <= LOST_MOST and seconds - oldest.since_s <= BACK_WITHIN_S:
                return
            self.remove(oldest)

    def likeliest(
        self, track: CellTrack, place: Floats, since_s: float, appear: float
    ) -> tuple[LostCell | None, float]:
        """Return the lost cell that a new `track`, first seen at a time [s], most probably shows,
        and the probability that it does; None without lost cells. The track is at x, y [um] and
        axis [rad] `place` (3,); cells that were never seen `appear` there with a density [1/um^2].
        """
        if not self._cells:
            return None, 0.0
        size = np.array(track.size)
        densities = [
            _return_density(self._bank, lost, place[:2], size, since_s, self._body_um)
            for lost in self._cells
        ]
        best = int(np.argmax(densities))
        return self._cells[best], densities[best] / (sum(densities) + appear)

    def shift(self, x: float, y: float) -> None:
        """Move the cells' last places by x, y [um], with the picture's content."""
        moved = np.array((x, y))
        self._cells = [replace(lost, last=lost.last + moved) for lost in self._cells]


def _return_density(
    bank: HelixFilter, lost: LostCell, place: Floats, size: Floats, now: float, body_um: float
) -> float:
    """Return the probability density [1/um^2] that a lost cell reappears at a time [s] at
    `place` (2,), with the length and width `size` [um]; a cell is `body_um` long.

    The cell has swum on as the signal predicts, rests at its last place, or has turned by
    itself.
    """
    row = lost.row
    away_um = AWAY * body_um
    reach = REACH * body_um
    off = place - bank.mean[row, :2]
    spread = bank.covariance[row, :2, :2] + away_um**2 * np.eye(2)
    ahead = math.exp(-off @ np.linalg.solve(spread, off) / 2)
    ahead /= math.tau * math.sqrt(float(np.linalg.det(spread)))
    away = float(np.linalg.norm(place - lost.last))
    rests = math.exp(-((away / away_um) ** 2) / 2) / (math.tau * away_um**2)
    reach += max(0.0, float(bank.mean[row, SPEED])) * (now - lost.since_s)
    within = (away < reach) / (math.pi * reach**2)
    log_ratio = np.log(size / lost.cell.size)
    apart = float(np.square(log_ratio).sum())
    alike = (ALIKE / SAME) ** 2 * math.exp(-apart / 2 * (1 / SAME**2 - 1 / ALIKE**2))
    return RETURNS * (ahead + rests + within) * alike
