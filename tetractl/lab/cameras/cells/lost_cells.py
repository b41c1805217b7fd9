"""Lost cells, which are no longer followed, and the probability that a new cell is one of them.

A lost cell has swum on as the signal predicts, rests at its last position, or has turned by itself.
Cells that were not lost appear at the picture's edge or out of another cell's blob, rarely anywhere
else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.cell import FollowedCell
from tetractl.lab.cameras.cells.helix import SPEED, HelixFilter

REMEMBERED_S = 3.0  # time for which a lost cell can come back
REMEMBERED = 16  # largest number of remembered lost cells
PLACE_UM = 40.0  # standard deviation of a lost cell's position, in addition to the filter's
REACH_UM = 60.0  # largest distance from its last position, in addition to speed times time
SAME, ALIKE = 0.08, 0.25  # standard deviations of log(size) of one cell and among cells
RETURNS = 0.25  # probability of each: a lost cell has swum on, rests, or has turned
NEW, ENTERED = 0.3, 10.0  # cells expected to appear in the picture: anywhere, and at its edge
LEAST, MOST = 0.5, 0.9  # least probability of an accepted lost cell, largest one returned


@dataclass(slots=True)
class LostCells:
    """The lost cells; the filter `bank` still predicts their rows."""

    bank: HelixFilter
    _lost: list[tuple[FollowedCell, float, Floats]] = field(default_factory=list)

    def add(self, cell: FollowedCell, seconds: float) -> None:
        """Remember a cell that is given up as lost at a time [s]; its filter row is freed later."""
        self._lost.append((cell, seconds - cell.missed_s, cell.last))
        if len(self._lost) > REMEMBERED:
            self._drop(0)

    def forget(self, seconds: float) -> None:
        """Forget the cells that were lost too long ago."""
        while self._lost and seconds - self._lost[0][1] > REMEMBERED_S:
            self._drop(0)

    def found(
        self, place: Floats, size: Sequence[float], seconds: float, elsewhere: float
    ) -> tuple[FollowedCell, float] | None:
        """Return the lost cell that is the likeliest to appear at a position (2,) [um], and its
        probability; None if a cell that was not lost is likelier than that.

        `size` is length and width [um] of the cell that appears; `elsewhere` is the density
        [1/um^2] of cells that appear at this position without having been lost.
        """
        weights = [self._weight(*lost, place, np.array(size), seconds) for lost in self._lost]
        total = elsewhere + sum(weights)
        best = max(range(len(weights)), key=weights.__getitem__, default=None)
        if best is None or weights[best] < LEAST * total:
            return None
        return self._lost.pop(best)[0], min(weights[best] / total, MOST)

    def _weight(
        self,
        cell: FollowedCell,
        lost_s: float,
        last: Floats,
        place: Floats,
        size: Floats,
        now: float,
    ) -> float:
        """Return the probability density [1/um^2] that a cell, lost at the time `lost_s` [s] at
        the position `last` [um], reappears at the time `now` at `place`, with the length and width
        `size` [um].
        """
        off = place - self.bank.mean[cell.row, :2]
        spread = self.bank.covariance[cell.row, :2, :2] + PLACE_UM**2 * np.eye(2)
        ahead = math.exp(-off @ np.linalg.solve(spread, off) / 2)
        ahead /= math.tau * math.sqrt(float(np.linalg.det(spread)))
        away = float(np.linalg.norm(place - last))
        rests = math.exp(-((away / PLACE_UM) ** 2) / 2) / (math.tau * PLACE_UM**2)
        reach = REACH_UM + float(self.bank.mean[cell.row, SPEED]) * (now - lost_s)
        within = (away < reach) / (math.pi * reach**2)
        apart = float(np.square(np.log(size / (cell.long, cell.wide))).sum())
        alike = (ALIKE / SAME) ** 2 * math.exp(-apart / 2 * (1 / SAME**2 - 1 / ALIKE**2))
        return RETURNS * (ahead + rests + within) * alike

    def _drop(self, which: int) -> None:
        self.bank.drop(self._lost.pop(which)[0].row)
