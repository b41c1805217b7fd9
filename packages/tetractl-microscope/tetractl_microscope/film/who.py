"""Who is where in a film: the one record of which cell each track showed in each picture.

A track has a row for each picture that shows it: the number (name) of the cell on it, and the
probability of that. What the tracker sees and answers is entered as it comes, and an answer changes
rows that were entered before (`Whereabouts.enter`). At the end a name that some pictures do not
show is another one after them (`end_at_gaps`), and the rows of each name become a path (`paths`).

K is the number of pictures of a path. A `picture` is its index in the record.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count, groupby, pairwise

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import Born, CellAnswer, SeenCell
from tetractl_microscope.cells.names import ASSERTED
from tetractl_microscope.cells.readings import AXIS, POSITION_UM
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.organisms import Organism

SHORTEST_S = 0.35  # least duration of a path that is kept [s]
FOUND = 0.7  # least share of a path's pictures in which its cell has a blob
# least way over SHORTEST_S, relative to that from picture to picture: what jumps does not swim
STEADY = 0.6
ROUNDING_S = 1e-6  # error of a time that was converted
OF_BLOB = (POSITION_UM, POSITION_UM, 2 * AXIS)  # deviations of a new cell's blob [um, um, rad]


@dataclass(frozen=True, slots=True)
class CellPath:
    """One cell in a film: `times` (K,) [s], picture numbers `frames` (K,), and how it was seen in
    each.
    """

    identity: int
    times: Floats
    frames: np.ndarray
    sightings: tuple[SeenCell, ...]

    @property
    def places(self) -> Floats:
        """Centre of the body in each picture (K, 2) [um]."""
        return np.array([(cell.x, cell.y) for cell in self.sightings])

    @property
    def headings(self) -> Floats:
        """Direction of swimming in each picture (K,) [rad]."""
        return np.array([cell.heading for cell in self.sightings])

    def pictures(self) -> Iterator[tuple[float, int, SeenCell]]:
        """Yield the time [s] and the number of each picture, and how the cell was seen in it."""
        return zip(self.times.tolist(), self.frames.tolist(), self.sightings, strict=True)


@dataclass(slots=True)
class TrackRow:
    """What a track showed in a picture, and which cell that was: its `name`, with the probability
    `likely`.
    """

    picture: int
    cell: SeenCell
    name: int
    likely: float


@dataclass(slots=True)
class Whereabouts:
    """The rows of each track, in order of time, in pictures at the `times` [s] with the numbers
    `frames`.

    `doubtful` lists cells that could not be distinguished after they met.
    """

    times: list[float] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    tracks: dict[int, list[TrackRow]] = field(default_factory=dict)
    doubtful: list[tuple[int, ...]] = field(default_factory=list)

    def enter(
        self, frame: int, seconds: float, tracker: CellTracker, cells: list[SeenCell]
    ) -> None:
        """Enter what a tracker has seen and answered in the next picture."""
        picture = len(self.times)
        self.times.append(seconds)
        self.frames.append(frame)
        for cell in cells:
            row = TrackRow(picture, cell, cell.identity, cell.probability)
            self.tracks.setdefault(cell.track, []).append(row)
        for born in tracker.born:
            self._begin(born)
        for answer in tracker.answers:
            self.answer(answer)

    def answer(self, answer: CellAnswer) -> None:
        """Enter the names that were found out later, since when they may have changed."""
        for named in answer.named:
            since = self.index(named.since_s)
            for row in self.tracks.get(named.track, []):
                if row.picture >= since:
                    row.name = named.identity
                    row.likely = named.certainty
        if answer.probability < ASSERTED:
            self.doubtful.append(tuple(sorted(answer.met)))

    def index(self, seconds: float) -> int:
        """Return the index of the first picture at or after a time [s]."""
        return bisect_left(self.times, seconds - ROUNDING_S)

    def end_at_gaps(self) -> None:
        """Give the rows of a name after pictures that do not show it another name: they may show
        another cell.
        """
        rows = [row for track_rows in self.tracks.values() for row in track_rows]
        names = count(max((row.name for row in rows), default=0) + 1)
        rows.sort(key=lambda row: (row.name, row.picture))
        for named in [list(group) for _, group in groupby(rows, key=lambda row: row.name)]:
            name = named[0].name
            for before, row in pairwise(named):
                if row.picture > before.picture + 1:
                    name = next(names)
                row.name = name

    def paths(self, organism: Organism) -> Iterator[CellPath]:
        """Yield the cells in the order of their numbers, except those whose path is too short, that
        move more slowly than the organism for most of the time, or to and fro, or that are hardly
        seen: debris that a cell has touched.
        """
        rows = [row for track_rows in self.tracks.values() for row in track_rows]
        rows.sort(key=lambda row: (row.name, row.picture, row.likely, -row.cell.track))
        for name, named in groupby(rows, key=lambda row: row.name):
            # an answer of later may give a name to two tracks: in each picture the likelier counts
            path = self._path(name, list({row.picture: row for row in named}.values()))
            if _swims(path, organism):
                yield path

    def _path(self, name: int, rows: list[TrackRow]) -> CellPath:
        """Return the path of the cell that has a name in some rows, one for each picture."""
        pictures = [row.picture for row in rows]
        sightings = [
            replace(row.cell, identity=name, probability=row.likely, sure=is_sure)
            for row, is_sure in zip(rows, _sure(rows), strict=True)
        ]
        times = np.array(self.times)[pictures]
        frames = np.array(self.frames)[pictures]
        return CellPath(name, times, frames, tuple(sightings))

    def _begin(self, born: Born) -> None:
        """Enter a newly recognised cell in the earlier pictures in which it was already seen."""
        path = born.path
        way = path[-1, 1:3] - path[0, 1:3]
        before = list[TrackRow]()
        for seconds, x, y, blob_axis, long, wide in path[:-1].tolist():
            is_forwards = np.cos(blob_axis) * way[0] + np.sin(blob_axis) * way[1] >= 0
            axis = blob_axis if is_forwards else blob_axis + np.pi
            cell = SeenCell(
                identity=born.identity,
                track=born.track,
                x=x,
                y=y,
                axis=axis,
                heading=float(np.arctan2(way[1], way[0])),
                measured=None if math.isnan(long) else (x, y, axis, *OF_BLOB),
                blob_um=np.array((x, y, axis, long, wide)),
            )
            before.append(TrackRow(self.index(seconds), cell, born.identity, 1.0))
        self.tracks.setdefault(born.track, [])[:0] = before


def _sure(rows: list[TrackRow]) -> list[bool]:
    """Return whether each row of a cell surely shows the cell of its first one.

    They do not once the name is uncertain, or the cell's blob too large for it, unless the name is
    certain later; nor after the name has gone on from one track to another.
    """
    cells = [row.cell for row in rows]
    is_large = np.array([cell.merged and cell.measured is not None for cell in cells])
    is_doubtful = is_large | np.array([row.likely <= ASSERTED for row in rows])
    is_certain = ~is_doubtful & np.array([cell.has_blob for cell in cells])
    last_certain = int(np.flatnonzero(is_certain).max(initial=-1))
    is_doubtful[: last_certain + 1] = False
    is_elsewhere = np.array([cell.track != cells[0].track for cell in cells])
    return (~np.logical_or.accumulate(is_doubtful | is_elsewhere)).tolist()


def _swims(path: CellPath, organism: Organism) -> bool:
    """Return whether a path lasts, and goes on as fast and as steadily as a cell's."""
    times = path.times
    places = path.places
    if times[-1] - times[0] < SHORTEST_S:
        return False
    if np.mean([cell.has_blob for cell in path.sightings]) < FOUND:
        return False
    later = np.minimum(np.searchsorted(times, times + SHORTEST_S), len(times) - 1)
    starts = slice(0, later.argmax() + 1)  # those from which the path lasts for SHORTEST_S
    ways_um = np.linalg.norm(places[later] - places, axis=1)[starts]
    speeds_um_s = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    least_um_s = max(organism.slowest_um_s, STEADY * float(np.median(speeds_um_s)))
    return bool(np.median(ways_um) >= least_um_s * SHORTEST_S)
