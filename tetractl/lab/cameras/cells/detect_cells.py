"""Finds blobs in a grey picture: regions that differ from a slowly updated background.

Steps: blur; subtract the background, scaled to the picture's light; average the difference, of
either sign, over a square as small as the smallest cell, so that a body and its halo are one; take
what exceeds the noise of these averages; compute the moments of each body.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats, Grey
from tetractl.lab.cameras.cells.knocks import moved, shift_of

STRIPES = 16  # number of stripes of the background; each picture updates one
LEARNING = 0.1  # weight of the picture in an update: a time constant of 5 s at 30 Hz
RELEARNING = 0.5  # the weight where the picture keeps differing from the background
SPARSE = 64  # number of rows sampled for light and noise, fewer in a small picture
LOW, HIGH = 4.5, 6.0  # thresholds of averaged differences, in standard deviations of their noise
LEAST_LOW, LEAST_HIGH = 1.0, 2.0  # the same at least, above the mean [grey levels]
NOISY = 4.0  # growth of the noise at which the background no longer applies
NOISE_MAX = 20.0  # most noise of a picture that shows a dish [grey levels]
BLOBS = 200  # largest number of blobs of a picture; smaller ones are dropped
REGIONS = 4000  # a picture with more regions does not show a dish
CHANGED = 0.25  # fraction of changed pixels above which the background no longer applies
EDGE = 0.4  # averaged difference at a body's edge, as a fraction of the greatest in the body
GHOST = 2.0  # least ratio of grey levels' deviations where a body is only in the background
RAMP = 0.2, 0.6  # differences with the weights 0 and 1, relative to the body's greatest mean
BODIES, NEXT = 4, 0.5  # bodies in a region; least peak of each, relative to the first's
KNOCK = 1.3, 0.002  # factor and fraction by which a knock makes more of the picture change
LOST, EVERY, AGAIN = 5, 3, 9  # pictures lost until learning begins again, of every third, from 9


@dataclass(frozen=True, slots=True)
class Blob:
    """A region of a picture that differs from the background; x, y [px] is its middle, `axis` [rad]
    its direction mod pi.

    `long` and `wide` [px] are the axes of the ellipse with the same moments, `strength` is the mean
    difference [grey levels]. `body` is a mask of the blob, in a rectangle whose upper left pixel is
    at `corner`. `at_edge`: the picture's edge cuts the blob.
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
    def pixels(self) -> Floats:
        """Columns and rows of the blob's pixels (M, 2)."""
        rows, columns = np.nonzero(self.body)
        return np.column_stack([columns + self.corner[0], rows + self.corner[1]]).astype(float)


@dataclass(frozen=True, slots=True)
class Light:
    """Properties of a picture: `gain` is its light relative to the background's, `noise` the
    standard deviation of its noise [grey levels].

    `contrast` [grey levels] is the median strength of the blobs, None without blobs. `changed` is
    the fraction of pixels that differ from the background; `lost` is True if cells cannot explain
    that fraction. `shift_px` is by how much the stage was moved since the picture before: columns
    to the right, rows down. `limit` [grey levels] is the least contrast of a cell that is found.
    """

    gain: float
    noise: float
    contrast: float | None
    changed: float
    lost: bool
    shift_px: tuple[float, float] = (0.0, 0.0)
    limit: float = 0.0


@dataclass(slots=True)
class BlobFinder:
    """Finds blobs of `least_px2` to `most_px2` pixels; `bright` says whether cells are brighter
    than the background. If it is None, cells of either sign are found, and `learn` determines what
    most are.

    `learn` computes the background from pictures taken over a second or more. `follow` updates it
    by later pictures, except around the cells, so that the background shows no resting cells. After
    a knock the background is moved by the picture's shift; where a cell rested while the background
    was learned, it is mended once the cell has left; it is learned again if it does not apply.
    """

    least_px2: float
    most_px2: float
    bright: bool | None = None
    light: Light = field(default=Light(1.0, 0.0, None, 0.0, False), init=False)
    searched: Grey | None = field(default=None, init=False)
    """The newest picture minus its background; blobs are searched for in this difference."""
    limits: tuple[float, ...] = field(default=(), init=False)
    """Limits of the newest search: low and high threshold [grey levels], least and most area
    [px^2].
    """
    _signed: bool = field(init=False)  # whether only cells of one sign are searched for
    _background: NDArray[np.float32] | None = field(default=None, init=False)
    _flat: Grey | None = field(default=None, init=False)
    _stripe: int = field(default=0, init=False)
    _smooth: Grey | None = field(default=None, init=False)
    _room: list[Grey] = field(default_factory=list, init=False)  # buffers, reused for speed
    _usual: float | None = field(default=None, init=False)  # usual fraction of changed pixels
    _was: Grey = field(init=False)  # pixels that differed when their stripe was updated last
    _noise: float = field(default=0.0, init=False)  # of the first picture after learning
    _lost: int = field(default=0, init=False)  # successive pictures that were lost
    _again: list[Grey] = field(default_factory=list, init=False)  # of them, for a new background

    def __post_init__(self) -> None:
        self._signed = self.bright is not None

    @property
    def size(self) -> tuple[int, ...] | None:
        """Height and width of the pictures, None before the background is learned."""
        return None if self._background is None else self._background.shape

    @property
    def background(self) -> Grey | None:
        """The learned picture without cells."""
        return self._flat

    def learn(self, pictures: Sequence[Grey]) -> None:
        """Compute the background as the median of pictures (height, width), each shifted and scaled
        to fit the middle one; unless `bright` is given, determine whether most cells are brighter
        or darker than the background.
        """
        smooth = [_smoothed(each, np.empty_like(each), np.empty_like(each)) for each in pictures]
        levels = [max(float(np.median(_sparse(each))), 1.0) for each in smooth]
        middle = float(np.median(levels))
        even = [cv2.convertScaleAbs(s, s, middle / v) for s, v in zip(smooth, levels, strict=True)]
        half = len(even) // 2
        usual = _grey(_median(even[max(0, half - 2) : half + 3]))
        even = [moved(each, shift_of(each, usual)) for each in even]
        self._background = _median(even)
        self._flat = flat = _grey(cv2.convertScaleAbs(self._background))
        self._usual, self._lost, self._again = None, 0, []
        self._was = np.zeros_like(flat)
        if not self._signed:
            up = sum(float(_excess(e, flat).sum()) for e in even)
            down = sum(float(_excess(flat, e).sum()) for e in even)
            self.bright = up > down

    def find(self, picture: Grey) -> list[Blob]:
        """Return the blobs of a picture (height, width), largest first."""
        assert self._flat is not None, "learn() comes first"
        if len(self._room) == 0 or self._room[0].shape != picture.shape:
            self._room = [np.empty(picture.shape, np.uint8) for _ in range(5)]
        self._smooth, self.searched = self._room[:2]
        _smoothed(picture, self._room[2], self._smooth)
        light, shift = self._compare(), (0.0, 0.0)
        first, usual = self._usual is None, self._usual or 0.0
        if first or light.changed > KNOCK[0] * usual + KNOCK[1]:
            shift = shift_of(self._room[2], self._smooth)
            if shift != (0.0, 0.0):
                assert self._background is not None
                self._background = moved(self._background, shift)
                cv2.convertScaleAbs(self._background, self._flat)
                light = self._compare()
            usual = light.changed
        self._usual = usual + 0.05 * (light.changed - usual)
        self._noise = light.noise if first else self._noise
        noisy = light.noise > NOISY * max(self._noise, 1.0)
        lost = light.lost or noisy or light.changed > CHANGED or bool(self._again)
        found = None if lost else _blobs(self.searched, self._room[4], self.limits)
        lost, blobs = found is None, found or []
        if not self._signed:
            blobs = [blob for blob in blobs if not self._mended(blob, light.gain)]
        contrast = float(np.median([each.strength for each in blobs])) if blobs else None
        self.light = replace(
            light, contrast=contrast, lost=lost, shift_px=(0.0, 0.0) if first else shift
        )
        self._lost = self._lost + 1 if lost else 0
        return blobs

    def _compare(self) -> Light:
        """Compute the difference of the newest picture from the background, its limits, the mean
        differences and the mask of those above the lower limit.
        """
        assert self._flat is not None and self._smooth is not None and self.searched is not None
        expected, mask, mean = self._room[2:]
        seen, known = _sparse(self._smooth), np.maximum(_sparse(self._flat), 1)
        gain = float(np.median(seen / known))
        gain = gain if 0.05 < gain < 20 else 1.0
        cv2.convertScaleAbs(self._flat, alpha=gain, dst=expected)
        if not self._signed:
            cv2.absdiff(self._smooth, expected, dst=self.searched)
        else:
            pair = (self._smooth, expected) if self.bright else (expected, self._smooth)
            cv2.subtract(*pair, dst=self.searched)
        # medians, and averages of what is near them: cells and debris do not count
        noise = min(1.48 * float(np.median(np.abs(seen - gain * known))), NOISE_MAX)
        _averaged(self.searched, self.least_px2, mean)
        sample = _sparse(mean).astype(float)
        usual = sample[sample <= np.median(sample) + max(2.0, noise)]
        level, spread = min(float(usual.mean()), NOISE_MAX), float(usual.std())
        low = level + max(LOW * spread, LEAST_LOW)
        high = level + max(HIGH * spread, LEAST_HIGH)
        self.limits = (low, high, self.least_px2, self.most_px2)
        cv2.threshold(mean, low, 255, cv2.THRESH_BINARY, dst=mask)
        # a saturated or noisy picture differs little from one expected to be as bright or noisy
        lost = noise == NOISE_MAX or float(np.median(seen)) == 255 > float(np.median(known))
        return Light(gain, noise, None, cv2.countNonZero(mask) / mask.size, lost, limit=high)

    def _mended(self, blob: Blob, gain: float) -> bool:
        """Return whether a blob is not in the picture but only in the background, which is then
        corrected.
        """
        assert self._flat is not None and self._smooth is not None and self._background is not None
        (left, top), (tall, wide) = blob.corner, blob.body.shape
        here = slice(top, top + tall), slice(left, left + wide)
        seen, known = (
            cv2.meanStdDev(each[here])[1].item() for each in (self._smooth, self._room[2])
        )
        if known < GHOST * max(seen, 1.0):
            return False
        wrong = cv2.dilate(blob.body, _square(self.least_px2)) > 0
        self._background[here][wrong] = self._smooth[here][wrong] / gain
        self._flat[here][wrong] = np.clip(self._background[here][wrong], 0, 255)
        return True

    def follow(self, keep: Sequence[tuple[int, int, int, int]]) -> None:
        """Update the next stripe of the background by the last picture, except in the rectangles
        `keep`, each given by left, top, right and bottom [px].
        """
        assert self._background is not None and self._flat is not None, "learn() comes first"
        assert self._smooth is not None, "find() comes first"
        height = self._background.shape[0]
        top = self._stripe * height // STRIPES
        bottom = (self._stripe + 1) * height // STRIPES
        self._stripe = (self._stripe + 1) % STRIPES
        if top == bottom:  # a picture with fewer rows than stripes
            return
        here = slice(top, bottom)
        old, mask, was = self._background[here], self._room[3][here], self._was[here]
        still, calm = mask & was, ~mask
        was[:] = mask
        for left, upper, right, lower in keep:
            rows = slice(max(0, upper - top), max(0, lower - top))
            for each in (still, calm):
                each[rows, max(0, left) : max(0, right)] = 0
        scaled = self._smooth[here].astype(np.float32) / max(self.light.gain, 0.05)
        cv2.accumulateWeighted(scaled, old, LEARNING, calm)
        cv2.accumulateWeighted(scaled, old, RELEARNING, still)
        self._flat[here] = cv2.convertScaleAbs(old)
        if self._lost > LOST and self._stripe % EVERY == 0:
            self._again.append(self._smooth.copy())
            if len(self._again) == AGAIN:
                self.learn(self._again)


def blobs_of(
    searched: Grey, limits: Sequence[float], corner: tuple[int, int] = (0, 0)
) -> list[Blob]:
    """Return the blobs of a background-subtracted picture, or of a part of it, largest first.

    `limits` are low and high threshold [grey levels], least and most area [px^2]; `corner` is
    column and row of the part's upper left pixel.
    """
    mean = _averaged(searched, limits[2], np.empty_like(searched))
    return _blobs(searched, mean, limits, corner) or []


def box_px(least_px2: float) -> int:
    """Return the side of the square over which differences are averaged [px]: odd, and about that
    of the smallest cell.
    """
    return 2 * int(math.sqrt(least_px2) / 2) + 1


def _square(least_px2: float) -> Grey:
    return np.ones((box_px(least_px2),) * 2, np.uint8)


def _averaged(difference: Grey, least_px2: float, into: Grey) -> Grey:
    side = box_px(least_px2)
    cv2.blur(difference, (side, side), dst=into, borderType=cv2.BORDER_CONSTANT)
    return into


def _blobs(
    difference: Grey, mean: Grey, limits: Sequence[float], corner: tuple[int, int] = (0, 0)
) -> list[Blob] | None:
    """Return the blobs of a difference averaged to `mean`, largest first; None if there are too
    many.
    """
    mask = _grey(cv2.threshold(mean, limits[0], 255, cv2.THRESH_BINARY)[1])
    regions = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    if len(regions) > REGIONS:
        return None
    boxes = [cv2.boundingRect(region) for region in regions]
    large = [(b, r) for b, r in zip(boxes, regions, strict=True) if b[2] * b[3] >= limits[2]]
    large.sort(key=lambda each: -each[0][2] * each[0][3])
    found: list[Blob] = []
    for box, region in large[:BLOBS]:
        found += _bodies(box, region, difference, mean, limits, corner)
    return found[:BLOBS]


def _bodies(
    box: Sequence[int],
    region: np.ndarray,
    difference: Grey,
    mean: Grey,
    limits: Sequence[float],
    corner: tuple[int, int],
) -> Iterator[Blob]:
    """Yield the bodies in a region, given by its contour and the box around it; that with the
    greatest difference comes first.
    """
    left, top, wide, tall = box
    low, high, least, most = limits
    rim = _square(least)
    here, (height, width) = (slice(top, top + tall), slice(left, left + wide)), mean.shape
    inside = np.zeros((tall, wide), np.uint8)
    cv2.drawContours(inside, [region], -1, 255, -1, offset=(-left, -top))
    rest = cv2.bitwise_and(mean[here], inside, dst=inside)
    at_edge = left == 0 or top == 0 or left + wide == width or top + tall == height
    for _ in range(BODIES):
        _, peak, _, at = cv2.minMaxLoc(rest)
        if peak <= high:
            return
        high = max(high, NEXT * peak)
        mask = cv2.threshold(rest, max(low, EDGE * peak), 1, cv2.THRESH_BINARY)[1]
        cv2.floodFill(mask, None, at, 2)
        body = _grey(cv2.threshold(mask, 1, 1, cv2.THRESH_BINARY)[1])
        rest[cv2.dilate(body, rim) > 0] = 0
        if least <= cv2.countNonZero(body) <= most:
            at = left + corner[0], top + corner[1]
            yield _blob(body, difference[here], peak, rim, at, at_edge)


def _blob(
    body: Grey, difference: Grey, peak: float, rim: Grey, corner: tuple[int, int], at_edge: bool
) -> Blob:
    """Return the blob of a body; the weights of its moments rise from 0 to 1 with the difference,
    so that neither a pixel at its edge nor what is inside moves them much.
    """
    weights = np.clip(difference.astype(np.float32) / peak, *RAMP) - RAMP[0]
    moments = cv2.moments(weights * cv2.dilate(body, rim))
    if moments["m00"] == 0:
        moments = cv2.moments(body, binaryImage=True)
    mass = moments["m00"]
    x, y = moments["m10"] / mass, moments["m01"] / mass
    xx, yy = moments["mu20"] / mass + 1 / 12, moments["mu02"] / mass + 1 / 12
    xy = moments["mu11"] / mass
    spread = math.hypot((xx - yy) / 2, xy)
    mean = (xx + yy) / 2
    return Blob(
        x=corner[0] + x,
        y=corner[1] + y,
        axis=0.5 * math.atan2(2 * xy, xx - yy),
        long=4 * math.sqrt(mean + spread),
        wide=4 * math.sqrt(max(mean - spread, 1e-3)),
        strength=cv2.mean(difference, body)[0],
        body=body,
        corner=corner,
        at_edge=at_edge,
    )


def _smoothed(picture: Grey, between: Grey, into: Grey) -> Grey:
    """Blur a picture by two box filters, which take a quarter of the time of a Gaussian filter.

    The result, written to `into`, is nearly that of a Gaussian with a standard deviation of 1.15
    px; `between` is a buffer.
    """
    cv2.blur(picture, (3, 3), dst=between)
    cv2.blur(between, (3, 3), dst=into)
    return into


def _sparse(picture: np.ndarray) -> np.ndarray:
    step = max(8, picture.shape[0] // SPARSE)
    return picture[::step, ::step]


def _median(pictures: Sequence[np.ndarray], rows: int = 64) -> NDArray[np.float32]:
    """Return the median of pictures; it is computed for some rows at a time to save memory."""
    height = len(pictures[0])
    parts = ([each[top : top + rows] for each in pictures] for top in range(0, height, rows))
    return np.concatenate([np.median(part, axis=0).astype(np.float32) for part in parts])


def _excess(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return above - below where it exceeds 15 grey levels, 0 elsewhere."""
    return cv2.threshold(cv2.subtract(above, below), 15, 0, cv2.THRESH_TOZERO)[1]


def _grey(picture: np.ndarray) -> Grey:
    return np.asarray(picture, np.uint8)
