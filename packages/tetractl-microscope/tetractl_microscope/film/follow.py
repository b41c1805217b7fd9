"""Tracks cells through a whole film; later pictures help to decide which cell is which after cells
met.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cells_health import faint_line
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.film.disturbances import Disturbances
from tetractl_microscope.film.field_file import no_field
from tetractl_microscope.film.first_pictures import examine_first
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.film.pictures import FilmPictures
from tetractl_microscope.film.who import CellPath, Whereabouts
from tetractl_microscope.organisms import TETRAHYMENA, Organism

# median pace of the cells from one picture to the next, relative to their usual one, above which
# pictures are missing between the two, and below which a picture is doubled
LOST = 1.6
DOUBLED = 0.3
TELL = 3  # least number of cells in a picture from which its pace is computed
ODD = 0.015, 3  # least share and least number of lost or doubled pictures that are reported
FADED = 0.05  # share of cells' pictures without a blob above which a warning is given


@dataclass(frozen=True, slots=True)
class Followed:
    """The cells of a film; `damaged` of its `pictures` could not be read, or are not as large as
    most.

    `remarks` are lines for the user. `doubtful` lists cells that could not be distinguished after
    they met.
    """

    paths: tuple[CellPath, ...]
    pictures: int
    damaged: int
    size: tuple[int, int]
    timing: PictureTimes
    um_px: float
    organism: Organism
    remarks: tuple[str, ...]
    bright: bool
    contrast: float
    noise: float
    doubtful: tuple[tuple[int, ...], ...]

    @property
    def seconds(self) -> float:
        """Length of the film [s]."""
        return self.timing.duration(0, self.pictures - 1)

    @property
    def rate_hz(self) -> float:
        """The mean rate of the pictures [Hz]."""
        return self.timing.rate_hz

    @property
    def number_lasts_s(self) -> float | None:
        """Median time for which a number lasts [s], None without cells."""
        return _median_s([path.times for path in self.paths])

    @property
    def track_lasts_s(self) -> float | None:
        """Median time for which a track lasts, under one number after another [s]."""
        times_of_track = defaultdict[int, list[float]](list)
        for path in self.paths:
            for seconds, _, cell in path.pictures():
                times_of_track[cell.track].append(seconds)
        return _median_s(list(times_of_track.values()))


def follow(
    film: FilmPictures,
    um_px: float,
    field: FieldRecord | None,
    organism: Organism | None = None,
    on_picture: Callable[[int], None] = lambda number: None,
) -> Followed:
    """Follow the cells of a film of an organism, Tetrahymena if none is named, at a scale [um/px].

    Raises as `examine_first`.
    """
    finder, remarks = examine_first(film, um_px, organism)
    followed = organism or TETRAHYMENA
    tracker = CellTracker(um_px, field is not None, organism=followed, splits=True)
    tracker.take(finder)
    pieces = no_field if field is None else field.pieces
    where = Whereabouts()
    lights = []
    disturbances = Disturbances(um_px, followed.body_um[0])
    for number, picture in film:
        seconds = film.seconds(number)
        where.enter(number, seconds, tracker, tracker.see(picture, seconds, pieces))
        lights.append(tracker.finder.light)
        disturbances.examine(picture, seconds, tracker.finder)
        on_picture(number)
    tracker.finish()
    for answer in tracker.answers:
        where.answer(answer)
    where.end_at_gaps()
    contrasts = [light.contrast for light in lights if light.contrast is not None]
    contrast = float(np.median(contrasts)) if contrasts else None
    limit, noise = np.median([(light.limit, light.noise) for light in lights], axis=0).tolist()
    lines = [faint_line(contrast, limit), _faded_line(where), *_pace_lines(where)]
    lines += disturbances.lines()
    time_line = film.time_line()
    timed = () if time_line is None else (time_line,)
    background = tracker.finder.background
    assert background is not None
    height, width = background.shape
    return Followed(
        paths=tuple(where.paths(followed)),
        pictures=len(where.frames) + film.damaged,
        damaged=film.damaged,
        size=(width, height),
        timing=film.timing,
        um_px=um_px,
        organism=followed,
        remarks=(*timed, *remarks, *(f"warning: {line}" for line in lines if line)),
        bright=tracker.finder.bright,
        contrast=contrast or 0.0,
        noise=noise,
        doubtful=tuple(where.doubtful),
    )


def _median_s(times: Sequence[Sequence[float] | Floats]) -> float | None:
    """Return the median time from the earliest to the latest of some times [s], None of none."""
    return float(np.median([np.ptp(shown_s) for shown_s in times])) if times else None


def _faded_line(where: Whereabouts) -> str | None:
    """Return a line if followed cells have no blob in many of their pictures; None if not."""
    lost = [not row.cell.has_blob for rows in where.tracks.values() for row in rows]
    if not lost or np.mean(lost) <= FADED:
        return None
    return (
        f"followed cells are not seen in {100 * np.mean(lost):.0f} % of their pictures: what is "
        "said of them may be wrong. Keep them in focus and in more contrast"
    )


def _pace_lines(where: Whereabouts) -> Iterator[str]:
    """Yield a line if all cells move too far at once in several pictures, and one if not at all."""
    speeds_in = _relative_speeds(where)
    of_many = [speeds for speeds in speeds_in.values() if len(speeds) >= TELL]
    pace = np.array([np.median(speeds) for speeds in of_many])
    least = max(ODD[0] * len(pace), ODD[1])
    lost = int((pace > LOST).sum())
    doubled = int((pace < DOUBLED).sum())
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


def _relative_speeds(where: Whereabouts) -> dict[int, list[float]]:
    """Return, by picture, the speeds of the cells that have blobs of their own in it and in the one
    before, relative to the median speed on their tracks.
    """
    speeds_in = defaultdict[int, list[float]](list)
    for rows in where.tracks.values():
        pictures: list[int] = []
        speeds_um_s: list[float] = []
        for before, now in pairwise(rows):
            blob_before = before.cell.blob_um
            blob_now = now.cell.blob_um
            is_merged = before.cell.merged or now.cell.merged
            is_next = now.picture == before.picture + 1
            if is_next and not is_merged and blob_before is not None and blob_now is not None:
                way_um = math.dist(blob_before[:2].tolist(), blob_now[:2].tolist())
                passed_s = where.times[now.picture] - where.times[before.picture]
                pictures.append(now.picture)
                speeds_um_s.append(way_um / passed_s)
        if speeds_um_s:
            usual_um_s = max(float(np.median(speeds_um_s)), 1e-9)
            for picture, speed_um_s in zip(pictures, speeds_um_s, strict=True):
                speeds_in[picture].append(speed_um_s / usual_um_s)
    return speeds_in
