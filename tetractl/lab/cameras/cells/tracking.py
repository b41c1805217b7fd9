"""Tracks cells through a sequence of pictures: assigns blobs to cells and updates their states.

A blob is assigned to the cell that the filter, given the known signal, expects at its place. Cells
that touch share one blob; once they separate, `identity` decides which is which. An object that
does not swim is a speck, not a cell.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl.lab.cameras.cells.cell import Born, CellAnswer, FollowedCell, SeenCell
from tetractl.lab.cameras.cells.detect_cells import Blob, BlobFinder, Light
from tetractl.lab.cameras.cells.helix import HEADING, HelixFilter, NearWall, Piece, open_water
from tetractl.lab.cameras.cells.lost_cells import ENTERED, NEW, LostCells
from tetractl.lab.cameras.cells.match import (
    LARGE,
    assigned,
    parted,
    places_of,
    separated,
    shared_blobs,
    stopped,
)
from tetractl.lab.cameras.cells.merges import Merges
from tetractl.lab.cameras.cells.specks import BORN, FROM_UM, Speck, Specks, straight
from tetractl.model.organisms import TETRAHYMENA, Organism

TOGETHER = 3.2  # the largest blob that is considered, in areas of a large cell: cells touch
CELLS = 64  # largest number of cells that are followed
LOST_S = 0.7  # time without a blob after which a cell is lost
HIDDEN_S = 0.15  # time without a blob after which a cell is not reported
GONE_S = 0.1  # time without a blob after which a cell near the picture's edge has left
OUTSIDE = 0.4  # distance to the edge that counts as near, in lengths of the cell
STARTED_UM, STARTED_S = 60.0, 1.0  # a track that has not swum this far in this time is not a cell
POSITION_PX, POSITION_UM, AXIS = 0.2, 0.4, 0.02  # standard deviations of a blob's measurement
ODD = (8.0, 8.0, 0.5)  # deviations of x, y [um], axis [rad] for a blob cut off or too large
MERGED = (7.0, 7.0, 10.0)  # deviations for a cell in a shared blob
HIDDEN = (30.0, 30.0, 10.0)  # deviations if the shared blob is only as large as one of its cells
ODD_RUN = 3  # successive blobs far from their expected positions that make the filter uncertain
ODD_DISTANCE = 30.0  # squared Mahalanobis distance above which a blob counts as far
ASTRAY_UM = 35.0  # distance of a cell's state from its own blob above which the state is wrong
ENTERED_UM = 120.0  # a new cell nearer than this to the picture's edge has swum into the picture
EITHER = 0.5  # probability of a cell's identity once another cell has left its blob
DOUBT = 0.75  # probability of a cell's identity while another cell may have been in its blob
OFF_SHARE = 0.3  # deviation of a cell's position per excess length of its blob
SHAPE_SHARE = 0.05  # weight of a new blob in a cell's usual size

FieldPieces = Callable[[float, float], Sequence[Piece]]
"""Function that returns the field between two times [s] as pieces of constant field."""


@dataclass(slots=True)
class _Reading:
    """A cell's x, y [um] and axis [rad] measured from its blob, with their standard deviations;
    `merged` if cells share the blob.
    """

    cell: FollowedCell
    values: tuple[float, ...]
    deviations: tuple[float, ...]
    merged: bool


class CellTracker:
    """Follows the cells in pictures with the scale `um_px` [um/px]; `known`: whether the field is
    known, `near_wall`: where a wall may turn cells, `organism`: which objects are cells.

    Pictures must be given in order of time. Column c and row r become x = (c + 1/2) um_px and, with
    y upwards, y = (height - 1/2 - r) um_px [um].
    """

    def __init__(
        self,
        um_px: float,
        known: bool,
        bright: bool | None = None,
        near_wall: NearWall = open_water,
        organism: Organism = TETRAHYMENA,
    ) -> None:
        self.um_px = um_px
        least, most = organism.outline_um2
        self.finder = BlobFinder(least / um_px**2, TOGETHER * most / um_px**2, bright)
        self.bank = HelixFilter(known, near_wall)
        self.born: list[Born] = []  # cells recognised in the newest picture
        self._cells: list[FollowedCell] = []
        self._specks = Specks(organism)
        self._merges = Merges(self.bank)
        self._lost = LostCells(self.bank)
        self._next = 1
        self._time: float | None = None
        self._height = self._width = 0

    def learn(self, pictures: Sequence[Grey]) -> None:
        """Compute the background from pictures taken over a second or more."""
        self.finder.learn(pictures)

    @property
    def light(self) -> Light:
        """Light and noise of the newest picture."""
        return self.finder.light

    @property
    def closed(self) -> Sequence[CellAnswer]:
        """The answers to questions of identity that the newest picture decided."""
        return self._merges.closed

    def blob(self, track: int) -> Blob | None:
        """Return the blob of a track in the newest picture, None if it has none."""
        return next((cell.blob for cell in self._cells if cell.track == track), None)

    def see(self, picture: Grey, seconds: float, field: FieldPieces) -> list[SeenCell]:
        """Return the cells in a picture taken at a time [s]; `field` gives the field that acted
        since the picture before.
        """
        passed = 0.0 if self._time is None else seconds - self._time
        pieces = () if self._time is None else field(self._time, seconds)
        self._time, (self._height, self._width) = seconds, picture.shape
        self.born, self._merges.closed = [], []
        self.bank.predict(pieces)
        blobs = self.finder.find(picture)
        if self.finder.light.lost:
            for cell in self._cells:
                cell.blob, cell.merged, cell.measured = None, False, None
                cell.missed_s += passed
        else:
            self._match(blobs, seconds, passed)
        self._give_up()
        self.finder.follow(self._kept())
        return self._shown([cell for cell in self._cells if cell.missed_s < HIDDEN_S])

    def _match(self, blobs: Sequence[Blob], seconds: float, passed: float) -> None:
        """Assign each cell its blob, and update the cell's state."""
        cells, places = self._cells, places_of(blobs, self.um_px, self._height)
        rows = np.array([cell.row for cell in cells], int)
        expected, slopes = self.bank.seen(rows)
        spread = slopes[:, :2] @ self.bank.covariance[rows] @ slopes[:, :2].transpose(0, 2, 1)
        owner, specks = assigned(cells, expected, spread, self._specks.places, places)
        for i in stopped(cells, expected, places, owner, specks):
            self.bank.loosen([cells[i].row])
        shared = shared_blobs(cells, self._pixels(expected), blobs, owner, self.um_px)
        separated(cells, expected, places, owner, shared, specks, self._specks.hidden)
        for i, cell in enumerate(cells):
            j = owner.get(i)
            cell.blob = None if j is None else blobs[j]
            cell.measured = None
            cell.merged = j is not None and len(shared[j]) > 1
            cell.missed_s = 0.0 if j is not None else cell.missed_s + passed
        for owners in shared.values():
            if len(owners) > 1:
                self._merges.join([cells[i] for i in owners], cells)
        self._update(self._readings(shared, expected, places))
        for i, j in owner.items():
            cells[i].last = places[j, :2]
        own = {cell.track: places[owner[i], :3] for i, cell in enumerate(cells) if i in owner}
        self._merges.part(own, seconds)
        self._merges.answer(cells, seconds)
        free = [j for j in range(len(blobs)) if j not in shared]
        here = np.array([self.bank.mean[cell.row, :2] for cell in cells]).reshape(-1, 2)
        tracks = [cell.track for cell in cells]
        for speck in self._specks.follow(places[free], here, tracks, seconds):
            if len(self._cells) < CELLS:
                self._begin(speck)

    def _readings(
        self, shared: dict[int, list[int]], expected: Floats, places: Floats
    ) -> list[_Reading]:
        """Return the measurement of each cell, taken from its blob; update the cells' usual
        sizes."""
        found = []
        least = POSITION_UM + POSITION_PX * self.um_px
        for j, owners in shared.items():
            cells = [self._cells[i] for i in owners]
            blob = cells[0].blob
            assert blob is not None
            if len(cells) > 1:
                most = max(each.long * each.wide for each in cells)
                deviations = HIDDEN if places[j, 3] * places[j, 4] < LARGE * most else MERGED
                middles = parted(cells, expected[owners], self._points(blob))
                for cell, i, (x, y) in zip(cells, owners, middles.tolist(), strict=True):
                    found.append(_Reading(cell, (x, y, expected[i, 2]), deviations, True))
                continue
            cell, (x, y, axis, long, wide) = cells[0], places[j].tolist()
            larger = long * wide / (cell.long * cell.wide)
            odd = larger > LARGE or larger < 1 / LARGE**2 or blob.at_edge
            large = larger > LARGE
            cell.large = large
            self._merges.watch(cell, large, large and self._meets(cell), self._time or 0.0)
            off = max(ODD[0], OFF_SHARE * (long - cell.long))
            usual = least, least, AXIS / max(1 - wide / long, 0.05)
            deviations = (off, off, ODD[2]) if odd else usual
            cell.measured = (x, y, axis, *deviations)
            if cell.question is not None and not blob.at_edge:
                cell.question.add_size(cell.place, (long, wide))
            found.append(_Reading(cell, (x, y, axis), deviations, False))
            if not odd:
                cell.long += SHAPE_SHARE * (long - cell.long)
                cell.wide += SHAPE_SHARE * (wide - cell.wide)
        return found

    def _update(self, readings: Sequence[_Reading]) -> None:
        """Update the filter by the readings; a track with an open question has one row for each
        cell that it may be.
        """
        if not readings:
            return
        rows = [
            [one.cell.row] if one.cell.question is None else one.cell.question.rows[one.cell.place]
            for one in readings
        ]
        counts = [len(each) for each in rows]
        likelihood, distance = self.bank.update(
            np.concatenate(rows).astype(int),
            np.repeat([one.values for one in readings], counts, axis=0),
            np.repeat([one.deviations for one in readings], counts, axis=0),
        )
        at = 0
        for one, count in zip(readings, counts, strict=True):
            cell = one.cell
            if cell.question is not None:
                cell.question.add(cell.place, likelihood[at : at + count])
            elif not one.merged:
                cell.odd = cell.odd + 1 if distance[at] > ODD_DISTANCE else 0
                x, y = self.bank.mean[cell.row, :2].tolist()
                away = math.hypot(one.values[0] - x, one.values[1] - y)
                if away > ASTRAY_UM and one.deviations[2] < ODD[2]:
                    self._put_back(cell, *one.values)
                elif cell.odd >= ODD_RUN:
                    self.bank.loosen([cell.row])
                    cell.odd = 0
            at += count

    def _put_back(self, cell: FollowedCell, x: float, y: float, axis: float) -> None:
        """Move a cell's state to its blob, since the filter predicted the cell far from it."""
        vx, vy = x - cell.last[0], y - cell.last[1]
        backwards = math.cos(axis) * vx + math.sin(axis) * vy < 0
        row = self.bank.moved(cell.row, x, y, axis + math.pi * backwards)
        self.bank.drop(cell.row)
        cell.row, cell.odd = row, 0

    def _begin(self, speck: Speck) -> None:
        """Start to follow a speck as a cell, since it swims."""
        path = np.array(speck.path)
        last = path[-BORN:]
        (vx, vy), fitted = straight(last)
        x, y = fitted[-1].tolist()
        heading = math.atan2(vy, vx)
        long, wide = np.median(path[:, 4:6], axis=0).tolist()
        now, beside = float(path[-1, 0]), self._beside(speck)
        near_edge = self._near_edge(*path[0, 1:3].tolist())
        lost = self._lost.found(path[-1, 1:3], (long, wide), now, self._density(near_edge, beside))
        if lost is None:
            row = self.bank.add(x, y, heading, math.hypot(vx, vy))
            identity, certainty, begun = self._next, 1.0, (now, x, y)
        else:
            old, probability = lost
            row, identity = self.bank.moved(old.row, x, y, heading), old.identity
            certainty = old.certainty * probability
            self.bank.drop(old.row)
            begun = None
        new = FollowedCell(identity, self._next, row, long, wide, certainty, begun=begun)
        self._cells.append(new)
        divided = None
        if beside is not None and beside.alone is not None and beside.met:
            seen, _ = self.bank.seen(np.array([beside.row, row]))
            self._merges.ask(beside, new, seen, float(path[0, 0]), self._cells)
        elif beside is not None and lost is None and not near_edge:
            beside.certainty *= EITHER
            divided = beside.identity if beside.merge is None else None
        # keep the path after the last blob too large for this cell: another cell was in that blob
        other = path[:-1, 4:6].prod(axis=1) > LARGE * long * wide
        path = path[int(np.flatnonzero(other).max(initial=-1)) + 1 :]
        self.born.append(Born(identity, self._next, path[:, :4], certainty, divided))
        self._next += 1

    def _beside(self, speck: Speck) -> FollowedCell | None:
        """Return the cell next to which a speck was first seen, None if no cell was near."""
        return next((cell for cell in self._cells if cell.track == speck.beside), None)

    def _density(self, near_edge: bool, beside: FollowedCell | None) -> float:
        """Return the density [1/um^2] of cells that appear at a place without having been lost."""
        if beside is not None and beside.alone is not None:
            return EITHER / (math.pi * FROM_UM**2)
        area = self._width * self._height * self.um_px**2
        return (ENTERED if near_edge else NEW) / area

    def _meets(self, cell: FollowedCell) -> bool:
        """Return whether an object that is not followed may be about to enter a cell's blob."""
        x, y = self.bank.mean[cell.row, :2].tolist()
        near = np.linalg.norm(self._specks.places - (x, y), axis=1) < FROM_UM
        return bool(near.any()) or cell.begun is not None or self._near_edge(x, y)

    def _near_edge(self, x: float, y: float) -> bool:
        """Return whether a cell at a position [um] may just have swum into the picture."""
        right, top = self._width * self.um_px, self._height * self.um_px
        return min(x, y, right - x, top - y) < ENTERED_UM

    def _give_up(self) -> None:
        """Drop cells that have not been seen for long, have left the picture, or never swam."""
        right, top = self._width * self.um_px, self._height * self.um_px
        self._lost.forget(self._time or 0.0)
        for cell in list(self._cells):
            (x, y), rim = self.bank.mean[cell.row, :2].tolist(), OUTSIDE * cell.long
            outside = min(x, y, right - x, top - y) < rim
            late = cell.missed_s > (GONE_S if outside else LOST_S)
            if late or not math.isfinite(x + y) or self._stays(cell):
                self._merges.forget(cell, self._cells)
                self._cells.remove(cell)
                if late and not outside and cell.begun is None and self._time is not None:
                    self._lost.add(cell, self._time)
                else:
                    self.bank.drop(cell.row)

    def _stays(self, cell: FollowedCell) -> bool:
        """Return whether a tracked object does not swim, so that it is not a cell."""
        if cell.begun is None or self._time is None:
            return False
        began, x, y = cell.begun
        now = self.bank.mean[cell.row]
        if math.hypot(now[0] - x, now[1] - y) > STARTED_UM:
            cell.begun = None
            return False
        return self._time - began > STARTED_S

    def _pixels(self, places: Floats) -> Floats:
        """Return columns and rows (N, 2) of positions [um]."""
        columns = places[:, 0] / self.um_px - 0.5
        return np.column_stack([columns, self._height - 0.5 - places[:, 1] / self.um_px])

    def _points(self, blob: Blob) -> Floats:
        """Return the positions of a blob's pixels (M, 2) [um]."""
        pixels = blob.pixels
        up = self._height - 0.5 - pixels[:, 1]
        return np.column_stack([pixels[:, 0] + 0.5, up]) * self.um_px

    def _kept(self) -> list[tuple[int, int, int, int]]:
        """Return rectangles [px] around the cells, in which the background is not updated."""
        rows = [cell.row for cell in self._cells]
        found = []
        for cell, (column, row) in zip(
            self._cells, self._pixels(self.bank.mean[rows, :2]).tolist(), strict=True
        ):
            reach = 0.8 * cell.long / self.um_px + 4
            left, top = round(column - reach), round(row - reach)
            found.append((left, top, round(column + reach), round(row + reach)))
        return found

    def _shown(self, cells: Sequence[FollowedCell]) -> list[SeenCell]:
        rows = np.array([cell.row for cell in cells], int)
        seen, _ = self.bank.seen(rows)
        means, covariances = self.bank.mean[rows], self.bank.covariance[rows]
        found, next_to = [], self._specks.next_to
        for i, cell in enumerate(cells):
            x, y, axis = seen[i].tolist()
            doubtful = cell.merge is not None or cell.track in next_to
            doubtful |= cell.alone is not None and cell.met
            open_share = 1.0 if cell.question is None else cell.question.best()[1]
            found.append(
                SeenCell(
                    identity=cell.identity,
                    x=x,
                    y=y,
                    axis=axis,
                    heading=float(means[i, HEADING]),
                    mean=means[i],
                    covariance=covariances[i],
                    probability=cell.certainty * open_share * (DOUBT if doubtful else 1.0),
                    found=cell.blob is not None,
                    merged=cell.merged or (cell.blob is not None and cell.large),
                    long_um=cell.long,
                    wide_um=cell.wide,
                    track=cell.track,
                    measured=cell.measured,
                )
            )
        return found
