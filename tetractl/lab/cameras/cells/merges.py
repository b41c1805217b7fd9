"""Cells that share a blob, and their identities once they separate."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Floats
from tetractl.lab.cameras.cells.cell import CellAnswer, FollowedCell, Merge
from tetractl.lab.cameras.cells.helix import HEADING, HelixFilter
from tetractl.lab.cameras.cells.identity import MOST, Question, opened
from tetractl.lab.cameras.cells.match import second_best

CLEAR = 25.0  # difference of squared distances between two assignments that decides at once
CLEAR_UM = 3.0  # standard deviation of a position, in addition to the filter's
REMEMBERED_S = 0.5  # time for which a copied row is kept after the cell's blob was too large


class Merges:
    """Records which cells share blobs, and identifies the cells once they have separated."""

    def __init__(self, bank: HelixFilter) -> None:
        self._bank = bank
        self._merges: list[Merge] = []
        self.closed: list[CellAnswer] = []

    def join(self, together: Sequence[FollowedCell], cells: Sequence[FollowedCell]) -> None:
        """Record which cells share a blob; copy their filter rows, to be predicted without
        measurements.
        """
        for cell in together:
            if cell.question is not None:
                self._close(cell.question, cells)
        merges = [cell.merge for cell in together if cell.merge is not None]
        merge = merges[0] if merges else Merge([], {})
        for other in merges[1:]:
            if other is not merge and other in self._merges:
                self._merges.remove(other)
                for cell in other.cells:
                    cell.merge = merge
                merge.cells += other.cells
                merge.coasted |= other.coasted
        for cell in together:
            self._drop_alone(cell)
            if cell.merge is None:
                cell.merge = merge
                merge.cells.append(cell)
                merge.coasted[cell.identity] = self._bank.copied(cell.row)
        if merge not in self._merges:
            self._merges.append(merge)

    def watch(self, cell: FollowedCell, large: bool, met: bool, seconds: float) -> None:
        """Keep a copy of a cell's filter row, predicted without measurements, while its blob is too
        large (`large`) and for a short time after. `met` is whether an object that is not followed
        may have entered the blob.
        """
        if large:
            cell.large_s = seconds
            if cell.alone is None and cell.question is None and cell.merge is None:
                cell.size = cell.long, cell.wide
                cell.alone, cell.met = self._bank.copied(cell.row), met
        elif seconds - cell.large_s > REMEMBERED_S:
            self._drop_alone(cell)

    def ask(
        self,
        cell: FollowedCell,
        new: FollowedCell,
        seen: Floats,
        since_s: float,
        cells: Sequence[FollowedCell],
    ) -> None:
        """Open a question: which of two poses `seen` (2, 3) belongs to `cell`, and which to `new`,
        a new cell that separated from the blob of `cell`. An open question about `cell` is closed
        first; `cells` are all cells.
        """
        assert cell.alone is not None, "watch() has copied the cell's filter row"
        if cell.question is not None:
            self._close(cell.question, cells)
        new_row = self._bank.copied(new.row)
        sizes = np.array([cell.size, (np.nan, np.nan)])
        self._ask([cell, new], [cell.alone, new_row], seen, sizes, since_s)
        self._bank.drop(new_row)
        self._drop_alone(cell)

    def part(self, places: dict[int, Floats], seconds: float) -> None:
        """Open a question of identity when cells that shared a blob have separate blobs again.

        `places` gives the x, y [um] and axis [rad] of the blob of each track.
        """
        for merge in list(self._merges):
            if any(cell.merged or cell.large or cell.blob is None for cell in merge.cells):
                continue
            self._merges.remove(merge)
            for cell in merge.cells:
                cell.merge = None
            if 2 <= len(merge.cells) <= MOST:
                seen = np.array([places[cell.track] for cell in merge.cells])
                self._open(merge, seen, seconds)
            for row in merge.coasted.values():
                self._bank.drop(row)

    def answer(self, cells: Sequence[FollowedCell], seconds: float) -> None:
        """Give the cells their identities by the likeliest answer to each question; close the
        questions that are decided.
        """
        for question in {id(c.question): c.question for c in cells if c.question}.values():
            order, _ = question.best()
            for cell in cells:
                if cell.question is question:
                    cell.identity = question.identities[order[cell.place]]
                    cell.row = int(question.rows[cell.place, order[cell.place]])
            if question.closed(seconds):
                self._close(question, cells)

    def forget(self, cell: FollowedCell, cells: Sequence[FollowedCell]) -> None:
        """Remove a lost cell from its shared blob and its question."""
        self._drop_alone(cell)
        if cell.question is not None:
            self._close(cell.question, cells)
        if cell.merge is not None:
            merge = cell.merge
            merge.cells.remove(cell)
            self._bank.drop(merge.coasted.pop(cell.identity))
            if not merge.cells:
                self._merges.remove(merge)

    def _drop_alone(self, cell: FollowedCell) -> None:
        if cell.alone is not None:
            self._bank.drop(cell.alone)
            cell.alone = None

    def _open(self, merge: Merge, seen: Floats, seconds: float) -> None:
        """Keep the identities of separated cells if they are clear; open a question if not."""
        identities = [cell.identity for cell in merge.cells]
        coasted = [merge.coasted[identity] for identity in identities]
        rows = np.array(coasted)
        expected, slopes = self._bank.seen(rows)
        spread = slopes[:, :2] @ self._bank.covariance[rows] @ slopes[:, :2].transpose(0, 2, 1)
        inverse = np.linalg.inv(spread + CLEAR_UM**2 * np.eye(2))
        off = seen[:, None, :2] - expected[None, :, :2]
        squared = np.einsum("tij,ijk,tik->ti", off, inverse, off)
        track, cell = linear_sum_assignment(squared)
        best = float(squared[track, cell].sum())
        clear = best < CLEAR and second_best(squared, best) - best > CLEAR
        if clear and (cell == track).all():
            return
        sizes = np.array([(cell.long, cell.wide) for cell in merge.cells])
        self._ask(merge.cells, coasted, seen, sizes, seconds)

    def _ask(
        self,
        cells: Sequence[FollowedCell],
        coasted: Sequence[int],
        seen: Floats,
        sizes: Floats,
        seconds: float,
    ) -> None:
        """Open a question: which of the cells, predicted in the filter rows `coasted`, is at which
        of the poses `seen` (K, 3): x, y [um] and axis [rad].
        """
        heading = self._bank.mean[[cell.row for cell in cells], HEADING]
        places = seen.copy()
        places[:, 2] += np.pi * np.round((heading - places[:, 2]) / np.pi)
        identities = [cell.identity for cell in cells]
        question = opened(self._bank, identities, coasted, places, sizes, seconds)
        for i, cell in enumerate(cells):
            self._bank.drop(cell.row)
            cell.question, cell.place, cell.row = question, i, int(question.rows[i, i])

    def _close(self, question: Question, cells: Sequence[FollowedCell]) -> None:
        """Settle a question of identity by its likeliest answer, and multiply each cell's certainty
        by the answer's probability.
        """
        order, probability = question.best()
        members = [cell for cell in cells if cell.question is question]
        for cell in members:
            chosen = order[cell.place]
            if chosen != cell.place and np.isfinite(question.sizes[chosen]).all():
                cell.long, cell.wide = question.sizes[chosen].tolist()
            cell.identity = question.identities[chosen]
            cell.row = int(question.rows[cell.place, chosen])
            cell.certainty *= probability
            cell.question = None
        kept = {cell.row for cell in members}
        for row in question.rows.ravel().tolist():
            if row not in kept:
                self._bank.drop(row)
        tracks = tuple(cell.track for cell in members)
        answer = tuple(cell.identity for cell in members)
        self.closed.append(CellAnswer(tracks, answer, question.since_s, probability))
