"""Cells that are not seen any more and may come back.

A new cell is one of them, lost cell n, or one that was never seen, with the probability

    p(n) = f_n / (f_1 + ... + f_N + e)

where f_n [1/um^2] is the density with which lost cell n comes back at this place (`return_density`)
and e that with which other cells appear there.
"""

from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell_tracks import CellTrack, Known, return_density
from tetractl_microscope.cells.helix import HelixFilter

BACK_WITHIN_S = 3.0  # time for which a lost cell can come back
LOST_MOST = 16  # most cells remembered


@dataclass(frozen=True, slots=True)
class Return:
    """A lost cell that may be back, and the `probability` that it is."""

    cell: Known
    probability: float


class LostCells:
    """The cells that may come back, in the order in which they were lost. `bank` is the filter; a
    cell is `body_um` long.
    """

    def __init__(self, bank: HelixFilter, body_um: float) -> None:
        self._bank = bank
        self._body_um = body_um
        self._cells: list[Known] = []

    def add(self, cell: Known) -> None:
        """Add a cell that was just lost."""
        self._cells.append(cell)

    def remove(self, cell: Known) -> None:
        """Remove a cell that is back, or that will not come back, and free its filter row."""
        self._cells.remove(cell)
        cell.drop_row(self._bank)

    def remove_late(self, seconds: float) -> None:
        """Remove cells that were lost too long before a time [s], and the oldest of too many."""
        while self._cells:
            oldest = self._cells[0]
            if len(self._cells) <= LOST_MOST and seconds - oldest.lost_s <= BACK_WITHIN_S:
                return
            self.remove(oldest)

    def likeliest(
        self, track: CellTrack, place: Floats, since_s: float, appear: float
    ) -> Return | None:
        """Return the lost cell that a new `track`, first seen at a time [s], most probably shows;
        None without lost cells. The track is at x, y [um] and axis [rad] `place` (3,); cells that
        were never seen `appear` there with a density [1/um^2].
        """
        if not self._cells:
            return None
        size = np.array([track.long, track.wide])
        densities = [
            return_density(self._bank, cell, place[:2], size, since_s, self._body_um)
            for cell in self._cells
        ]
        best = int(np.argmax(densities))
        return Return(self._cells[best], densities[best] / (sum(densities) + appear))

    def shift(self, x: float, y: float) -> None:
        """Move the cells' last places by x, y [um], with the picture's content."""
        for cell in self._cells:
            assert cell.last is not None, "a lost cell was seen somewhere"
            cell.last = cell.last + np.array((x, y))
