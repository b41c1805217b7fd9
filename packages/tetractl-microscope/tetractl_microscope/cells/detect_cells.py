"""Finds blobs in a grey image: regions that differ from a slowly updated background.

The steps are: blur the image; subtract the background, scaled to the brightness of the image;
average the absolute difference over a square as small as the smallest cell, so that a body and its
halo become one region; keep the pixels that exceed the noise of these averages; compute the moments
of each body.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, Grey
from tetractl_microscope.cells.knocks import moved, shift_of

STRIPES = 16  # number of stripes of the background; each picture updates one
LEARNING = 0.1  # weight of the picture in an update: a time constant of 5 s at 30 Hz
SPARSE = 64  # number of rows sampled for light and noise, fewer in a small picture
ROWS_PX = 300_000  # most pixels of each picture that a median takes at a time
BOX = 1.2  # side of the averaged squares, relative to a square of the least area
# thresholds of averaged differences, in standard deviations of their noise
LOW = 3.0
HIGH = 4.5
LEAST = 0.33  # least standard deviation of that noise: pictures have whole grey levels
NOISY = 4.0  # growth of the noise at which the background no longer applies
NOISE_MAX = 20.0  # most noise of a picture that shows a dish [grey levels]
BLOBS = 200  # largest number of blobs of a picture; smaller ones are dropped
CHANGED = 0.25  # fraction of changed pixels above which the background no longer applies
EDGE = 0.5  # averaged difference at a body's edge, as a fraction of the greatest in the body
# least ratio of differences from what is around, in the background and in the picture, where a body
# is only in the background
GHOST = 2.0
RAMP = 0.2, 0.6  # differences between which a weight rises, relative to the body's greatest mean
BODIES = 4  # bodies in a region
NEXT = 0.5  # least peak of each, relative to the first's
KNOCK = 1.1, 0.0003  # factor and fraction by which a knock makes more of the picture change
USUAL_SHARE = 0.05  # weight of a picture in the mean changed fraction: 20 pictures; chosen
# light relative to the background's, beyond which a picture is compared as it is: it is nearly
# black, or the background is; chosen, and far beyond what a lamp is turned by
GAIN_LEAST = 0.05
GAIN_MOST = 20.0
# standard deviations in a median absolute deviation, if noise is normal: 1 / 0.6745, rounded
NORMAL_MAD = 1.48
# least span above their median of averaged differences without cells [grey levels]
USUAL_SPAN = 2.0
LOST = 5  # pictures lost until learning begins again
EVERY = 3  # it learns from the pictures of one of so many stripes
AGAIN = 9  # and begins again from so many


@dataclass(frozen=True, slots=True)
class Blob:
    """A region of an image that differs from the background.

    Attributes:
        x: x of its centre [px].
        y: y of its centre [px].
        axis: Its direction [rad], modulo pi.
        long: Long axis of the ellipse with the same moments [px].
        wide: Short axis of that ellipse [px].
        strength: Mean difference from the background [grey levels].
        body: A mask of the blob in a rectangle.
        corner: The rectangle's upper left pixel.
        at_edge: Whether the image's edge cuts the blob.
    """

    x: float
    y: float
    axis: float
    long: float
    wide: float
    strength: float
    body: Grey
    corner: tuple[int, int]
    at_edge: bool

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle of `body` in the image."""
        tall, wide = self.body.shape
        return Box(*self.corner, wide, tall).part

    @property
    def pixels(self) -> Floats:
        """Column and row of each of the blob's M pixels, shape (M, 2)."""
        rows, columns = np.nonzero(self.body)
        return np.column_stack([columns + self.corner[0], rows + self.corner[1]]).astype(float)


@dataclass(frozen=True, slots=True)
class Light:
    """Brightness, noise and contrast of an image.

    Attributes:
        gain: Brightness of the image, relative to the background.
        noise: Standard deviation of its noise [grey levels].
        contrast: Median strength of its blobs [grey levels]. None without blobs.
        changed: Fraction of the pixels that differ from the background.
        lost: Whether the image cannot be compared with the background, because cells cannot explain
            how much of it has changed.
        shift_px: How far the stage has moved since the previous image [px]: columns to the right,
            rows down.
        limit: Minimum contrast at which a cell is found [grey levels].
    """

    gain: float
    noise: float
    contrast: float | None
    changed: float
    lost: bool
    shift_px: tuple[float, float] = (0.0, 0.0)
    limit: float = 0.0


class Background:
    """The image of the dish without cells, which is learned and then slowly updated.

    Attributes:
        fine: The background, with fractions of grey levels.
        learned: The background when it was learned.
        grey: The background in whole grey levels.
    """

    def __init__(self, fine: NDArray[np.float32]) -> None:
        self.fine = fine
        self.learned = fine.copy()
        self.grey = _grey(cv2.convertScaleAbs(fine))

    def move(self, shift_px: tuple[float, float]) -> None:
        """Shift the background with the content of the image.

        Args:
            shift_px: Shift [px]: columns to the right, rows down.
        """
        self.fine = np.asarray(moved(self.fine, shift_px), np.float32)
        self.learned = np.asarray(moved(self.learned, shift_px), np.float32)
        self.grey = _grey(cv2.convertScaleAbs(self.fine))

    def follow_knock(self, smooth: Grey, gain: float) -> tuple[float, float]:
        """Shift the background as far as an image has shifted.

        Args:
            smooth: The blurred image.
            gain: Brightness of the image, relative to the background.

        Returns:
            The shift [px]: columns to the right, rows down.
        """
        shift = shift_of(cv2.convertScaleAbs(self.grey, alpha=gain), smooth)
        if shift != (0.0, 0.0):
            self.move(shift)
        return shift

    def correct(
        self, part: tuple[slice, slice], wrong: Bools, levels: NDArray[np.floating]
    ) -> None:
        """Replace wrong pixels in a part of the background.

        Args:
            part: The part, as slices of rows and columns.
            wrong: Which of its pixels to replace.
            levels: The grey levels that replace them.
        """
        self.fine[part][wrong] = levels[wrong]
        self.grey[part][wrong] = np.clip(self.fine[part][wrong], 0, 255)

    def update(self, rows: slice, levels: NDArray[np.float32], calm: Grey) -> None:
        """Update rows of the background by a weighted mean with new grey levels.

        Args:
            rows: The rows.
            levels: The new grey levels.
            calm: Mask of the pixels to update.
        """
        fine = self.fine[rows]
        cv2.accumulateWeighted(levels, fine, LEARNING, calm)
        self.grey[rows] = cv2.convertScaleAbs(fine)


class SearchLimits(NamedTuple):
    """Limits for finding bodies in the averaged difference from the background.

    Attributes:
        low: Minimum difference at every pixel of a body [grey levels].
        high: Minimum of the largest difference in a body [grey levels].
        least_px2: Minimum area of a body [px^2].
        most_px2: Maximum area of a body [px^2].
    """

    low: float
    high: float
    least_px2: float
    most_px2: float

    @property
    def level(self) -> float:
        """The mean of the averaged differences where there is no body [grey levels]."""
        return self.low - (self.high - self.low) * LOW / (HIGH - LOW)


NO_BODY = SearchLimits(low=math.inf, high=math.inf, least_px2=0.0, most_px2=0.0)
"""Limits that nothing exceeds, used until an image is compared with the background."""


class SearchArrays:
    """Working arrays for the newest image, all of the image's shape.

    Attributes:
        limits: The limits of the search.
        smooth: The blurred image.
        difference: Absolute difference between the blurred image and the background.
        mean: The difference averaged over squares.
        mask: Where `mean` is above the lower limit.
        stripe: Index of the stripe of the background that is updated next.
    """

    def __init__(self, picture: Grey) -> None:
        self.limits = NO_BODY
        self.smooth: Grey = np.zeros_like(picture)
        self.difference: Grey = np.zeros_like(picture)
        self.mean = np.empty(picture.shape, np.float32)
        self.mask: Grey = np.zeros_like(picture)
        self.stripe = 0

    def next_stripe(self) -> slice:
        """Return the rows of the stripe to update, and advance to the next one.

        After the lowest stripe, the topmost follows.
        """
        height = len(self.smooth)
        top = self.stripe * height // STRIPES
        bottom = (self.stripe + 1) * height // STRIPES
        self.stripe = (self.stripe + 1) % STRIPES
        return slice(top, bottom)


@dataclass(slots=True)
class LostPictures:
    """The images that could not be compared with the background.

    Attributes:
        in_turn: Number of such images in a row.
        sample: A sample of them, from which a new background is learned.
    """

    in_turn: int = 0
    sample: list[Grey] = field(default_factory=list)


class BlobFinder:
    """Finds blobs that are brighter or darker than the background.

    A blob covers `least_px2` to `most_px2` pixels after differences were averaged over squares
    slightly larger than the minimum. `learn` computes the background from images taken over a
    second or more. `follow` updates it with later images, except around the cells, so that the
    background never shows resting cells. After a knock, the background is moved by the image's
    shift. If a cell rested while the background was learned, that place is repaired once the cell
    has left. If the background no longer applies, it is learned again.

    `bright` is True if most moving objects are brighter than the background. `light` belongs to
    the newest image.
    """

    def __init__(self, least_px2: float, most_px2: float) -> None:
        self.least_px2 = least_px2
        self.most_px2 = most_px2
        self.bright = False
        self.light = Light(1.0, 0.0, None, 0.0, False)
        self._background: Background | None = None
        self._newest = SearchArrays(np.empty((0, 0), np.uint8))
        # the mean fraction of changed pixels, and the noise of the first picture after learning
        self._usual: Light | None = None
        self._lost = LostPictures()

    @property
    def background(self) -> Grey | None:
        """The background in whole grey levels. None before it was learned."""
        return None if self._background is None else self._background.grey

    def learn(self, pictures: Sequence[Grey]) -> None:
        """Compute the background as the median of images (height, width).

        Each image is first shifted and scaled to fit the middle one. The method also determines
        whether most cells are brighter or darker than the background.
        """
        medians = np.array([np.median(_sparse(picture)) for picture in pictures])
        levels = np.maximum(medians, 1.0)
        gains = np.median(levels) / levels
        half = len(pictures) // 2
        near = slice(max(0, half - 2), half + 3)
        usual = _grey(cv2.convertScaleAbs(_median(pictures[near], gains[near])))
        still = [
            moved(picture, shift_of(cv2.convertScaleAbs(picture, alpha=gain), usual))
            for picture, gain in zip(pictures, gains, strict=True)
        ]
        fine = _median(still, gains)
        _blurred(fine, np.empty_like(fine), fine)
        self._background = Background(fine)
        expected = _sparse(fine)
        apart = [
            gain * _sparse(picture) - expected for picture, gain in zip(still, gains, strict=True)
        ]
        self.bright = float(np.sum(np.power(apart, 3))) > 0  # noise is symmetric, cells are not
        self._usual = None
        self._lost = LostPictures()

    def find(self, picture: Grey) -> list[Blob]:
        """Find the blobs of an image (height, width), the largest first.

        The list is empty if the image cannot be compared with the background (`light.lost`).
        `learn` must have been called before.
        """
        assert self._background is not None, "learn() comes first"
        background = self._background
        if self._newest.smooth.shape != picture.shape:
            self._newest = SearchArrays(picture)
        newest = self._newest
        _blurred(picture, newest.difference, newest.smooth)
        light = self._compare(background, newest)
        usual = self._usual
        shift = (0.0, 0.0)
        if usual is None or light.changed > KNOCK[0] * usual.changed + KNOCK[1]:
            shift = background.follow_knock(newest.smooth, light.gain)
            if shift != (0.0, 0.0):
                light = self._compare(background, newest)
            changed = light.changed
        else:
            changed = usual.changed + USUAL_SHARE * (light.changed - usual.changed)
        first_noise = light.noise if usual is None else usual.noise
        self._usual = replace(light, changed=changed, noise=first_noise)
        noisy = light.noise > NOISY * max(first_noise, 1.0)
        is_relearning = len(self._lost.sample) > 0  # once begun, until there is a new background
        lost = light.lost or noisy or light.changed > CHANGED or is_relearning
        candidates = [] if lost else self._blobs(newest)
        blobs = self._without_ghosts(candidates, light.gain, background)
        contrast = float(np.median([blob.strength for blob in blobs])) if blobs else None
        self.light = replace(
            light, contrast=contrast, lost=lost, shift_px=(0.0, 0.0) if usual is None else shift
        )
        self._lost.in_turn = self._lost.in_turn + 1 if lost else 0
        return blobs

    def _compare(self, background: Background, newest: SearchArrays) -> Light:
        """Compare the newest image with the background.

        The difference, its limits, its averages and the mask are stored in `newest`.

        Returns:
            The brightness and noise of the image.
        """
        levels = _sparse(newest.smooth)
        background_levels = np.maximum(_sparse(background.grey), 1)
        gain = float(np.median(levels / background_levels))
        gain = gain if GAIN_LEAST < gain < GAIN_MOST else 1.0
        cv2.convertScaleAbs(background.grey, newest.difference, gain)
        cv2.absdiff(newest.smooth, newest.difference, newest.difference)
        # medians, and averages of what is near them: cells and debris do not count
        off = np.abs(levels - gain * background_levels)
        noise = min(NORMAL_MAD * float(np.median(off)), NOISE_MAX)
        size = _square(self.least_px2).shape
        border = cv2.BORDER_CONSTANT
        cv2.boxFilter(newest.difference, cv2.CV_32F, size, newest.mean, borderType=border)
        sample = _sparse(newest.mean)
        highest_usual = np.median(sample) + max(USUAL_SPAN, noise)
        is_usual = sample <= highest_usual
        usual = sample[is_usual].astype(float)
        level = min(float(usual.mean()), NOISE_MAX)
        spread = max(float(usual.std()), LEAST)
        low = level + LOW * spread
        high = level + HIGH * spread
        newest.limits = SearchLimits(low, high, self.least_px2, self.most_px2)
        np.greater(newest.mean, low, out=newest.mask)
        # a saturated or noisy picture differs little from one expected to be as bright or noisy
        is_newly_white = np.median(levels) == 255 and np.median(background_levels) < 255
        lost = noise == NOISE_MAX or bool(is_newly_white)
        changed = cv2.countNonZero(newest.mask) / newest.mask.size
        return Light(gain, noise, None, changed, lost, limit=high)

    def _blobs(self, newest: SearchArrays) -> list[Blob]:
        """Return the blobs of the newest image, at most BLOBS, those of the largest regions first.

        Regions whose bounding box is smaller than `least_px2` are left out.
        """
        large = [region for region in self.regions() if _box_px2(region) >= self.least_px2]
        large.sort(key=_box_px2, reverse=True)
        blobs: list[Blob] = []
        for region in large[:BLOBS]:
            blobs += _bodies(region, newest.difference, newest.mean, newest.limits)
        return blobs[:BLOBS]

    def regions(self) -> Sequence[np.ndarray]:
        """Return the contours of all regions of the newest image that show no background.

        They are in no useful order, and holes in a region are ignored.
        """
        return cv2.findContours(self._newest.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]

    def _without_ghosts(
        self, candidates: Sequence[Blob], gain: float, background: Background
    ) -> list[Blob]:
        """Return the blobs that show bodies, and correct the background at the others.

        A blob shows no body if the image there is as it was when the background was learned, or if
        a body is only in the background. Blobs are corrected one after another, because they may
        share a rectangle.
        """
        blobs: list[Blob] = []
        for blob in candidates:
            part = blob.part
            now = self._newest.smooth[part].astype(np.float32) / gain
            body = blob.body > 0
            around = cv2.dilate(blob.body, _square(self.least_px2)) > 0
            ring = around & (self._newest.mask[part] == 0)
            fine = background.fine[part]
            off_learned = gain * float(np.abs(now - background.learned[part])[body].mean())
            if off_learned < self._newest.limits.low:
                background.correct(part, around, now)
            elif _is_ghost(now, fine, body, ring):
                background.correct(part, around, now)
                background.learned[part][around] = now[around]
            else:
                blobs.append(blob)
        return blobs

    def follow(self, keep: Sequence[tuple[int, int, int, int]]) -> None:
        """Update the next stripe of the background with the newest image, except around cells.

        If the background no longer applies, it is learned again.

        Args:
            keep: Rectangles around the cells: left, top, right and bottom [px].
        """
        assert self._background is not None, "learn() comes first"
        newest = self._newest
        rows_of_stripe = newest.next_stripe()
        top = rows_of_stripe.start
        if top == rows_of_stripe.stop:  # a picture with fewer rows than stripes
            return
        calm = 1 - newest.mask[rows_of_stripe]
        for left, upper, right, lower in keep:
            rows = slice(max(0, upper - top), max(0, lower - top))
            calm[rows, max(0, left) : max(0, right)] = 0
        scaled = newest.smooth[rows_of_stripe].astype(np.float32) / self.light.gain
        self._background.update(rows_of_stripe, scaled, calm)
        self._relearn_if_lost()

    def _relearn_if_lost(self) -> None:
        """Sample every EVERY-th image after more than LOST lost images in turn.

        Once there are AGAIN samples, learn the background from them.
        """
        newest = self._newest
        if self._lost.in_turn > LOST and newest.stripe % EVERY == 0:
            self._lost.sample.append(newest.smooth.copy())
            if len(self._lost.sample) == AGAIN:
                self.learn(self._lost.sample)


def _is_ghost(
    now: NDArray[np.float32], background: NDArray[np.float32], body: Bools, ring: Bools
) -> bool:
    """Check whether a body is only in the background.

    A ghost looks like the unchanged ring around it now, but differs from the ring in the
    background: there, the difference is at least GHOST times as large.
    """
    level = background[ring].mean() if ring.any() else np.median(background)
    off_now = float(np.abs(now - level)[body].mean())
    off_background = float(np.abs(background - level)[body].mean())
    return off_background >= GHOST * max(off_now, 1.0)


class Box(NamedTuple):
    """A rectangle of pixels: its left column, top row, width and height."""

    left: int
    top: int
    wide: int
    tall: int

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle in an image."""
        return slice(self.top, self.top + self.tall), slice(self.left, self.left + self.wide)


def _box_px2(contour: np.ndarray) -> int:
    """Compute the area of a contour's bounding box [px^2]."""
    _, _, wide, tall = cv2.boundingRect(contour)
    return wide * tall


def _bodies(
    region: np.ndarray, difference: Grey, mean: NDArray[np.float32], limits: SearchLimits
) -> Iterator[Blob]:
    """Find the bodies in a region, in the order of decreasing difference from the background.

    Args:
        region: Contour of the region.
        difference: Absolute difference between the image and the background.
        mean: The difference averaged over squares.
        limits: The limits of the search.
    """
    box = Box(*cv2.boundingRect(region))
    inside = np.zeros((box.tall, box.wide), np.uint8)
    cv2.drawContours(inside, [region], -1, 1, -1, offset=(-box.left, -box.top))
    if cv2.countNonZero(inside) < limits.least_px2:
        return
    rest = mean[box.part] * inside
    height_px, width_px = mean.shape
    is_at_side = box.left == 0 or box.left + box.wide == width_px
    at_edge = is_at_side or box.top == 0 or box.top + box.tall == height_px
    least_peak = limits.high
    for _ in range(BODIES):
        _, peak, _, peak_at = cv2.minMaxLoc(rest)
        if peak <= least_peak:
            return
        least_peak = max(least_peak, NEXT * peak)
        height = peak - limits.level
        mask = _grey(rest > max(limits.low, limits.level + EDGE * height))
        cv2.floodFill(mask, None, peak_at, 2)
        body = _grey(mask == 2)
        near = cv2.dilate(body, _square(limits.least_px2)) > 0
        rest[near] = 0
        body_px2 = cv2.countNonZero(body)
        if limits.least_px2 / 2 <= body_px2 <= limits.most_px2:  # a neighbour cuts a part off
            rise = (difference[box.part] - limits.level) / height
            weights = (np.clip(rise, *RAMP) - RAMP[0]) * near
            yield _blob(body, weights, difference[box.part], box, at_edge)


def _blob(
    body: Grey, weights: NDArray[np.floating], difference: Grey, box: Box, at_edge: bool
) -> Blob:
    """Compute the ellipse with the same weighted moments as a body.

    The weights rise from 0 with the difference, up to a maximum, so that neither single pixels at
    the body's edge nor structures inside it change the moments much. An ellipse has the second
    moments length^2 / 16 and width^2 / 16 along its axes. Each pixel adds 1 / 12.
    """
    moments = cv2.moments(weights)
    if moments["m00"] == 0:
        moments = cv2.moments(body, binaryImage=True)
    mass = moments["m00"]
    xx = moments["mu20"] / mass + 1 / 12
    yy = moments["mu02"] / mass + 1 / 12
    xy = moments["mu11"] / mass
    middle = (xx + yy) / 2
    spread = math.hypot((xx - yy) / 2, xy)
    return Blob(
        x=box.left + moments["m10"] / mass,
        y=box.top + moments["m01"] / mass,
        axis=0.5 * math.atan2(2 * xy, xx - yy),
        long=4 * math.sqrt(middle + spread),
        wide=4 * math.sqrt(max(middle - spread, 1e-3)),
        strength=cv2.mean(difference, body)[0],
        body=body,
        corner=(box.left, box.top),
        at_edge=at_edge,
    )


def _square(least_px2: float) -> Grey:
    """Return the square over which differences are averaged.

    Its side is an odd number of pixels.
    """
    return np.ones((2 * int(BOX * math.sqrt(least_px2) / 2) + 1,) * 2, np.uint8)


def _blurred(picture: np.ndarray, between: np.ndarray, into: np.ndarray) -> None:
    """Blur an image with two box filters, which is four times as fast as a Gaussian filter.

    The result is close to a Gaussian blur with a standard deviation of 1.15 px.

    Args:
        picture: The image.
        between: A buffer.
        into: Filled with the result.
    """
    cv2.blur(picture, (3, 3), between)
    cv2.blur(between, (3, 3), into)


def _sparse(picture: np.ndarray) -> np.ndarray:
    """Return every n-th pixel of an image, for statistics."""
    step = max(8, picture.shape[0] // SPARSE)
    return picture[::step, ::step]


def _median(pictures: Sequence[Grey], gains: Floats) -> NDArray[np.float32]:
    """Compute the median of images, each multiplied by its gain. It uses little memory."""
    median = np.empty(pictures[0].shape, np.float32)
    tall = max(1, min(SPARSE, ROWS_PX // median[0].size))
    for top in range(0, len(median), tall):
        part = slice(top, top + tall)
        rows = [
            g * picture[part].astype(np.float32) for picture, g in zip(pictures, gains, strict=True)
        ]
        np.median(rows, axis=0, out=median[part], overwrite_input=True)
    return median


def _grey(picture: np.ndarray) -> Grey:
    """Convert an image to 8-bit grey levels.

    Fractions are cut off, and the range is not checked.
    """
    return np.asarray(picture, np.uint8)
