"""Examines a film's first pictures: learns the background, and tells what will not be followed.

The film is run through up to three times, of which only the beginning is read:

1. The background is the median of pictures spread over the first 20 s (`_learned`).
2. Blobs of the first 1.5 s are linked to ways, by the least sum of distances from where uniform
   motion would take them; no organism is assumed (`_ways`).
3. `_motion` fits a line to each way. What moves straight is compared with the sizes and speeds of
   the organism: objects unlike it are counted, and an organism that is like them is named.
4. `onward` tells swimmers from what goes to and fro, as beads in water do.

A way is rows (K, 5) of time [s], x, y, length and width [px].
"""

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.poses import Floats, Grey
from tetractl_microscope.cells.cells_health import SMALL_PX
from tetractl_microscope.cells.detect_cells import BlobFinder
from tetractl_microscope.cells.specks import straight
from tetractl_microscope.film.onward import (
    TO_AND_FRO,
    WAYS_MIN,
    Onward,
    hardly_any_goes_on,
    onward,
)
from tetractl_microscope.film.pictures import ONE_PICTURE, ONE_PICTURE_HINT, FilmPictures
from tetractl_microscope.organisms import TETRAHYMENA, Organism
from tetractl_microscope.pictures.searches import stated
from tetractl_microscope.registries import ORGANISMS

LOOK_S = 1.5  # duration of the pictures that are searched [s]
LOOKED = 40  # greatest number of them
LATEST_S = 9.0  # time until which more are searched if few objects were seen [s]
ENOUGH = 3  # least number of objects that is not few
LEAST_PX = 30.0  # least area of an object [px]
MOST_SHARE = 0.02  # greatest, as a share of the picture
REACH = 1.5  # way from one picture to the next, in lengths of the object, up to which it is itself
SEEN = 6  # fewest pictures of an object whose speed is known
MOVED = 0.3  # way over all its pictures, in lengths of the object, above which it moves
STRAIGHT = 0.2  # root mean square distance from even straight motion, as a share of that way
BACKGROUND = 25  # number of pictures for the background
SAMPLE_PX = 50_000_000  # most pixels of these pictures together, which memory limits
ROUNDING_S = 1e-9  # error of a time by rounding [s]
BACKGROUND_S = 20.0  # length of the film's first part, which gives the background [s]
FAST = 1.5  # factor by which an object may be faster than an organism is
FAR = 2.0  # way of the fastest cells between pictures, in lengths, above which links are uncertain

SOME_TO_AND_FRO = "most of what moves goes to and fro, as beads do; the rest is followed"


@dataclass(frozen=True, slots=True)
class UniformMotion:
    """The uniform motion of an object: its length, width and way [um], and its speed [um/s]."""

    long_um: float
    wide_um: float
    speed_um_s: float
    way_um: float

    def fits(self, organism: Organism) -> bool:
        """Return whether length, width and speed may be those of an organism."""
        (short, long), (thin, thick) = organism.outline_um
        return (
            short < self.long_um < long
            and thin < self.wide_um < thick
            and organism.slowest_um_s < self.speed_um_s < FAST * organism.speed_um_s[1]
        )


def examine_first(
    film: FilmPictures, um_px: float, organism: Organism | None = None
) -> tuple[BlobFinder, tuple[str, ...]]:
    """Examine the first pictures of a film of an organism, Tetrahymena if none is named, at a scale
    [um/px]. Returns a finder that has learned the background, and lines for the user.

    TetractlError if no picture of it can be read or, unless an organism is named, if what moves
    goes to and fro.
    """
    followed = organism or TETRAHYMENA
    finder = _learned(film)
    ways = _ways(film, copy.copy(finder))
    motions = stated(_motion(rows, um_px) for rows in ways)
    fitting = sum(motion.fits(followed) for motion in motions)
    like = f"{fitting} of {len(motions)} objects that swim at first have its size and speed"
    remarks = [f"followed as {followed.name}: {like}"]
    remarks += [f"warning: {line}" for line in _to_and_fro_lines(film, ways, organism)]
    remarks += [f"warning: {line}" for line in _unlike_lines(motions, followed)]
    remarks += [f"warning: {line}" for line in _coarse_lines(followed, um_px, film.rate_hz)]
    return finder, tuple(remarks)


# ---- 1: the background ----


def _learned(film: FilmPictures) -> BlobFinder:
    """Return a finder that has learned the film's background."""
    sample = _sample(film)
    if not sample:
        raise TetractlError(f"{film.path}: no picture of the film can be read")
    if len(sample) == 1:
        raise UsageError(f"{film.path}: {ONE_PICTURE}", ONE_PICTURE_HINT)
    finder = BlobFinder(LEAST_PX, MOST_SHARE * sample[0].size)
    finder.learn(sample)
    return finder


def _sample(film: FilmPictures) -> list[Grey]:
    """Return pictures spread evenly over the film's first BACKGROUND_S, at least BACKGROUND and at
    most twice as many; all pictures if there are fewer. Of large pictures there are fewer.
    """
    count = 0
    pixels = 1
    for number, picture in film:
        count += 1
        pixels = picture.size
        if film.timing.duration(0, number) >= BACKGROUND_S - ROUNDING_S:
            break
    step = max(1, count // BACKGROUND, math.ceil(count * pixels / SAMPLE_PX))
    return [picture for i, (_, picture) in zip(range(count), film, strict=False) if i % step == 0]


# ---- 2: the ways of objects ----


def _ways(film: FilmPictures, finder: BlobFinder) -> list[Floats]:
    """Return the way (K, 5) of each object in the film's first pictures."""
    step = max(1, math.ceil(film.rate_hz * LOOK_S / LOOKED))
    paths: list[list[Floats]] = []
    going: list[list[Floats]] = []  # those of the newest picture
    for number, picture in film:
        seconds = film.seconds(number)
        long_paths = sum(len(path) >= SEEN for path in paths)
        if seconds > (LOOK_S if long_paths >= ENOUGH else LATEST_S) and number > 2 * SEEN:
            break
        if number % step:
            continue
        blobs = (blob for blob in finder.find(picture) if not blob.at_edge)
        rows = np.array([(seconds, b.x, b.y, b.long, b.wide) for b in blobs]).reshape(-1, 5)
        going = _gone_on(going, rows)
        for path, row in zip(going, rows, strict=True):
            if not path:
                paths.append(path)
            path.append(row)
    return [np.array(path) for path in paths]


def _gone_on(going: Sequence[list[Floats]], rows: Floats) -> list[list[Floats]]:
    """Return the path that each blob of the next picture (B, 5) goes on with, empty if it begins
    one: the sum of distances from where uniform motion leads is least.
    """
    last = np.array([(path[-1], path[-2:][0]) for path in going]).reshape(-1, 2, 5)
    ahead = 2 * last[:, 0, 1:3] - last[:, 1, 1:3]
    gaps = np.linalg.norm(ahead[:, None] - rows[:, 1:3], axis=-1)
    path_of = {}
    for i, j in zip(*linear_sum_assignment(gaps), strict=True):
        if gaps[i, j] < REACH * last[i, 0, 3]:
            path_of[int(j)] = going[i]
    return [path_of.get(j, []) for j in range(len(rows))]


# ---- 3: what moves straight, and what it may be ----


def _motion(rows: Floats, um_px: float) -> UniformMotion | None:
    """Return how an object moves along its way (K, 5); None if it hardly moves, or not evenly and
    straight, or if it was seen too briefly.
    """
    if len(rows) < SEEN:
        return None
    velocity, fitted = straight(rows)
    strayed = np.sqrt(np.mean(np.square(rows[:, 1:3] - fitted)))
    long, wide = np.median(rows[:, 3:], axis=0).tolist()
    speed = math.hypot(*velocity)
    way = speed * float(np.ptp(rows[:, 0]))
    if way <= MOVED * long or strayed >= STRAIGHT * way:
        return None
    return UniformMotion(um_px * long, um_px * wide, um_px * speed, um_px * way)


def _unlike_lines(motions: Sequence[UniformMotion], followed: Organism) -> Iterator[str]:
    """Yield a line if two or more objects move by more than their lengths and cannot be of the
    organism that is followed.
    """
    unlike = [m for m in motions if m.way_um > m.long_um and not m.fits(followed)]
    if len(unlike) < 2:
        return
    sizes = np.array([(motion.long_um, motion.speed_um_s) for motion in unlike])
    (short, slow), (long, fast) = np.quantile(sizes, [0.1, 0.9], axis=0).tolist()
    organisms = ORGANISMS.usable().values()
    fitting = {kind.name: sum(motion.fits(kind) for motion in unlike) for kind in organisms}
    likest = max(fitting, key=lambda name: fitting[name])
    hint = "no known organism is like that: is --scale right?"
    if fitting[likest]:
        hint = f"--organism {likest} follows them, if they swim and do not drift"
    yield (
        f"{len(unlike)} objects that move have not the size and speed of {followed.name}, but are "
        f"{short:.0f} to {long:.0f} um long at {slow:.0f} to {fast:.0f} um/s, and not followed: "
        f"{hint}"
    )


def _coarse_lines(followed: Organism, um_px: float, rate_hz: float) -> Iterator[str]:
    """Yield a line if the pictures are too coarse, and one if they are too rare."""
    long, wide = followed.body_um
    fast = followed.speed_um_s[1]
    if wide / um_px < SMALL_PX:
        yield (
            f"{followed.name} is {wide / um_px:.1f} px wide at {um_px:.3g} um/px; "
            f"{SMALL_PX:.0f} px or more are needed: cells may be missed, or be of another kind"
        )
    if fast / rate_hz > FAR * long:
        yield (
            f"{rate_hz:.3g} pictures a second are too few to distinguish cells: "
            f"{followed.name} of {fast:.0f} um/s moves {fast / rate_hz / long:.1f} lengths; "
            f"film at {math.ceil(fast / (FAR * long))} or more"
        )


# ---- 4: what goes to and fro ----


def _to_and_fro_lines(
    film: FilmPictures, ways: Sequence[Floats], named: Organism | None
) -> Iterator[str]:
    """Yield a line if objects that move go to and fro; TetractlError if hardly any goes on as it
    went, unless an organism is `named`.
    """
    objects = _objects(ways)
    together = Onward(sum(single.alike for single in objects), sum(o.most for o in objects))
    if len(objects) < WAYS_MIN or together.goes_on:
        return
    if not hardly_any_goes_on([single.goes_on for single in objects]):
        yield SOME_TO_AND_FRO
        return
    if named is None:
        hint = "--organism NAME looks for one all the same"
        raise TetractlError(f"{film.path}: {TO_AND_FRO}", hint)
    yield TO_AND_FRO


def _objects(ways: Sequence[Floats]) -> list[Onward]:
    """Return how objects that move go on, over the time in which each usually gets MOVED lengths
    away.
    """
    objects = list[Onward]()
    for rows in ways:
        apart = _pictures_apart(rows)
        if apart is not None:
            objects.append(onward(rows[:, 1:3], apart))
    return objects


def _pictures_apart(rows: Floats) -> int | None:
    """Return in how many pictures an object usually gets MOVED lengths away; None if in more than
    half of its pictures, or if it was seen too briefly.
    """
    if len(rows) < SEEN:
        return None
    least = MOVED * np.median(rows[:, 3])
    for apart in range(1, (len(rows) - 1) // 2 + 1):
        moved = rows[apart:, 1:3] - rows[:-apart, 1:3]
        if np.median(np.linalg.norm(moved, axis=1)) > least:
            return apart
    return None
