"""Who is where in a film: the one record of which cell each track showed in each picture.

What the tracker sees and answers is entered as it comes; at the end each cell's rows are written
from it.
"""

import math
from bisect import bisect_left
from collections.abc import Container, Iterator
from dataclasses import dataclass, field, replace
from itertools import count, groupby, pairwise

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import Born, CellAnswer, SeenCell
from tetractl_microscope.cells.helix import STATES
from tetractl_microscope.cells.names import ASSERTED, LIKELIER, PASSED_ON
from tetractl_microscope.cells.readings import AXIS, POSITION_UM
from tetractl_microscope.cells.tracking import STARTED, CellTracker
from tetractl_microscope.organisms import Organism

SHORTEST_S = 0.35  # least duration of a path that is kept [s]
# least share of a path's pictures in which its cell has a blob; least way over SHORTEST_S, relative
# to the way from picture to picture: what jumps to and fro does not swim
FOUND, STEADY = 0.7, 0.6
ROUNDING_S = 1e-6  # error of a time that was converted
OF_BLOB = POSITION_UM, POSITION_UM, 2 * AXIS  # deviations of a new cell's blob
UNKNOWN = np.full(STATES, np.nan)


@dataclass(frozen=True, slots=True)
class CellPath:
    """One cell in a film: `times` (K,) [s], picture numbers `frames` (K,), and its state in each
    picture.
    """

    identity: int
    times: Floats
    frames: np.ndarray
    seen: tuple[SeenCell, ...]

    @property
    def places(self) -> Floats:
        """Centre of the body in each picture (K, 2) [um]."""
        return np.array([(cell.x, cell.y) for cell in self.seen])


@dataclass(slots=True)
class TrackRow:
    """What a track showed in the picture with the index `at`, and which cell that was: its `name`,
    with the probability `likely`.
    """

    at: int
    cell: SeenCell
    name: int
    likely: float


def row_from(rows: list[TrackRow], at: int) -> int:
    """Return the index of a track's first row in or after a picture."""
    return bisect_left(rows, at, key=lambda row: row.at)


@dataclass(slots=True)
class Whereabouts:
    """The rows of each track, in order of time, in pictures at the `times` [s] with the numbers
    `frames`.

    `partings` are, for each cell that came out of another one's blob, the index of its first
    picture, its track, and the other one's; `divisions` the index, and the tracks of mother and
    daughter. `doubtful` lists cells that could not be distinguished after they met.
    """

    times: list[float] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    tracks: dict[int, list[TrackRow]] = field(default_factory=dict)
    partings: list[tuple[int, int, int]] = field(default_factory=list)
    divisions: list[tuple[int, int, int]] = field(default_factory=list)
    doubtful: list[tuple[int, ...]] = field(default_factory=list)

    def enter(self, frame: int, seconds: float, tracker: CellTracker, seen: list[SeenCell]) -> None:
        """Enter what a tracker has seen and answered in the next picture."""
        at = len(self.times)
        self.times.append(seconds)
        self.frames.append(frame)
        for cell in seen:
            row = TrackRow(at, cell, cell.identity, cell.probability)
            self.tracks.setdefault(cell.track, []).append(row)
        for born in tracker.born:
            self._begin(born)
        for answer in tracker.answers:
            self.answer(answer)

    def answer(self, answer: CellAnswer) -> None:
        """Enter the names that were found out later, since when they may have changed."""
        for named in answer.named:
            rows = self.tracks.get(named.track, [])
            since = row_from(rows, self.index(named.since_s))
            for row in rows[since:]:
                row.name = named.identity
                row.likely = named.certainty
        if answer.probability < ASSERTED:
            self.doubtful.append(tuple(sorted(answer.asked)))

    def index(self, seconds: float) -> int:
        """Return the index of the first picture at or after a time [s]."""
        return bisect_left(self.times, seconds - ROUNDING_S)

    def picture(self, at: int) -> dict[int, TrackRow]:
        """Return the row of each track in the picture with an index."""
        found = ((track, rows[row_from(rows, at) :][:1]) for track, rows in self.tracks.items())
        return {track: row for track, some in found for row in some if row.at == at}

    def new_names(self) -> Iterator[int]:
        """Yield numbers that no cell has."""
        return count(max((r.name for rows in self.tracks.values() for r in rows), default=0) + 1)

    def divided(self, pairs: Container[int]) -> Iterator[tuple[int, int]]:
        """Yield the names of mother and daughter of each division; `pairs` are tracks of cells that
        were in another one's blob before, and have not divided.
        """
        for at, mother, track in self.divisions:
            rows = self.picture(at)
            if track in rows and track not in pairs:
                yield rows[mother].name, rows[track].name

    def split(self) -> None:
        """Give each part of a track in which the name is uncertain, and which lasts, a name of its
        own once the name before is unlikely, or when the cell is alone again; unless the track has
        the same name before and after, or begins with that part. A brief part has the name before
        until the one after is likelier.
        """
        found = [part for rows in self.tracks.values() for part in _uncertain(rows)]
        names = self.new_names()
        found.sort(key=lambda part: (part[0][-1].at, part[0][0].at, part[0][0].cell.track))
        for rows, before, after in found:
            name = before
            merged = True
            end_s = self.times[rows[-1].at]
            for row in rows:
                alone = merged and not row.cell.merged
                unlike = row.likely < LIKELIER
                if name == before and (alone or unlike):
                    lasts = end_s - self.times[row.at] > SHORTEST_S
                    if lasts:
                        name = next(names)
                    elif unlike:
                        name = after or before
                row.name = name
                merged = row.cell.merged

    def paths(self, organism: Organism) -> Iterator[CellPath]:
        """Yield the cells in the order of their numbers, except those whose path is too short, that
        move more slowly than the organism for most of the time, or to and fro, or that are hardly
        seen: debris that a cell has touched. A track that swims may have several names in turn.
        """
        rows = [row for each in self.tracks.values() for row in each]
        far = {number for number, each in self.tracks.items() if _goes_far(_places(each), organism)}
        rows.sort(key=lambda row: (row.name, row.at, row.likely, -row.cell.track))
        for name, those in groupby(rows, key=lambda row: row.name):
            # a lost cell that was found again may have its name twice: the likelier one counts
            kept = list({row.at: row for row in those}.values())
            at = [row.at for row in kept]
            seen = (
                replace(row.cell, identity=name, probability=row.likely, sure=is_sure)
                for row, is_sure in zip(kept, _sure(kept), strict=True)
            )
            times, frames = np.array(self.times)[at], np.array(self.frames)[at]
            path = CellPath(name, times, frames, tuple(seen))
            on_far = all(row.cell.track in far for row in kept)
            if (on_far or _goes_far(path.places, organism)) and _swims(path, organism):
                yield path

    def _begin(self, born: Born) -> None:
        """Enter a newly recognised cell in the earlier pictures in which it was already seen."""
        path, before = born.path, list[TrackRow]()
        way = path[-1, 1:3] - path[0, 1:3]
        for seconds, x, y, axis, long, wide in path[:-1].tolist():
            forwards = np.cos(axis) * way[0] + np.sin(axis) * way[1] >= 0
            axis += 0.0 if forwards else np.pi
            cell = SeenCell(
                identity=born.identity,
                x=x,
                y=y,
                axis=axis,
                heading=float(np.arctan2(way[1], way[0])),
                mean=UNKNOWN,
                sd=UNKNOWN,
                probability=born.certainty,
                found=True,
                merged=False,
                long_um=np.nan,
                wide_um=np.nan,
                track=born.track,
                measured=None if math.isnan(long) else (x, y, axis, *OF_BLOB),
                blob_um=np.array((x, y, axis, long, wide)),
            )
            before.append(TrackRow(self.index(seconds), cell, born.identity, born.certainty))
        self.tracks.setdefault(born.track, [])[:0] = before
        first = self.index(path[0, 0])
        if born.near is not None:
            self.partings.append((first, born.track, born.near))
        if born.divided is not None:
            mothers = (t for t, row in self.picture(first).items() if row.name == born.divided)
            self.divisions += [(first, mother, born.track) for mother in mothers]


def _uncertain(rows: list[TrackRow]) -> Iterator[tuple[list[TrackRow], int, int | None]]:
    """Yield each part of a track in which its name is uncertain, the name before, and the one
    after, None if the track ends; but no part whose name is the same before and after.
    """
    runs = groupby(rows, lambda row: row.likely > PASSED_ON)
    before = None
    for run, later in pairwise([*(list(run) for _, run in runs), list[TrackRow]()]):
        if run[0].likely > PASSED_ON:
            before = run[-1].name
            continue
        after = later[0].name if later else None
        if before is not None and before != after:
            yield run, before, after


def _sure(rows: list[TrackRow]) -> list[bool]:
    """Return whether each row of a cell surely shows the cell of its first one.

    They do not once the name is uncertain, or the cell's blob too large for it, unless the name is
    certain later; nor after the name has gone on from one track to another.
    """
    cells = [row.cell for row in rows]
    large = np.array([cell.merged and cell.measured is not None for cell in cells])
    doubtful = large | np.array([row.likely <= ASSERTED for row in rows])
    certain = np.flatnonzero(~doubtful & [cell.found for cell in cells])
    doubtful[: certain.max(initial=-1) + 1] = False
    other = np.array([cell.track != cells[0].track for cell in cells])
    return (np.cumsum(doubtful | other) == 0).tolist()


def _places(rows: list[TrackRow]) -> Floats:
    """Return x, y (K, 2) [um] of a track's rows."""
    return np.array([(row.cell.x, row.cell.y) for row in rows]).reshape(-1, 2)


def _goes_far(places: Floats, organism: Organism) -> bool:
    """Return whether something at successive places (K, 2) [um] gets as far as a cell must swim."""
    way = np.linalg.norm(places - places[:1], axis=1)
    return bool(way.max(initial=0.0) >= STARTED * organism.body_um[0])


def _swims(path: CellPath, organism: Organism) -> bool:
    """Return whether a path lasts, and goes on as fast and as steadily as a cell's."""
    times, places = path.times, path.places
    if times[-1] - times[0] < SHORTEST_S:
        return False
    later = np.minimum(np.searchsorted(times, times + SHORTEST_S), len(times) - 1)
    moved = np.linalg.norm(places[later] - places, axis=1)[: later.argmax() + 1]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    least = max(organism.slowest_um_s, STEADY * float(np.median(steps))) * SHORTEST_S
    found = np.mean([cell.found for cell in path.seen])
    return bool(np.median(moved) >= least and found >= FOUND)
