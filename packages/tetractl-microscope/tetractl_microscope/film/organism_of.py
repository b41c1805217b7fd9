"""Recognises the organism of a film by the sizes and speeds of what moves in its first pictures."""

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.errors import TetractlError, UsageError
from tetractl.core.poses import Bools, Floats, Grey
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
from tetractl_microscope.organisms import Organism
from tetractl_microscope.registries import ORGANISMS

LOOK_S = 1.5  # duration of the pictures that are searched [s]
LOOKED = 40  # greatest number of them
LATEST_S = 9.0  # time until which more are searched if few objects were seen [s]
ENOUGH = 3  # least number of objects that is not few
COARSE_PX = 4.0  # width below which a large organism cannot be distinguished from a small one
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
KNOWN = 0.25  # least share of what swims that an organism must be like (beads in water 3 of 81)

SOME_TO_AND_FRO = "most of what moves goes to and fro, as beads do; the rest is followed"


@dataclass(frozen=True, slots=True)
class Recognised:
    """The organism that a film is searched for, the scale [um/px], whether that is `guessed` from
    the organism's length, lines for the user on both, and a finder that has learned the background.
    """

    organism: Organism
    um_px: float
    guessed: bool
    remarks: tuple[str, ...]
    finder: BlobFinder


def recognised(
    film: FilmPictures, um_px: float | None, organism: Organism | None = None
) -> Recognised:
    """Return the organism and scale of a film; TetractlError if no picture of it can be read.

    Without an organism, it is the one that covers most of the way that objects swim; TetractlError
    if they go to and fro instead, or if fewer than the share KNOWN are like it. Sizes without a
    scale tell nothing: then it is the first that is known, Tetrahymena, and the scale is the one
    at which objects that swim have the organism's length. TetractlError if nothing swims there.
    """
    finder = _learned(film)
    ways = _ways(film, copy.copy(finder))
    moving = _moving(ways)
    organisms = list(ORGANISMS.usable().values())
    taken = organism or organisms[0]
    scale = um_px
    why = ()
    still = ()
    objects = _objects(ways)
    together = Onward(sum(single.alike for single in objects), sum(o.most for o in objects))
    if len(objects) >= WAYS_MIN and not together.goes_on:
        still = (f"warning: {SOME_TO_AND_FRO}",)
        if organism is None and hardly_any_goes_on(objects):
            raise TetractlError(
                f"{film.path}: {TO_AND_FRO}", "--organism NAME looks for one all the same"
            )
        if hardly_any_goes_on(objects):
            still = (f"warning: {TO_AND_FRO}",)
    if scale is None:
        if not len(moving):
            raise TetractlError(
                f"{film.path}: nothing swims in its first pictures, up to {LATEST_S:g} s: "
                "the scale is unknown",
                "give the scale: --scale UM_PER_PIXEL",
            )
        usual = float(np.median(moving[:, 0]))
        scale = taken.body_um[0] / usual
        why = (
            f"warning: the scale is a guess: what swims is {usual:.0f} px long, as "
            f"{taken.name} of {taken.body_um[0]:.0f} um are at {scale:.3g} um/px; lengths and "
            "speeds have this guess's error. Give the scale by --scale, what swims by --organism",
        )
    moving = moving * scale
    usual_um = organisms[0].body_um[0]
    # small cells seem larger in coarse pictures
    organisms = [
        k for k in organisms if k.body_um[0] <= usual_um or k.body_um[1] >= COARSE_PX * scale
    ]
    if um_px is not None and organism is None:
        taken = organisms[int(np.argmax(_shares(moving, organisms)))]  # the first if nothing moves
        fits = _fits(moving, taken)
        if len(moving) >= ENOUGH and fits.mean() < KNOWN:
            hints = *_coarse(taken, scale, film.rate_hz), "--organism NAME follows one all the same"
            raise TetractlError(
                f"{film.path}: no known organism: {len(moving)} objects that swim are "
                f"{_extent(moving)}, {fits.sum()} of them like {taken.name}",
                "is --scale right? " + "; ".join(hints),
            )
        few = f"{fits.sum()} of {len(moving)} objects that swim have its size and speed"
        none = "nothing that swims in the first pictures has a known size and speed"
        why = (f"cells are taken for {taken.name}: {few if fits.any() else none}",)
    coarse = (f"warning: {line}" for line in _coarse(taken, scale, film.rate_hz))
    remarks = (*why, *still, *_others(moving, taken, organisms), *coarse)
    return Recognised(taken, scale, um_px is None, remarks, finder)


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


def _ways(film: FilmPictures, finder: BlobFinder) -> list[Floats]:
    """Return the way of each object in the film's first pictures: rows of time [s], x, y, length
    and width [px] (K, 5).
    """
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
        last = np.array([(path[-1], path[-2:][0]) for path in going]).reshape(-1, 2, 5)
        ahead = 2 * last[:, 0, 1:3] - last[:, 1, 1:3]
        gaps = np.linalg.norm(ahead[:, None] - rows[:, 1:3], axis=-1)
        pairs = zip(*linear_sum_assignment(gaps), strict=True)
        near = {int(j): going[i] for i, j in pairs if gaps[i, j] < REACH * last[i, 0, 3]}
        going = [near.get(j, []) for j in range(len(rows))]
        for path, row in zip(going, rows, strict=True):
            if not path:
                paths.append(path)
            path.append(row)
    return [np.array(path) for path in paths]


def _moving(ways: Sequence[Floats]) -> Floats:
    """Return length, width [px], speed [px/s] and way [px] of each object (M, 4) that moves evenly
    and straight.
    """
    motions = [_motion(rows) for rows in ways]
    return np.array([motion for motion in motions if motion]).reshape(-1, 4)


def _objects(ways: Sequence[Floats]) -> list[Onward]:
    """Return how objects that move go on, over the time in which each usually gets MOVED lengths
    away."""
    objects = list[Onward]()
    for rows in ways:
        apart = _pictures_apart(rows)
        if apart:
            objects.append(onward(rows[:, 1:3], apart))
    return objects


def _pictures_apart(rows: Floats) -> int:
    """Return in how many pictures an object usually gets MOVED lengths away; 0 if in more than half
    of its pictures, or if it was seen too briefly.
    """
    least = MOVED * np.median(rows[:, 3])
    for apart in range(1, (len(rows) - 1) // 2 + 1 if len(rows) >= SEEN else 0):
        moved = rows[apart:, 1:3] - rows[:-apart, 1:3]
        if np.median(np.linalg.norm(moved, axis=1)) > least:
            return apart
    return 0


def _extent(moving: Floats) -> str:
    """Say which lengths and speeds most moving objects (M, 4) have."""
    low, high = np.quantile(moving[:, :3], [0.1, 0.9], axis=0)
    return f"{low[0]:.0f} to {high[0]:.0f} um long at {low[2]:.0f} to {high[2]:.0f} um/s"


def _motion(rows: Floats) -> tuple[float, ...]:
    """Return length, width, speed and way of an object by its `rows`; nothing if it hardly moves,
    or was seen too briefly.
    """
    if len(rows) < SEEN:
        return ()
    velocity, fitted = straight(rows)
    strayed = np.sqrt(np.mean(np.square(rows[:, 1:3] - fitted)))
    long, wide = np.median(rows[:, 3:], axis=0)
    speed = math.hypot(*velocity)
    way = speed * np.ptp(rows[:, 0])
    moves = way > MOVED * long and strayed < STRAIGHT * way
    return (long, wide, speed, way) if moves else ()


def _fits(moving: Floats, kind: Organism) -> Bools:
    """Return whether each moving object (M,) has a length, width and speed of this kind."""
    speeds = kind.slowest_um_s, FAST * kind.speed_um_s[1]
    low, high = np.transpose([*kind.outline_um, speeds])
    return ((moving[:, :3] > low) & (moving[:, :3] < high)).all(axis=1)


def _shares(moving: Floats, kinds: Sequence[Organism]) -> Floats:
    """Return the way [um] of the objects that are most like each kind (K,)."""
    ranges = np.log([(kind.long_um, kind.wide_um, kind.speed_um_s) for kind in kinds])[:, None]
    off = (np.log(moving[:, :3]) - ranges.mean(axis=-1)) / np.ptp(ranges, axis=-1)
    fits = np.array([_fits(moving, kind) for kind in kinds])
    unlike = np.where(fits, np.square(off).sum(axis=-1), np.inf)
    nearest = fits & (unlike == unlike.min(axis=0))
    return nearest @ moving[:, 3]


def _coarse(taken: Organism, um_px: float, rate_hz: float) -> Iterator[str]:
    """Yield a line if the pictures are too coarse, and one if they are too rare."""
    long, wide = taken.body_um
    fast = taken.speed_um_s[1]
    if wide / um_px < SMALL_PX:
        yield (
            f"{taken.name} is {wide / um_px:.1f} px wide at {um_px:.3g} um/px; "
            f"{SMALL_PX:.0f} px or more are needed: cells may be missed, or be of another kind"
        )
    if fast / rate_hz > FAR * long:
        yield (
            f"{rate_hz:.3g} pictures a second are too few to distinguish cells: "
            f"{taken.name} of {fast:.0f} um/s moves {fast / rate_hz / long:.1f} lengths; "
            f"film at {math.ceil(fast / (FAR * long))} or more"
        )


def _others(moving: Floats, taken: Organism, kinds: Sequence[Organism]) -> tuple[str, ...]:
    """Return a line on objects that move but cannot be of the kind `taken`, if there are two."""
    unlike = moving[(moving[:, 3] > moving[:, 0]) & ~_fits(moving, taken)]
    if len(unlike) < 2:
        return ()
    better = kinds[int(np.argmax(_shares(unlike, kinds)))]
    follows = f"--organism {better.name} follows them, if they swim and do not drift"
    return (
        f"warning: {len(unlike)} objects that move have not the size and speed of {taken.name}, "
        f"but are {_extent(unlike)}, and not followed: "
        + (follows if _fits(unlike, better).any() else "no known organism is like that"),
    )
