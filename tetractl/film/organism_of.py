"""Recognises the organism of a film by the sizes and speeds of what moves in its first pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.errors import TetractlError
from tetractl.core.poses import Bools, Floats, Grey
from tetractl.core.registries import ORGANISMS
from tetractl.film.pictures import FilmPictures
from tetractl.lab.cameras.cells.detect_cells import Blob, BlobFinder
from tetractl.model.organisms import Organism

LOOK_S, LOOKED = 1.5, 40  # duration [s] and greatest number of the pictures that are searched,
LATEST_S, ENOUGH = 9.0, 3  # or until this time if fewer objects than these were seen
LEAST_PX, MOST_SHARE = 30.0, 0.02  # areas of objects: in pixels, and as a share of the picture
REACH = 1.5  # way from one picture to the next, in lengths of the object, up to which it is itself
SEEN = 6  # fewest pictures of an object whose speed is known
MOVED = 0.3  # way over all its pictures, in lengths of the object, above which it moves
STRAIGHT = 0.2  # root mean square distance from even straight motion, as a share of that way
FAST = 1.5  # factor by which an object may be faster than an organism is


@dataclass(frozen=True, slots=True)
class Recognised:
    """The organism that a film is searched for, the scale [um/px], whether that is `guessed` from
    the organism's length, and lines for the user on both.
    """

    organism: Organism
    um_px: float
    guessed: bool
    remarks: tuple[str, ...]


def recognised(
    film: FilmPictures,
    sample: Sequence[Grey],
    um_px: float | None,
    organism: Organism | None = None,
) -> Recognised:
    """Return the organism and scale of a film; `sample` are pictures that give its background.

    Without an organism, it is the one that covers most of the way that objects swim. Sizes without
    a scale tell nothing: then it is the first that is known, Tetrahymena, and the scale is the one
    at which objects that swim have the organism's length. TetractlError if nothing swims there.
    """
    moving = _moving(film, sample)
    known = list(ORGANISMS.usable().values())
    usual = float(np.median(moving[:, 0])) if len(moving) else math.nan
    if um_px is None:
        if not len(moving):
            raise TetractlError(
                f"{film.path}: nothing swims in the first {LATEST_S:g} s: the scale is unknown",
                "give the scale: --scale UM_PER_PIXEL",
            )
        taken = organism or known[0]
        scale = taken.body_um[0] / usual
        why = (
            f"warning: the scale is a guess: what swims is {usual:.0f} px long, as "
            f"{taken.name} of {taken.body_um[0]:.0f} um are at {scale:.3g} um/px; lengths and "
            "speeds have this guess's error. Give the scale by --scale, what swims by --organism"
        )
        return Recognised(taken, scale, True, (why, *_others(moving, taken, known, scale)))
    why = []
    taken = organism
    if taken is None:
        ways = _shares(moving, known, um_px)
        taken = known[int(np.argmax(ways))]  # the first if nothing moves
        fits = _fits(moving, taken, um_px)
        few = f"{fits.sum()} of {len(moving)} objects that swim have its size and speed"
        none = "nothing that swims in the first pictures has a known size and speed"
        why = [f"cells are taken for {taken.name}: {few if fits.any() else none}"]
    return Recognised(taken, um_px, False, (*why, *_others(moving, taken, known, um_px)))


def _moving(film: FilmPictures, sample: Sequence[Grey]) -> Floats:
    """Return length, width [px], speed [px/s] and way [px] of each object (M, 4) that moves evenly
    and straight in the film's first pictures.
    """
    finder = BlobFinder(LEAST_PX, MOST_SHARE * sample[0].size)
    finder.learn(sample)
    step = max(1, math.ceil(film.rate_hz * LOOK_S / LOOKED))
    going: list[list[tuple[float, Blob]]] = []
    ended: list[list[tuple[float, Blob]]] = []
    for number, picture in film:
        seen = sum(len(path) >= SEEN for path in (*ended, *going))
        if film.seconds(number) > (LOOK_S if seen >= ENOUGH else LATEST_S) and number > 2 * SEEN:
            break
        if number % step or picture.shape != sample[0].shape:
            continue
        blobs = [blob for blob in finder.find(picture) if not blob.at_edge]
        seconds, taken = film.seconds(number), _next(going, blobs)
        ended += [path for i, path in enumerate(going) if i not in taken]
        going = [[*path, (seconds, blobs[taken[i]])] for i, path in enumerate(going) if i in taken]
        used = set(taken.values())
        going += [[(seconds, blob)] for j, blob in enumerate(blobs) if j not in used]
    measured = [_motion(path) for path in ended + going if len(path) >= SEEN]
    rows = [row for row, moves in measured if moves]
    return np.array(rows).reshape(-1, 4)


def _next(going: Sequence[Sequence[tuple[float, Blob]]], blobs: Sequence[Blob]) -> dict[int, int]:
    """Return {path: blob} of the nearest blobs within reach, each blob on one path."""
    if not going or not blobs:
        return {}
    last = [path[-1][1] for path in going]
    before = [path[max(0, len(path) - 2)][1] for path in going]
    expected = np.array([(2 * b.x - a.x, 2 * b.y - a.y) for a, b in zip(before, last, strict=True)])
    gaps = np.linalg.norm(expected[:, None] - [(blob.x, blob.y) for blob in blobs], axis=-1)
    pairs = zip(*linear_sum_assignment(gaps), strict=True)
    return {int(i): int(j) for i, j in pairs if gaps[i, j] < REACH * last[i].long}


def _motion(path: Sequence[tuple[float, Blob]]) -> tuple[tuple[float, ...], bool]:
    """Return length, width, speed and way of an object, and whether it moves."""
    rows = np.array([(at, blob.x, blob.y, blob.long, blob.wide) for at, blob in path])
    times = rows[:, 0] - rows[:, 0].mean()
    places = rows[:, 1:3] - rows[:, 1:3].mean(axis=0)
    velocity = times @ places / (times @ times)
    strayed = float(np.sqrt(np.mean(np.square(places - times[:, None] * velocity))))
    speed = float(np.hypot(*velocity))
    way, (long, wide) = speed * float(np.ptp(times)), np.median(rows[:, 3:], axis=0).tolist()
    return (long, wide, speed, way), way > MOVED * long and strayed < STRAIGHT * way


def _fits(moving: Floats, kind: Organism, um_px: float) -> Bools:
    """Return whether each moving object (M,) may be of this kind."""
    speeds = kind.slowest_um_s, FAST * kind.speed_um_s[1]
    limits = np.array([kind.outline_long_um, kind.outline_wide_um, speeds]) / um_px
    inside = (moving[:, :3] > limits[:, 0]) & (moving[:, :3] < limits[:, 1])
    return inside[:, 0] & inside[:, 1] & inside[:, 2]


def _shares(moving: Floats, kinds: Sequence[Organism], um_px: float) -> Floats:
    """Return the way [px] of the objects that are most like each kind (K,)."""
    unlike = np.full((len(kinds), len(moving)), np.inf)
    for k, kind in enumerate(kinds):
        ranges = np.log([kind.long_um, kind.wide_um, kind.speed_um_s])
        off = np.log(moving[:, :3] * um_px) - ranges.mean(axis=1)
        fits = _fits(moving, kind, um_px)
        unlike[k, fits] = np.square(off / np.ptp(ranges, axis=1)).sum(axis=1)[fits]
    nearest = np.where(np.isfinite(unlike.min(axis=0)), unlike.argmin(axis=0), -1)
    return np.array([moving[nearest == k, 3].sum() for k in range(len(kinds))])


def _others(
    moving: Floats, taken: Organism, kinds: Sequence[Organism], um_px: float
) -> tuple[str, ...]:
    """Return a line on objects that move but cannot be of the kind `taken`, if there are two."""
    swims = moving[:, 3] > moving[:, 0]
    left = moving[swims & ~_fits(moving, taken, um_px)]
    if len(left) < 2:
        return ()
    low, usual, high = np.quantile(left[:, :3] * um_px, [0.1, 0.5, 0.9], axis=0)
    better = kinds[int(np.argmax(_shares(left, kinds, um_px)))]
    unlike = _difference(usual, taken)
    hint = f"--organism {better.name} follows them"
    if not _fits(left, better, um_px).any():
        hint = "no known organism is like that"
    elif unlike == "slower":
        hint += ", if they swim and do not drift"
    return (
        f"warning: {len(left)} objects that move are {unlike} than {taken.name}, {low[0]:.0f} to "
        f"{high[0]:.0f} um long at {low[2]:.0f} to {high[2]:.0f} um/s, and not followed: {hint}",
    )


def _difference(usual: Floats, taken: Organism) -> str:
    """Return how objects of a usual length, width [um] and speed [um/s] differ from a kind."""
    ranges = taken.outline_long_um, taken.outline_wide_um, (taken.slowest_um_s, math.inf)
    words = ("shorter", "longer"), ("thinner", "wider"), ("slower", "faster")
    for value, (least, most), (under, over) in zip(usual, ranges, words, strict=True):
        if not least < value < most:
            return under if value <= least else over
    return "faster"
