"""Tracks cells through a whole film; later pictures help to decide which cell is which after cells
met.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells.cell import Born, CellAnswer, SeenCell
from tetractl_microscope.cells.cells_health import faint_line
from tetractl_microscope.cells.helix import STATES
from tetractl_microscope.cells.names import ASSERTED, LIKELIER
from tetractl_microscope.cells.readings import AXIS, POSITION_UM
from tetractl_microscope.cells.tracking import STARTED, CellTracker
from tetractl_microscope.film.disturbances import Disturbances
from tetractl_microscope.film.field_file import FieldRecord, no_field
from tetractl_microscope.film.organism_of import recognised
from tetractl_microscope.film.pairs import fill_pairs
from tetractl_microscope.film.pictures import FilmPictures
from tetractl_microscope.organisms import Organism

SHORTEST_S = 0.35  # least duration of a path that is kept [s]
# least share of a path's pictures in which its cell has a blob; least way over SHORTEST_S, relative
# to the way from picture to picture: what jumps to and fro does not swim
FOUND, STEADY = 0.7, 0.6
# pictures in which cells move this many times as fast as usual, or less: some are lost, or doubled;
# least number of cells that tell; least share, and number, of such pictures that are said
LOST, DOUBLED, TELL, ODD = 1.6, 0.3, 3, (0.015, 3)
FADED = 0.05  # share of cells' pictures without a blob above which a warning is given
UNKNOWN_COVARIANCE = np.full((STATES, STATES), np.nan)


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


@dataclass(frozen=True, slots=True)
class Followed:
    """The cells of a film; `damaged` of its `pictures` could not be read.

    `remarks` say which `organism` was looked for, at which scale, and why. `doubtful` lists cells
    that could not be distinguished after they met. `divisions` lists mother and daughter of each
    division that was seen.
    """

    paths: tuple[CellPath, ...]
    pictures: int
    damaged: int
    size: tuple[int, int]
    rate_hz: float
    um_px: float
    guessed_scale: bool
    organism: Organism
    remarks: tuple[str, ...]
    bright: bool
    contrast: float
    noise: float
    background: Grey
    doubtful: tuple[tuple[int, ...], ...]
    divisions: tuple[tuple[int, int], ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the film [s]."""
        return self.pictures / self.rate_hz


def follow(
    film: FilmPictures,
    um_px: float | None,
    field: FieldRecord | None,
    organism: Organism | None = None,
    on_picture: Callable[[int], None] = lambda number: None,
) -> Followed:
    """Follow the cells of a film; TetractlError if no picture can be read.

    Without `organism` or `um_px`, they are those that `recognised` returns.
    """
    seen_as = recognised(film, um_px, organism)
    tracker = CellTracker(seen_as.um_px, field is not None, organism=seen_as.organism, splits=True)
    tracker.take(seen_as.finder)
    pieces = no_field if field is None else field.pieces
    shown: list[dict[int, SeenCell]] = []  # the cells of each picture, by track
    frames: list[int] = []
    times: list[float] = []
    answers: list[CellAnswer] = []
    divisions: list[tuple[dict[int, SeenCell], int, int]] = []  # picture and tracks
    partings: list[tuple[int, int, int]] = []  # first picture and tracks
    lights, disturbances = [], Disturbances(seen_as.um_px, seen_as.organism.body_um[0])
    for number, picture in film:
        seconds = film.seconds(number)
        cells = tracker.see(picture, seconds, pieces)
        # 2 kB for each cell in each picture that nothing after this needs
        cells = [replace(cell, covariance=UNKNOWN_COVARIANCE) for cell in cells]
        shown.append({cell.track: cell for cell in cells})
        frames.append(number)
        times.append(seconds)
        for born in tracker.born:
            _fill_back(shown, times, born)
            first = int(np.searchsorted(times, born.path[0, 0]))
            at = shown[first]
            if born.near is not None:
                partings.append((first, born.track, born.near))
            mothers = (track for track, cell in at.items() if cell.identity == born.divided)
            divisions += [(at, mother, born.track) for mother in mothers if born.track in at]
        for answer in tracker.answers:
            _rename(shown, times, answer)
        answers += tracker.answers
        lights.append(tracker.finder.light)
        disturbances.examine(picture, seconds, tracker.finder)
        on_picture(number)
    tracker.finish()
    for answer in tracker.answers:
        _rename(shown, times, answer)
    answers += tracker.answers
    pairs = fill_pairs(shown, times, partings, seen_as.organism.body_um[0])
    _split(shown, times)
    seen = [light.contrast for light in lights if light.contrast is not None]
    contrast = float(np.median(seen)) if seen else None
    limit, noise = np.median([(light.limit, light.noise) for light in lights], axis=0).tolist()
    lines = [faint_line(contrast, limit), _faded_line(shown), *_pace_lines(shown, times)]
    lines += disturbances.lines()
    background = tracker.finder.background
    assert background is not None
    height, width = background.shape
    paths = _paths(shown, frames, times, seen_as.organism)
    return Followed(
        paths=tuple(map(_flagged, paths)),
        pictures=len(frames) + film.damaged,
        damaged=film.damaged,
        size=(width, height),
        rate_hz=film.rate_hz,
        um_px=seen_as.um_px,
        guessed_scale=seen_as.guessed,
        organism=seen_as.organism,
        remarks=(*seen_as.remarks, *(f"warning: {line}" for line in lines if line)),
        bright=tracker.finder.bright,
        contrast=contrast or 0.0,
        noise=noise,
        background=background,
        doubtful=tuple(
            tuple(sorted(each.asked)) for each in answers if each.probability < ASSERTED
        ),
        divisions=tuple(
            (at[i].identity, at[j].identity) for at, i, j in divisions if j not in pairs
        ),
    )


def _faded_line(shown: Sequence[dict[int, SeenCell]]) -> str | None:
    """Return a line if followed cells have no blob in many of their pictures; None if not."""
    lost = [not cell.found for at in shown for cell in at.values()]
    if not lost or np.mean(lost) <= FADED:
        return None
    return (
        f"followed cells are not seen in {100 * np.mean(lost):.0f} % of their pictures: what is "
        "said of them may be wrong. Keep them in focus and in more contrast"
    )


def _pace_lines(shown: Sequence[dict[int, SeenCell]], times: Sequence[float]) -> Iterator[str]:
    """Yield a line if all cells move too far at once in several pictures, and one if not at all."""
    rows = []
    for k, (before, at) in enumerate(pairwise(shown), 1):
        for track, cell in at.items():
            blobs = [each.blob_um for each in (before.get(track), cell) if each and not each.merged]
            if len(blobs) == 2 and blobs[0] is not None and blobs[1] is not None:
                way = math.dist(blobs[0][:2].tolist(), blobs[1][:2].tolist())
                rows.append((k, track, way / (times[k] - times[k - 1])))
    picture, track, speed = np.array(rows).reshape(-1, 3).T
    for each in np.unique(track):
        speed[track == each] /= max(float(np.median(speed[track == each])), 1e-9)
    seen = [speed[picture == k] for k in np.unique(picture)]
    pace = np.array([np.median(each) for each in seen if len(each) >= TELL])
    least = max(ODD[0] * len(pace), ODD[1])
    lost, doubled = int((pace > LOST).sum()), int((pace < DOUBLED).sum())
    if doubled >= least:
        yield (
            f"in {doubled} of {len(pace)} pictures no cell moves: pictures are doubled. Remove "
            "them, and give the times of the others (times.csv)"
        )
    elif lost >= least:
        yield (
            f"in {lost} of {len(pace)} pictures all cells move too far at once: pictures are lost, "
            "so that times, a and numbers are wrong. Give the pictures' times (times.csv)"
        )


def _fill_back(
    shown: list[dict[int, SeenCell]],
    times: list[float],
    born: Born,
) -> None:
    """Add a newly recognised cell to the earlier pictures in which it was already seen."""
    path = born.path
    way = path[-1, 1:3] - path[0, 1:3]
    for seconds, x, y, axis, long, wide in path[:-1].tolist():
        at = int(np.searchsorted(times, seconds))
        if at >= len(times) or times[at] != seconds:
            continue
        forwards = np.cos(axis) * way[0] + np.sin(axis) * way[1] >= 0
        axis += 0.0 if forwards else np.pi
        shown[at][born.track] = SeenCell(
            identity=born.identity,
            x=x,
            y=y,
            axis=axis,
            heading=float(np.arctan2(way[1], way[0])),
            mean=np.full(STATES, np.nan),
            covariance=UNKNOWN_COVARIANCE,
            probability=born.certainty,
            found=True,
            merged=False,
            long_um=np.nan,
            wide_um=np.nan,
            track=born.track,
            measured=None if math.isnan(long) else (x, y, axis, POSITION_UM, POSITION_UM, 2 * AXIS),
            blob_um=np.array((x, y, axis, long, wide)),
        )


def _rename(
    shown: Sequence[dict[int, SeenCell]], times: Sequence[float], answer: CellAnswer
) -> None:
    """Give tracks the names that were found out later, from the times on when they may have
    changed.
    """
    for track, identity, certainty, since_s in answer.named:
        for at in shown[int(np.searchsorted(times, since_s)) :]:
            if track in at:
                at[track] = replace(at[track], identity=identity, probability=certainty)


def _split(shown: Sequence[dict[int, SeenCell]], times: Sequence[float]) -> None:
    """Give each part of a track in which the name is uncertain, and which lasts, a name of its own
    once the name before is unlikely, and another when the cell is alone again; unless the track has
    the same name before and after, or begins with that part. A brief part has the name before until
    the one after is likelier.
    """
    last = max((cell.identity for at in shown for cell in at.values()), default=0)
    before: dict[int, int] = {}
    parts: dict[int, list[int]] = {}
    for k, at in enumerate([*shown, {}]):
        for track in [each for each in parts if each not in at or at[each].probability > ASSERTED]:
            part, earlier = parts.pop(track), before.get(track)
            later = at[track].identity if track in at else None
            if earlier is None or earlier == later:
                continue
            name, since, merged = earlier, -math.inf, True
            for i in part:
                cell = shown[i][track]
                alone = merged and not cell.merged and times[i] - since > SHORTEST_S
                unlike = name == earlier and cell.probability < LIKELIER
                if (alone or unlike) and times[part[-1]] - times[i] > SHORTEST_S:
                    last += 1
                    name, since = last, times[i]
                elif unlike:
                    name = later or earlier
                merged = cell.merged
                shown[i][track] = replace(cell, identity=name)
        for track, cell in at.items():
            if cell.probability <= ASSERTED:
                parts.setdefault(track, []).append(k)
            else:
                before[track] = cell.identity


def _paths(
    shown: Sequence[dict[int, SeenCell]],
    frames: Sequence[int],
    seconds: Sequence[float],
    organism: Organism,
) -> Iterator[CellPath]:
    """Yield the cells in the order of their numbers, except those whose path is too short, that
    move more slowly than the organism for most of the time, or to and fro, or that are hardly seen:
    debris that a cell has touched.
    """
    least_um, slowest_um_s = STARTED * organism.body_um[0], organism.slowest_um_s
    by_cell: dict[int, list[tuple[int, float, SeenCell]]] = {}
    for frame, second, cells in zip(frames, seconds, shown, strict=True):
        # a lost cell that was found again may have its name twice: the likelier one counts
        likelier = sorted(cells.values(), key=lambda cell: (cell.probability, -cell.track))
        for identity, cell in {cell.identity: cell for cell in likelier}.items():
            by_cell.setdefault(identity, []).append((frame, second, cell))
    for identity, entries in sorted(by_cell.items()):
        numbers = np.array([frame for frame, _, _ in entries])
        times = np.array([second for _, second, _ in entries])
        path = CellPath(identity, times, numbers, tuple(cell for _, _, cell in entries))
        way = path.places - path.places[0]
        if times[-1] - times[0] < SHORTEST_S or np.linalg.norm(way, axis=1).max() < least_um:
            continue
        later = np.minimum(np.searchsorted(times, times + SHORTEST_S), len(times) - 1)
        moved = np.linalg.norm(path.places[later] - path.places, axis=1)[: later.argmax() + 1]
        steps = np.linalg.norm(np.diff(path.places, axis=0), axis=1) / np.diff(times)
        least = max(slowest_um_s, STEADY * float(np.median(steps))) * SHORTEST_S
        found = np.mean([cell.found for cell in path.seen])
        if np.median(moved) >= least and found >= FOUND:
            yield path


def _flagged(path: CellPath) -> CellPath:
    """Return a path whose pictures say whether they surely show the cell of its first ones.

    They do not once the name is uncertain, or the cell's blob too large for it, unless the name is
    certain later; nor after the name has gone on from one track to another.
    """
    seen, tracks = path.seen, np.array([cell.track for cell in path.seen])
    large = np.array([cell.merged and cell.measured is not None for cell in seen])
    doubtful = large | np.array([cell.probability <= ASSERTED for cell in seen])
    certain = np.flatnonzero(~doubtful & [cell.found for cell in seen])
    doubtful[: certain.max(initial=-1) + 1] = False
    sure = np.cumsum(doubtful | (tracks != tracks[0])) == 0
    marked = zip(seen, sure.tolist(), strict=True)
    return replace(path, seen=tuple(replace(cell, sure=is_sure) for cell, is_sure in marked))
