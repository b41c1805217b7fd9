"""How much of what moves in a film is not followed: a count that wrong tracks cannot spoil.

A blob moves if its middle differs, by more than half of its contrast and than noise, from the same
place both before and after it, in the same sense, by the time in which followed cells swim AWAY. It
is followed if a cell that has a blob is shown on it. Blobs that the picture's edge cuts off do not
count.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells.cell import to_edge
from tetractl_microscope.cells.detect_cells import Blob
from tetractl_microscope.cells.picture_now import pixels_of
from tetractl_microscope.film.kinematics import way_um
from tetractl_microscope.film.who import CellPath

EVERY = 3  # every third picture is examined
AWAY = 0.75  # way that followed cells swim between the pictures that are compared [lengths]
CORE = 0.25  # radius of a blob's middle that is compared, in its widths
DIFFERS = 0.5  # share of a blob's contrast by which a place differs if the blob has left it
# distance of a cell's place from the middle of its blob, as a share of that of the blob's edge, up
# to which it is on the blob: a smoothed place is at its edge at most
BESIDE = 1.01
BLOBS_MIN = 20  # fewest moving blobs of which a share is stated

BEFORE, NOW, AFTER = range(3)


@dataclass(slots=True)
class _Examined:
    """The B blobs of one picture: columns and rows of their middles (B, 2), radii of these (B,)
    [px], axes (B,) [rad], lengths and widths (B,) [px], differences (B,) by which a place differs
    if its blob has left it, and the grey levels (3, B) there, less those of their surroundings,
    before, now and after.
    """

    middles: Floats
    radii: Floats
    axes: Floats
    lengths: Floats
    widths: Floats
    differences: Floats
    levels: Floats


@dataclass(slots=True)
class Unfollowed:
    """Collects the blobs of a film's pictures, and then counts those that move and are not
    followed.
    """

    _blobs: dict[int, _Examined] = field(default_factory=dict)
    _times: dict[int, float] = field(default_factory=dict)
    _height: int = 0  # of a picture [px]

    def add(self, number: int, seconds: float, limit: float, blobs: Sequence[Blob]) -> None:
        """Add the blobs of a picture taken at a time [s], in which less than a `limit` is noise."""
        self._times[number] = seconds
        inside = [blob for blob in blobs if not blob.at_edge]
        if len(self._times) % EVERY or not inside:
            return
        rows = np.array([(b.x, b.y, b.axis, b.long, b.wide, b.strength) for b in inside])
        self._blobs[number] = _Examined(
            middles=rows[:, :2],
            radii=CORE * rows[:, 4],
            axes=rows[:, 2],
            lengths=rows[:, 3],
            widths=rows[:, 4],
            differences=np.maximum(DIFFERS * np.abs(rows[:, 5]), limit),  # more than noise
            levels=np.full((3, len(inside)), np.nan),
        )

    def share(
        self,
        film: Iterable[tuple[int, Grey]],
        paths: Sequence[CellPath],
        um_px: float,
        body_um: float,
    ) -> float | None:
        """Return the share of moving blobs that none of the paths follows, None if few move."""
        speeds = [_speed(path) for path in paths if len(path.times) > 1]
        if not speeds or not self._blobs:
            return None
        usual_um_s = max(float(np.median(speeds)), 1e-9)
        self._measure(film, AWAY * body_um / usual_um_s)
        places_in = defaultdict[int, list[tuple[float, float]]](list)
        for path in paths:
            followed = (row for row in path.pictures() if row[2].has_blob)
            for _, number, cell in followed:
                places_in[number].append((cell.x, cell.y))
        moving = 0
        missed = 0
        for number, blobs in self._blobs.items():
            before, now, after = blobs.levels
            appeared = now - before
            faded = now - after
            # where a speck drifts, the grey level goes on from before to after
            moves = (np.minimum(np.abs(appeared), np.abs(faded)) > blobs.differences) & (
                appeared * faded > 0
            )
            near = np.zeros(len(moves), bool)
            if places_in[number]:
                places = pixels_of(np.array(places_in[number]), um_px, self._height)
                off = places[:, None] - blobs.middles
                away = to_edge(off, blobs.axes, blobs.lengths, blobs.widths)
                near = away.min(axis=0) < BESIDE
            moving += int(moves.sum())
            missed += int((moves & ~near).sum())
        return missed / moving if moving >= BLOBS_MIN else None

    def _measure(self, film: Iterable[tuple[int, Grey]], apart_s: float) -> None:
        """Measure the blobs' places in their pictures, and in those `apart_s` [s] away."""
        numbers = np.array(list(self._times))
        times = np.array(list(self._times.values()))
        wanted = defaultdict[int, list[tuple[int, _Examined]]](list)
        for number, blobs in self._blobs.items():
            now_s = self._times[number]
            wanted[number].append((NOW, blobs))
            for when, due_s in ((BEFORE, now_s - apart_s), (AFTER, now_s + apart_s)):
                nearest = int(np.abs(times - due_s).argmin())
                if times[0] <= due_s <= times[-1] and numbers[nearest] != number:
                    wanted[int(numbers[nearest])].append((when, blobs))
        for number, picture in film:
            self._height = picture.shape[0]
            for when, blobs in wanted.get(number, ()):
                middles = np.rint(blobs.middles).astype(int).tolist()
                cores = map(partial(_square, picture), middles, blobs.radii)
                around = map(partial(_square, picture), middles, np.ceil(blobs.lengths))
                blobs.levels[when] = [
                    core.mean() - np.median(surroundings)
                    for core, surroundings in zip(cores, around, strict=True)
                ]


def _square(picture: Grey, middle: Sequence[int], reach: float) -> Grey:
    """Return the square about a column and row of a picture that reaches so many whole pixels."""
    column, row = middle
    side = int(reach)
    return picture[max(row - side, 0) : row + side + 1, max(column - side, 0) : column + side + 1]


def _speed(path: CellPath) -> float:
    """Return the speed of a path [um/s]."""
    return float(way_um(path.places) / (path.times[-1] - path.times[0]))
