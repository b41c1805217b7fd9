"""Tracks cells through a sequence of pictures: assigns blobs to tracks and updates their states.

Every object is a track. One that has not swum yet is a *speck*: its last motion says where it will
be. A speck that swims becomes a *cell*, with a row in the filter, which predicts it given the known
signal. For each picture:

1. the filter predicts all cells to the picture's time, and the finder finds the blobs;
2. `match` assigns blobs to tracks: each track has one blob or none; several cells may share one;
3. what the blobs say of the cells updates the filter;
4. `names` decides which cell is which where cells shared a blob;
5. blobs that no cell has go on with specks, and specks that swim become cells;
6. tracks without a blob for too long end, and so do cells that do not swim after all.

B is the number of blobs, K that of the cells in one blob. The place of a blob is x, y [um],
axis [rad], length and width [um] (5,), that of a cell x, y [um] and axis [rad] (3,).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import Born, CellAnswer, PathBlob, SeenCell
from tetractl_microscope.cells.cell_tracks import CellStart, CellTrack
from tetractl_microscope.cells.detect_cells import Blob, BlobFinder
from tetractl_microscope.cells.helix import HEADING, HelixFilter, NearWall, Piece, open_water
from tetractl_microscope.cells.kernels.helix_steps import ODD_DISTANCE, ODD_RUN
from tetractl_microscope.cells.meetings import FROM_BLOB
from tetractl_microscope.cells.names import LIKELIER, Names
from tetractl_microscope.cells.readings import (
    MERGED,
    PATH,
    BlobReading,
    note_own,
    note_shared,
    note_size,
    own_path,
    own_reading,
    shared_readings,
)
from tetractl_microscope.cells.specks import BORN, NEAR, NEAR_BORN, straight, swims, usual_size
from tetractl_microscope.organisms import TETRAHYMENA, Organism

AREAS_MOST = 3.2  # the largest blob that is considered, in areas of a large cell: cells touch
LOST_S = 0.5  # time without a blob after which a cell is lost
HIDDEN_S = 0.15  # time without a blob after which a cell is not reported any more
LOOKED_S = 0.2  # time without a blob for which one is looked for elsewhere: a cell may have stopped
# LOST_S for a cell near the picture's edge, which has left it by then, or that has just been found:
# for Tetrahymena, as this is a way
GONE_S = 0.1
MISSING = 1.5  # times between pictures for which a track has no blob if one picture is missing
GHOST_S = 1.5  # time for which two tracks may share a blob as small as one cell
OUTSIDE = 0.4  # distance to the edge that counts as near, in lengths of the cell
STARTED = 1.15  # a track that has not swum so many lengths in its slowest's time is not a cell
ASTRAY = 0.67  # distance of a cell's state from its own blob above which the state is wrong
ENTERED = 2.3  # a new cell nearer than this to the picture's edge has swum into the picture
ENTER = 10.0  # cells that are expected to appear at the edge, in a picture's area
APPEAR = 0.3  # cells that are expected to appear anywhere else
PAIR = 1.7  # a new blob this many times larger than the usual cell may show two
USUAL = 5  # fewest cells that tell how large the usual one is
SPECK_S = 0.1  # time without a blob for which a new speck is kept
HIDDEN_SPECK_S = 3.0  # the same for an old speck
AROUND = 0.8  # reach about a cell in which the background is not updated, in lengths of the cell
AROUND_PX = 4  # what is added to that reach [px]

FieldPieces = Callable[[float, float], Sequence[Piece]]
"""Function that returns the field between two times [s] as pieces of constant field."""


@dataclass(frozen=True, slots=True)
class PictureNow:
    """The newest picture: its time and the time since the one before [s], and its sides [px]."""

    seconds: float
    passed_s: float
    height: int
    width: int

    @property
    def brief_s(self) -> float:
        """The time without a blob that says nothing: a picture may be missing."""
        return max(SPECK_S, MISSING * self.passed_s)


@dataclass(frozen=True, slots=True)
class CellsInBlob:
    """A blob in its `place` (5,), and the K cells that have it, which were `expected` at (K, 3)."""

    blob: Blob
    place: Floats
    cells: list[CellTrack]
    expected: Floats


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
        least_um2 = organism.wide_um[0] * organism.body_um[1]
        most_um2 = AREAS_MOST * organism.outline_um2[1]
        self.finder = BlobFinder(least_um2 / um_px**2, most_um2 / um_px**2)
        self.bank = HelixFilter(known, near_wall, organism)
        self.blobs = list[Blob]()  # those of the newest picture
        self.born: list[Born] = []  # cells recognised in the newest picture
        self._organism = organism
        self._body_um = organism.body_um[0]
        self._gone_s = GONE_S / organism.quickness
        self._started_s = STARTED * self._body_um / organism.slowest_um_s
        self._tracks = list[CellTrack]()
        self._last_number = 0  # of the newest track
        self._names = Names(self.bank, self._body_um, splits)
        self._before: PictureNow | None = None  # the last picture seen

    def take(self, finder: BlobFinder) -> None:
        """Go on with a finder that has learned the background."""
        finder.least_px2 = self.finder.least_px2
        finder.most_px2 = self.finder.most_px2
        self.finder = finder

    @property
    def answers(self) -> Sequence[CellAnswer]:
        """The answers to questions of identity that the newest picture decided."""
        return self._names.answers

    def see(self, picture: Grey, seconds: float, field: FieldPieces) -> list[SeenCell]:
        """Return the cells in a picture taken at a time [s]; `field` gives the field that acted
        since the picture before.
        """
        self.born = []
        self._names.answers = []
        before_s = seconds if self._before is None else self._before.seconds
        pieces = () if self._before is None else field(before_s, seconds)
        height, width = picture.shape
        now = PictureNow(seconds, seconds - before_s, height, width)
        self._before = now
        self.bank.predict(pieces)
        blobs = self.finder.find(picture)
        self.blobs = [] if self.finder.light.lost else blobs
        self._shift(*self.finder.light.shift_px)
        self._match(self.blobs, now)
        self._give_up(now)
        cells = self._cells()
        self.finder.follow(self._surroundings(cells, now))
        hidden_s = max(HIDDEN_S, now.brief_s)
        return self._shown([cell for cell in cells if cell.missed_s < hidden_s], now)

    def finish(self) -> None:
        """Answer all questions of identity: there are no further pictures."""
        self._names.answers = []
        self._names.finish(0.0 if self._before is None else self._before.seconds)

    def _cells(self) -> list[CellTrack]:
        return [track for track in self._tracks if track.row is not None]

    def _shift(self, columns: float, rows: float) -> None:
        """Move all objects with a picture whose content was shifted by a knock."""
        if not columns and not rows:
            return
        x = columns * self.um_px
        y = -rows * self.um_px
        self.bank.mean[:, :2] += x, y
        self._names.shift(x, y)
        for track in self._tracks:
            track.shift(x, y)

    # ---- blobs and tracks ----

    def _match(self, blobs: Sequence[Blob], now: PictureNow) -> None:
        """Assign each track its blob, update the cells' states and names, and follow specks."""
        cells = self._cells()
        specks = [track for track in self._tracks if track.row is None]
        places = match.places_of(blobs, self.um_px, now.height)
        expected, spread = self.bank.expected(np.array([cell.row for cell in cells], int))
        squared = match.squared_distances(expected, spread, places)
        looked_s = max(LOOKED_S, now.brief_s)
        own, is_away = match.cell_costs(cells, expected, squared, places, self._organism, looked_s)
        pixels = match.pixels_of(expected, self.um_px, now.height)
        shared = match.shared_costs(cells, pixels, blobs, self.um_px)
        of_specks = match.speck_costs(specks, places, now.seconds, now.passed_s, self._organism)
        blob_of = match.assigned(own, shared, of_specks)  # by index: the cells, then the specks

        cells_of: dict[int, list[int]] = {}  # by blob
        for i, track in enumerate([*cells, *specks]):
            j = blob_of.get(i)
            if j is None:
                _lose_blob(track, now.passed_s)
                continue
            _give_blob(track, blobs[j], places[j])
            if i < len(cells):
                cells_of.setdefault(j, []).append(i)
                if is_away[i, j]:
                    self.bank.loosen([track.filter_row])
        groups = [
            CellsInBlob(blobs[j], places[j], [cells[i] for i in indices], expected[indices])
            for j, indices in cells_of.items()
        ]
        self._update_cells(groups, now)
        self._update_names(groups, specks, now)
        speck_of = {j: specks[i - len(cells)] for i, j in blob_of.items() if i >= len(cells)}
        free = [j for j in range(len(blobs)) if j not in cells_of]
        self._follow_specks(
            [blobs[j] for j in free], places[free], [speck_of.get(j) for j in free], now
        )

    def _update_cells(self, groups: Sequence[CellsInBlob], now: PictureNow) -> None:
        """Update the filter by the cells' blobs."""
        for group in groups:
            if len(group.cells) > 1:
                self._names.meet(group.cells, now.seconds, self._may_join(group.cells, now))
        for group in groups:
            self._note_blob(group, now)
        readings: list[BlobReading] = []
        for group in groups:
            readings += self._readings(group, now)
        if readings:
            self._update_filter(readings, now)
        for reading in readings:
            cell = reading.cell
            assert cell.place is not None, "it has a blob"
            if not cell.merged:
                note_own(reading, cell.place)
            cell.last = cell.place[:2]

    def _note_blob(self, group: CellsInBlob, now: PictureNow) -> None:
        """Note the size of a blob with its cells. One that is cut off or too large for its one cell
        may show another one, too.
        """
        if len(group.cells) > 1:
            note_shared(group.cells, group.place, now.seconds)
            return
        cell = group.cells[0]
        note_size(cell, group.place, now.seconds)
        # at the picture's edge, a cell that enters may take the blob of one that leaves
        is_cut = group.blob.at_edge and cell.begun is None
        if (cell.large or is_cut) and cell.question is None:
            self._names.meet([cell], now.seconds, self._may_join([cell], now))

    def _readings(self, group: CellsInBlob, now: PictureNow) -> list[BlobReading]:
        """Return what a blob says of its cells."""
        if len(group.cells) > 1:
            points = match.points_of(group.blob, self.um_px, now.height)
            return shared_readings(group.cells, group.expected, group.place, points, self._body_um)
        (cell,) = group.cells
        (expected,) = group.expected
        return [own_reading(cell, expected, group.place, self.um_px, now.height, self._body_um)]

    def _update_filter(self, readings: Sequence[BlobReading], now: PictureNow) -> None:
        """Update the filter by readings. A track with an open question has one row for each cell
        that it may be, and its reading updates all of them.
        """
        rows = [_rows_of(reading.cell) for reading in readings]
        counts = [len(rows_of_cell) for rows_of_cell in rows]
        likelihood, distance = self.bank.update(
            np.concatenate(rows).astype(int),
            np.repeat([reading.values for reading in readings], counts, axis=0),
            np.repeat([reading.deviations for reading in readings], counts, axis=0),
        )
        first = 0
        for reading, count in zip(readings, counts, strict=True):
            cell = reading.cell
            if cell.question is not None:
                is_whole = cell.blob is not None and not cell.blob.at_edge and not cell.merged
                blob = cell.path[-1]
                size = (blob.long, blob.wide) if is_whole else None
                of_cells = likelihood[first : first + count]
                cell.question.add(cell, of_cells, size, now.seconds)
            elif not cell.merged:
                self._check(reading, float(distance[first]))
            first += count

    def _check(self, reading: BlobReading, distance: float) -> None:
        """Move the state of a cell to its own blob if the two are far apart, and make the filter
        uncertain of a cell that often is where it was not expected: the squared `distance` is in
        standard deviations.
        """
        cell = reading.cell
        x, y, axis = reading.values
        cell.odd = cell.odd + 1 if distance > ODD_DISTANCE else 0
        is_own = reading.deviations[0] < MERGED[0] * self._body_um
        state = self.bank.mean[cell.row, :2].tolist()
        if is_own and math.dist((x, y), state) > ASTRAY * self._body_um:
            moved_x = x - cell.last[0]
            moved_y = y - cell.last[1]
            if math.cos(axis) * moved_x + math.sin(axis) * moved_y < 0:
                axis += math.pi
            row = self.bank.moved(cell.filter_row, x, y, axis)
            self.bank.drop(cell.filter_row)
            cell.row = row
            cell.odd = 0
        elif cell.odd >= ODD_RUN:
            self.bank.loosen([cell.filter_row])
            cell.odd = 0

    def _update_names(
        self, groups: Sequence[CellsInBlob], specks: Sequence[CellTrack], now: PictureNow
    ) -> None:
        """End the meetings of cells that are apart again, and the questions that are decided."""
        places: dict[int, Floats] = {}
        for group in groups:
            for cell in group.cells:
                places[cell.number] = group.place[:3]
        # a young speck near a cell may prove to be another one that came out of its blob
        awaited = [
            speck.near
            for speck in specks
            if speck.near is not None and len(speck.path) <= NEAR_BORN
        ]
        self._names.part(places, awaited, now.seconds)
        self._names.answer(now.seconds)

    def _may_join(self, cells: Sequence[CellTrack], now: PictureNow) -> bool:
        """Return whether an object that is not followed may be about to enter the cells' blob."""
        specks = [
            (speck.path[-1].x, speck.path[-1].y)
            for speck in self._tracks
            if speck.row is None and speck.missed_s < now.brief_s
        ]
        for cell in cells:
            x, y = self.bank.mean[cell.row, :2].tolist()
            if cell.begun is not None or self._to_edge(x, y, now) < ENTERED * self._body_um:
                return True
            if any(math.dist(speck, (x, y)) < FROM_BLOB * self._body_um for speck in specks):
                return True
        return False

    # ---- specks, and cells that begin ----

    def _follow_specks(
        self,
        blobs: Sequence[Blob],
        places: Floats,
        specks: Sequence[CellTrack | None],
        now: PictureNow,
    ) -> None:
        """Follow specks by blobs in `places` (B, 5) that no cell has; a blob without a speck begins
        one, and a speck that swims becomes a cell.
        """
        cells = self._cells()
        cells_at = np.array([self.bank.mean[cell.row, :2] for cell in cells]).reshape(-1, 2)
        for blob, place, speck in zip(blobs, places, specks, strict=True):
            x, y, axis, long, wide = place.tolist()
            if blob.at_edge:
                long = math.nan
                wide = math.nan
            entry = PathBlob(now.seconds, x, y, axis, long, wide)
            gaps = np.linalg.norm(cells_at - place[:2], axis=1)
            nearest_um = float(gaps.min(initial=np.inf))
            if speck is None:
                is_near = nearest_um < FROM_BLOB * self._body_um
                near = cells[int(gaps.argmin())] if is_near else None
                self._last_number += 1
                self._tracks.append(CellTrack(self._last_number, [entry], near=near))
                continue
            was_hidden = now.seconds - speck.path[-1].seconds > now.brief_s
            speck.path = [entry] if was_hidden else [*speck.path[1 - PATH :], entry]
            needed = NEAR_BORN if nearest_um < NEAR * self._body_um else BORN
            if swims(speck.path, needed, self._organism):
                self._begin(speck, now)

    def _begin(self, track: CellTrack, now: PictureNow) -> None:
        """Start to follow a speck as a cell, since it swims."""
        path = np.array(track.path)
        begun_s = float(path[0, 0])
        (vx, vy), fitted = straight(path[-BORN:])
        x, y = fitted[-1].tolist()
        heading = math.atan2(vy, vx)
        track.long, track.wide = usual_size(path)
        track.sized_s = now.seconds
        if track.long * track.wide > self._pair_um2():
            track.pair_s = now.seconds + self._started_s
        track.row = self.bank.add(x, y, heading, math.hypot(vx, vy))
        track.identity = self._names.take_number()
        track.begun = CellStart(x, y, float(path[-1, 0]))
        track.last = path[-1, 1:3]
        if track.near not in self._tracks:
            track.near = None
        near = track.near

        has_entered = self._to_edge(path[0, 1], path[0, 2], now) < ENTERED * self._body_um
        area_um2 = now.width * now.height * self.um_px**2
        density = (ENTER if has_entered else APPEAR) / area_um2
        place = np.array([x, y, heading])
        divided = self._names.appear(track, place, begun_s, density, has_entered)
        (certainty,) = self._probabilities([track], now)
        self.born.append(
            Born(
                identity=track.identity,
                track=track.number,
                path=own_path(path, track.long, track.wide, self._body_um),
                certainty=certainty,
                divided=divided,
                near=None if near is None else near.number,
            )
        )
        track.near = None

    def _pair_um2(self) -> float:
        """Return the product of length and width above which a new blob may show two cells."""
        usual = [cell.long * cell.wide for cell in self._cells() if cell.begun is None]
        return PAIR * float(np.median(usual)) if len(usual) >= USUAL else math.inf

    # ---- tracks that end ----

    def _give_up(self, now: PictureNow) -> None:
        """Drop objects that have not been seen for long, have left the picture, or never swam."""
        ghosts = self._ghosts(now)
        remaining = list[CellTrack]()
        for track in self._tracks:
            if track.row is None:
                is_old = len(track.path) == PATH
                if track.missed_s <= (HIDDEN_SPECK_S if is_old else now.brief_s):
                    remaining.append(track)
                continue
            x, y = self.bank.mean[track.row, :2].tolist()
            at_edge = self._to_edge(x, y, now) < OUTSIDE * track.long
            is_brief = at_edge or track.begun is not None
            lost_s = self._gone_s if is_brief else max(LOST_S, now.brief_s)
            is_lost = track.missed_s > lost_s or track.number in ghosts
            if is_lost or not math.isfinite(x + y) or self._stays(track, now.seconds):
                may_return = is_lost and not at_edge and track.begun is None
                self._names.give_up(track, now.seconds, may_return)
                continue
            if self._has_swum(track):
                track.begun = None
            remaining.append(track)
        self._tracks = remaining

    def _ghosts(self, now: PictureNow) -> set[int]:
        """Return the numbers of tracks in shared blobs that have been as small as one cell for too
        long, the least likely one of each blob: its cell has left unseen.
        """
        hidden = [
            cell for cell in self._cells() if cell.merged and now.seconds - cell.hidden_s > GHOST_S
        ]
        least: dict[int, tuple[float, int]] = {}  # by blob; of equals, the newest
        for cell, likely in zip(hidden, self._probabilities(hidden, now), strict=True):
            this = likely, -cell.number
            least[id(cell.blob)] = min(this, least.get(id(cell.blob), this))
        return {-number for _, number in least.values()}

    def _stays(self, track: CellTrack, seconds: float) -> bool:
        """Return whether a tracked object does not swim by a time [s], so that it is not a cell."""
        if track.begun is None or self._has_swum(track):
            return False
        return seconds - track.begun.seconds > self._started_s

    def _has_swum(self, track: CellTrack) -> bool:
        """Return whether a tracked object has swum as far as a cell must."""
        if track.begun is None:
            return True
        start = track.begun
        return math.dist(track.last.tolist(), (start.x, start.y)) > STARTED * self._body_um

    def _to_edge(self, x: float, y: float, now: PictureNow) -> float:
        """Return the distance [um] of a position [um] from the picture's edge."""
        return min(x, y, now.width * self.um_px - x, now.height * self.um_px - y)

    # ---- what is said of the cells ----

    def _surroundings(
        self, cells: Sequence[CellTrack], now: PictureNow
    ) -> list[tuple[int, int, int, int]]:
        """Return left, top, right and bottom [px] of rectangles around the cells, in which the
        background is not updated.
        """
        states = self.bank.mean[[cell.filter_row for cell in cells]]
        pixels = match.pixels_of(states, self.um_px, now.height)
        rectangles = list[tuple[int, int, int, int]]()
        for cell, (column, row) in zip(cells, pixels.tolist(), strict=True):
            reach = AROUND * cell.long / self.um_px + AROUND_PX
            left = round(column - reach)
            top = round(row - reach)
            rectangles.append((left, top, round(column + reach), round(row + reach)))
        return rectangles

    def _probabilities(self, cells: Sequence[CellTrack], now: PictureNow) -> list[float]:
        """Return the probability, for each of some cells, that it has the right name."""
        probabilities = self._names.probabilities(cells)
        return [
            LIKELIER if now.seconds < cell.pair_s else probability
            for cell, probability in zip(cells, probabilities, strict=True)
        ]

    def _shown(self, cells: Sequence[CellTrack], now: PictureNow) -> list[SeenCell]:
        """Return what is said of cells in the newest picture."""
        rows = np.array([cell.row for cell in cells], int)
        places, _ = self.bank.expected(rows)
        means = self.bank.mean[rows]
        sds = np.sqrt(np.diagonal(self.bank.covariance[rows], axis1=1, axis2=2))
        probabilities = self._probabilities(cells, now)
        return [
            SeenCell(
                identity=cell.identity,
                x=x,
                y=y,
                axis=axis,
                heading=float(means[i, HEADING]),
                mean=means[i],
                sd=sds[i],
                probability=probabilities[i],
                has_blob=cell.blob is not None,
                merged=cell.merged or cell.large,
                long_um=cell.long,
                wide_um=cell.wide,
                track=cell.number,
                measured=cell.measured,
                blob_um=cell.place,
            )
            for i, (cell, (x, y, axis)) in enumerate(zip(cells, places.tolist(), strict=True))
        ]


def _give_blob(track: CellTrack, blob: Blob, place: Floats) -> None:
    """Note a track's blob in the newest picture; what it says of a cell is found out later."""
    track.missed_s = 0.0
    track.blob = blob
    track.place = place
    _forget_reading(track)


def _lose_blob(track: CellTrack, passed_s: float) -> None:
    """Note that a track has no blob in the newest picture, taken some time after the last [s]."""
    track.missed_s += passed_s
    track.blob = None
    track.place = None
    _forget_reading(track)


def _forget_reading(track: CellTrack) -> None:
    """Forget what the blob of the picture before said of a track."""
    track.measured = None
    track.merged = False
    track.large = False


def _rows_of(cell: CellTrack) -> Sequence[int]:
    """Return the rows of the filter that follow a cell's track."""
    if cell.question is None:
        return [cell.filter_row]
    return cell.question.rows[cell.question.tracks.index(cell)].tolist()
