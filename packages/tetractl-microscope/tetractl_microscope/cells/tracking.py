"""Tracks cells through a sequence of pictures: assigns blobs to tracks and updates their states.

Every object is a track. A blob is assigned to the track that is expected at its place; cells are
expected by the filter, given the known signal. An object that does not swim is a speck, not a cell.
Cells that touch share one blob; once they separate, `names` decides which is which.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import Born, CellAnswer, Entry, SeenCell
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.detect_cells import Blob, BlobFinder
from tetractl_microscope.cells.helix import HEADING, HelixFilter, NearWall, Piece, open_water
from tetractl_microscope.cells.kernels.helix_steps import ODD_DISTANCE, ODD_RUN
from tetractl_microscope.cells.names import FROM, LIKELIER, Names
from tetractl_microscope.cells.readings import (
    MERGED,
    PATH,
    Reading,
    note_size,
    own_path,
    own_reading,
    shared_readings,
)
from tetractl_microscope.cells.specks import BORN, NEAR, NEAR_BORN, straight, swims, usual_size
from tetractl_microscope.organisms import TETRAHYMENA, Organism

TOGETHER = 3.2  # the largest blob that is considered, in areas of a large cell: cells touch
# time without a blob after which a cell is lost, or not reported any more, and for which one is
# looked for away from its expected place, as it may have stopped
LOST_S, HIDDEN_S, LOOKED_S = 0.5, 0.15, 0.2
# the same for one near the picture's edge, which has left it by then, or that has just been found:
# for Tetrahymena, as this is a way
GONE_S = 0.1
GHOST_S = 1.5  # time for which two tracks may share a blob as small as one cell
OUTSIDE = 0.4  # distance to the edge that counts as near, in lengths of the cell
STARTED = 1.15  # a track that has not swum so many lengths in its slowest's time is not a cell
ASTRAY = 0.67  # distance of a cell's state from its own blob above which the state is wrong
ENTERED = 2.3  # a new cell nearer than this to the picture's edge has swum into the picture
ENTER, APPEAR = 10.0, 0.3  # cells that are expected to appear: at the edge, and anywhere
# a new blob this many times larger than the usual cell, of at least so many, may show two
PAIR, USUAL = 1.7, 5
SPECK_S, HIDDEN_SPECK_S = 0.1, 3.0  # time for which a speck is kept: a new one, an old one

FieldPieces = Callable[[float, float], Sequence[Piece]]
"""Function that returns the field between two times [s] as pieces of constant field."""


class CellTracker:
    """Follows the cells in pictures with the scale `um_px` [um/px]; `known`: whether the field is
    known, `near_wall`: where a wall may turn cells, `organism`: which objects are cells, `splits`:
    whether a cell whose name is too uncertain after a meeting gets a new name.

    Pictures must be given in order of time. Column c and row r become x = (c + 1/2) um_px and, with
    y upwards, y = (height - 1/2 - r) um_px [um].
    """

    def __init__(
        self,
        um_px: float,
        known: bool,
        near_wall: NearWall = open_water,
        organism: Organism = TETRAHYMENA,
        splits: bool = False,
    ) -> None:
        self.um_px = um_px
        least, most = organism.wide_um[0] * organism.body_um[1], organism.outline_um2[1]
        self.finder = BlobFinder(least / um_px**2, TOGETHER * most / um_px**2)
        self.bank = HelixFilter(known, near_wall, organism)
        self.born: list[Born] = []  # cells recognised in the newest picture
        self._organism, self._body_um = organism, organism.body_um[0]
        self._gone_s = GONE_S / organism.quickness
        self._started_s = STARTED * self._body_um / organism.slowest_um_s
        self.blobs = list[Blob]()  # those of the last picture
        self._tracks, self._last_track = list[CellTrack](), 0
        self._names = Names(self.bank, self._body_um, splits)
        self._time: float | None = None
        self._brief_s = SPECK_S  # SPECK_S, or as long as one picture is missing
        self._height = self._width = 0

    def take(self, finder: BlobFinder) -> None:
        """Go on with a finder that has learned the background."""
        finder.least_px2, finder.most_px2 = self.finder.least_px2, self.finder.most_px2
        self.finder = finder

    @property
    def answers(self) -> Sequence[CellAnswer]:
        """The answers to questions of identity that the newest picture decided."""
        return self._names.answers

    def see(self, picture: Grey, seconds: float, field: FieldPieces) -> list[SeenCell]:
        """Return the cells in a picture taken at a time [s]; `field` gives the field that acted
        since the picture before.
        """
        passed = 0.0 if self._time is None else seconds - self._time
        self._brief_s = max(SPECK_S, 1.5 * passed)
        pieces = () if self._time is None else field(self._time, seconds)
        self._time, (self._height, self._width) = seconds, picture.shape
        self.born, self._names.answers = [], []
        self.bank.predict(pieces)
        found = self.finder.find(picture)
        self.blobs = [] if self.finder.light.lost else found
        self._shift(*self.finder.light.shift_px)
        self._match(self.blobs, seconds, passed)
        self._give_up(seconds)
        cells = self._cells()
        self.finder.follow(self._kept(cells))
        hidden_s = self._at_least(HIDDEN_S)
        return self._shown([cell for cell in cells if cell.missed_s < hidden_s])

    def finish(self) -> None:
        """Answer all questions of identity: there are no further pictures."""
        self._names.answers = []
        self._names.finish(self._time or 0.0)

    def _at_least(self, seconds: float) -> float:
        """Return a time without a blob [s], but at least one in which one picture is missing."""
        return max(seconds, self._brief_s)

    def _shift(self, columns: float, rows: float) -> None:
        """Move all objects with a picture whose content was shifted by a knock."""
        if columns or rows:
            x, y = columns * self.um_px, -rows * self.um_px
            self.bank.mean[:, :2] += x, y
            self._names.shift(x, y)
            for track in self._tracks:
                track.path = [(e[0], e[1] + x, e[2] + y, e[3], e[4], e[5]) for e in track.path]
                track.last = track.last + np.array((x, y))
                if track.begun is not None:
                    track.begun = track.begun[0] + x, track.begun[1] + y, track.begun[2]

    def _cells(self) -> list[CellTrack]:
        return [track for track in self._tracks if track.row is not None]

    def _match(self, blobs: Sequence[Blob], seconds: float, passed: float) -> None:
        """Assign each track its blob, and update the cells' states."""
        cells, places = self._cells(), match.places_of(blobs, self.um_px, self._height)
        specks = [track for track in self._tracks if track.row is None]
        rows = np.array([cell.row for cell in cells], int)
        expected, spread = self.bank.expected(rows)
        squared = match.squared_distances(expected, spread, places)
        own, loose = match.cell_costs(
            cells, expected, squared, places, self._organism, self._at_least(LOOKED_S)
        )
        pixels = match.pixels_of(expected, self.um_px, self._height)
        shared = match.shared_costs(cells, pixels, blobs, self.um_px)
        owner = match.assigned(
            own, shared, match.speck_costs(specks, places, seconds, passed, self._organism)
        )
        owners: dict[int, list[int]] = {}
        for i, track in enumerate([*cells, *specks]):
            j = owner.get(i)
            track.missed_s = 0.0 if j is not None else track.missed_s + passed
            track.blob, track.place = (None, None) if j is None else (blobs[j], places[j])
            track.measured, track.merged, track.large = None, False, False
            if j is not None and i < len(cells):
                owners.setdefault(j, []).append(i)
                if loose[i, j]:
                    self.bank.loosen([cells[i].filter_row])
        for those in owners.values():
            some = [cells[i] for i in those]
            for cell in some:
                cell.merged = len(some) > 1
            if len(some) > 1:
                self._names.meet(some, seconds, any(map(self._meets, some)))
        self._update(cells, owners, expected, blobs, places, seconds)
        for j, those in owners.items():
            for i in those:
                cells[i].last = places[j, :2]
        at = {cells[i].number: places[j, :3] for j, those in owners.items() for i in those}
        new = [t.near for t in specks if t.near is not None and len(t.path) <= NEAR_BORN]
        self._names.part(at, new, seconds)
        self._names.answer(seconds)
        found = {j: specks[i - len(cells)] for i, j in owner.items() if i >= len(cells)}
        self._follow_specks(found, set(owners), blobs, places)

    def _update(
        self,
        cells: Sequence[CellTrack],
        owners: dict[int, list[int]],
        expected: Floats,
        blobs: Sequence[Blob],
        places: Floats,
        seconds: float,
    ) -> None:
        """Update the filter by the cells' blobs; a track with an open question has one row for each
        cell that it may be.
        """
        readings: list[Reading] = []
        for j, those in owners.items():
            some, place = [cells[i] for i in those], places[j]
            if len(some) > 1:
                points = match.points_of(blobs[j], self.um_px, self._height), seconds
                readings += shared_readings(some, expected[those], place, *points, self._body_um)
                continue
            note_size(some[0], place, seconds)
            # at the picture's edge, a cell that enters may take the blob of one that leaves
            cut = blobs[j].at_edge and some[0].begun is None
            if (some[0].large or cut) and some[0].question is None:
                self._names.meet(some, seconds, self._meets(some[0]))
            own = expected[those[0]], place, self.um_px, self._height
            readings.append(own_reading(some[0], *own, self._body_um))
        if not readings:
            return
        rows = []
        for cell, _, _ in readings:
            asked = cell.question
            rows.append([cell.row] if asked is None else asked.rows[asked.tracks.index(cell)])
        counts = [len(each) for each in rows]
        likelihood, distance = self.bank.update(
            np.concatenate(rows).astype(int),
            np.repeat([values for _, values, _ in readings], counts, axis=0),
            np.repeat([deviations for _, _, deviations in readings], counts, axis=0),
        )
        at = 0
        for (cell, values, deviations), count in zip(readings, counts, strict=True):
            if cell.question is not None:
                whole = cell.blob is not None and not cell.blob.at_edge and not cell.merged
                size = cell.path[-1][4:] if whole else None
                cell.question.add(cell, likelihood[at : at + count], size, seconds)
            elif not cell.merged:
                self._check(cell, values, deviations, float(distance[at]))
            at += count

    def _check(
        self,
        cell: CellTrack,
        values: tuple[float, ...],
        deviations: tuple[float, ...],
        distance: float,
    ) -> None:
        """Make the filter uncertain of a cell that is often far from where it is expected, and move
        its state to its blob if the two are far apart.
        """
        cell.odd = cell.odd + 1 if distance > ODD_DISTANCE else 0
        (x, y), away = self.bank.mean[cell.row, :2].tolist(), ASTRAY * self._body_um
        sure = deviations[0] < MERGED[0] * self._body_um
        if sure and math.dist(values[:2], (x, y)) > away:
            vx, vy = values[0] - cell.last[0], values[1] - cell.last[1]
            backwards = math.cos(values[2]) * vx + math.sin(values[2]) * vy < 0
            axis = values[2] + math.pi * backwards
            row = self.bank.moved(cell.filter_row, values[0], values[1], axis)
            self.bank.drop(cell.filter_row)
            cell.row, cell.odd = row, 0
        elif cell.odd >= ODD_RUN:
            self.bank.loosen([cell.filter_row])
            cell.odd = 0

    def _follow_specks(
        self, found: dict[int, CellTrack], taken: set[int], blobs: Sequence[Blob], places: Floats
    ) -> None:
        """Give specks and new objects the blobs that no cell has; a speck that swims is a cell."""
        cells, seconds = self._cells(), self._time or 0.0
        here = np.array([self.bank.mean[cell.row, :2] for cell in cells]).reshape(-1, 2)
        for j, place in enumerate(places):
            if j in taken:
                continue
            entry: Entry = (seconds, *place.tolist())
            if blobs[j].at_edge:
                entry = (*entry[:4], math.nan, math.nan)
            gaps = np.linalg.norm(here - place[:2], axis=1)
            nearest = float(gaps.min(initial=np.inf))
            if j not in found:
                near = cells[int(gaps.argmin())] if nearest < FROM * self._body_um else None
                self._last_track += 1
                self._tracks.append(CellTrack(self._last_track, [entry], near=near))
                continue
            speck = found[j]
            hidden = seconds - speck.path[-1][0] > self._brief_s
            speck.path = [entry] if hidden else [*speck.path[1 - PATH :], entry]
            needed = NEAR_BORN if nearest < NEAR * self._body_um else BORN
            if swims(speck.path, needed, self._organism):
                self._begin(speck)

    def _begin(self, track: CellTrack) -> None:
        """Start to follow a speck as a cell, since it swims."""
        path, near = np.array(track.path), track.near
        (vx, vy), fitted = straight(path[-BORN:])
        x, y = fitted[-1].tolist()
        track.long, track.wide = usual_size(path)
        usual = [each.long * each.wide for each in self._cells() if each.begun is None]
        large = PAIR * float(np.median(usual)) if len(usual) >= USUAL else math.inf
        track.sized_s = self._time or 0.0
        if track.long * track.wide > large:
            track.pair_s = track.sized_s + self._started_s
        track.row = self.bank.add(x, y, math.atan2(vy, vx), math.hypot(vx, vy))
        track.identity, track.begun = self._names.take_number(), (x, y, float(path[-1, 0]))
        track.last = path[-1, 1:3]
        if near is not None and near not in self._tracks:
            track.near = near = None
        entered = self._near_edge(*path[0, 1:3].tolist())
        area = self._width * self._height * self.um_px**2
        density = (ENTER if entered else APPEAR) / area
        place = np.array([x, y, math.atan2(vy, vx)])
        divided = self._names.appear(track, place, float(path[0, 0]), density, entered)
        path = own_path(path, track.long, track.wide, self._body_um)
        (sure,) = self._probabilities([track])
        by = None if near is None else near.number
        self.born.append(Born(track.identity, track.number, path, sure, divided, by))
        track.near = None

    def _meets(self, cell: CellTrack) -> bool:
        """Return whether an object that is not followed may be about to enter a cell's blob."""
        x, y = self.bank.mean[cell.row, :2].tolist()
        near = any(
            math.dist(each.path[-1][1:3], (x, y)) < FROM * self._body_um
            for each in self._tracks
            if each.row is None and each.missed_s < self._brief_s
        )
        return near or cell.begun is not None or self._near_edge(x, y)

    def _near_edge(self, x: float, y: float) -> bool:
        """Return whether a cell at a position [um] may just have swum into the picture."""
        return self._to_edge(x, y) < ENTERED * self._body_um

    def _to_edge(self, x: float, y: float) -> float:
        """Return the distance [um] of a position [um] from the picture's edge."""
        return min(x, y, self._width * self.um_px - x, self._height * self.um_px - y)

    def _give_up(self, seconds: float) -> None:
        """Drop objects that have not been seen for long, have left the picture, or never swam."""
        kept, ghosts = list[CellTrack](), self._ghosts(seconds)
        for track in self._tracks:
            if track.row is None:
                old = len(track.path) == PATH
                if track.missed_s <= (HIDDEN_SPECK_S if old else self._brief_s):
                    kept.append(track)
                continue
            x, y = self.bank.mean[track.row, :2].tolist()
            outside = self._to_edge(x, y) < OUTSIDE * track.long
            brief = outside or track.begun is not None
            lost_s = self._gone_s if brief else self._at_least(LOST_S)
            late = track.missed_s > lost_s or track.number in ghosts
            if late or not math.isfinite(x + y) or self._stays(track, seconds):
                self._names.give_up(track, seconds, late and not outside and track.begun is None)
            else:
                kept.append(track)
        self._tracks = kept

    def _ghosts(self, seconds: float) -> set[int]:
        """Return the numbers of tracks in shared blobs that have been as small as one cell for too
        long, the least likely one of each blob: its cell has left unseen.
        """
        cells = [c for c in self._cells() if c.merged and seconds - c.hidden_s > GHOST_S]
        least: dict[int, tuple[float, int]] = {}  # by blob
        for cell, likely in zip(cells, self._probabilities(cells), strict=True):
            this = likely, -cell.number
            least[id(cell.blob)] = min(this, least.get(id(cell.blob), this))
        return {-number for _, number in least.values()}

    def _stays(self, track: CellTrack, seconds: float) -> bool:
        """Return whether a tracked object does not swim, so that it is not a cell."""
        if track.begun is None:
            return False
        x, y, began = track.begun
        if math.dist(track.last.tolist(), (x, y)) > STARTED * self._body_um:
            track.begun = None
            return False
        return seconds - began > self._started_s

    def _kept(self, cells: Sequence[CellTrack]) -> list[tuple[int, int, int, int]]:
        """Return rectangles [px] around the cells, in which the background is not updated."""
        states, found = self.bank.mean[[cell.filter_row for cell in cells]], []
        pixels = match.pixels_of(states, self.um_px, self._height)
        for cell, (column, row) in zip(cells, pixels.tolist(), strict=True):
            reach = 0.8 * cell.long / self.um_px + 4
            left, top = round(column - reach), round(row - reach)
            found.append((left, top, round(column + reach), round(row + reach)))
        return found

    def _probabilities(self, cells: Sequence[CellTrack]) -> list[float]:
        """Return the probability, for each of some cells, that it has the right name."""
        now, found = self._time or 0.0, self._names.probabilities(cells)
        return [LIKELIER if now < c.pair_s else p for c, p in zip(cells, found, strict=True)]

    def _shown(self, cells: Sequence[CellTrack]) -> list[SeenCell]:
        rows = np.array([cell.row for cell in cells], int)
        seen, _ = self.bank.expected(rows)
        means = self.bank.mean[rows]
        sds = np.sqrt(np.diagonal(self.bank.covariance[rows], axis1=1, axis2=2))
        return [
            SeenCell(
                identity=cell.identity,
                x=x,
                y=y,
                axis=axis,
                heading=float(means[i, HEADING]),
                mean=means[i],
                sd=sds[i],
                probability=probability,
                found=cell.blob is not None,
                merged=cell.merged or cell.large,
                long_um=cell.long,
                wide_um=cell.wide,
                track=cell.number,
                measured=cell.measured,
                blob_um=cell.place,
            )
            for i, (cell, (x, y, axis), probability) in enumerate(
                zip(cells, seen.tolist(), self._probabilities(cells), strict=True)
            )
        ]
