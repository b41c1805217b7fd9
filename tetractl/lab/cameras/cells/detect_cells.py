"""Finds blobs in a grey picture: regions that differ from a slowly updated background.

Steps: blur; subtract the background, scaled to the picture's light; threshold with hysteresis; find
contours; compute the moments inside each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats, Grey

STRIPES = 16  # number of stripes of the background; each picture updates one
LEARNING = 0.1  # weight of the picture in an update: a time constant of 5 s at 30 Hz
SPARSE = 64  # number of rows sampled for light and noise, fewer in a small picture
LOW, HIGH = 5.0, 9.0  # thresholds in standard deviations of the noise
LEAST_LOW, LEAST_HIGH = 3.0, 8.0  # grey levels, for pictures without noise
BLOBS = 200  # largest number of blobs of a picture; smaller ones are dropped
CONTOURS = 4000  # a picture with more contours does not show a dish
CHANGED = 0.25  # fraction of changed pixels above which the background no longer applies
PART_LOW = 0.35  # threshold of a cell's body, as a fraction of the blob's greatest difference


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

    @property
    def area(self) -> float:
        """Area of the blob's ellipse [px^2]."""
        return math.pi / 4 * self.long * self.wide


@dataclass(frozen=True, slots=True)
class Light:
    """Properties of a picture: `gain` is its light relative to the background's, `noise` the
    standard deviation of its noise [grey levels].

    `contrast` [grey levels] is the median strength of the blobs, None without blobs. `changed` is
    the fraction of pixels that differ from the background; `lost` is True if cells cannot explain
    that fraction.
    """

    gain: float
    noise: float
    contrast: float | None
    changed: float
    lost: bool


@dataclass(slots=True)
class BlobFinder:
    """Finds blobs of `least_px2` to `most_px2` pixels; `bright` says whether cells are brighter
    than the background, None to determine it.

    `learn` computes the background from pictures taken over a second or more. `follow` updates it
    by later pictures, except around the cells, so that the background shows no resting cells.
    """

    least_px2: float
    most_px2: float
    bright: bool | None = None
    light: Light = field(default=Light(1.0, 0.0, None, 0.0, False), init=False)
    _background: NDArray[np.float32] | None = field(default=None, init=False)
    _flat: Grey | None = field(default=None, init=False)
    _stripe: int = field(default=0, init=False)
    _smooth: Grey | None = field(default=None, init=False)
    _room: list[Grey] = field(default_factory=list, init=False)  # buffers, reused for speed
    searched: Grey | None = field(default=None, init=False)
    """The newest picture minus its background; blobs are searched for in this difference."""
    limits: tuple[float, ...] = field(default=(), init=False)
    """Limits of the newest search: low and high threshold [grey levels], least and most area
    [px^2].
    """

    @property
    def size(self) -> tuple[int, ...] | None:
        """Height and width of the pictures, None before the background is learned."""
        return None if self._background is None else self._background.shape

    @property
    def background(self) -> Grey | None:
        """The learned picture without cells."""
        return self._flat

    def learn(self, pictures: Sequence[Grey]) -> None:
        """Compute the background as the median of pictures (height, width); unless `bright` is
        given, determine whether cells are brighter or darker than the background.
        """
        smooth = [_smoothed(each, np.empty_like(each), np.empty_like(each)) for each in pictures]
        levels = [max(float(np.median(_sparse(each))), 1.0) for each in smooth]
        middle = float(np.median(levels))
        even = [cv2.convertScaleAbs(s, s, middle / v) for s, v in zip(smooth, levels, strict=True)]
        rows = (np.median([e[row] for e in even], axis=0) for row in _chunks(even[0].shape[0]))
        self._background = np.concatenate([row.astype(np.float32) for row in rows])
        self._flat = flat = _grey(cv2.convertScaleAbs(self._background))
        if self.bright is None:
            up = sum(float(_excess(e, flat).sum()) for e in even)
            down = sum(float(_excess(flat, e).sum()) for e in even)
            self.bright = up > down

    def find(self, picture: Grey) -> list[Blob]:
        """Return the blobs of a picture (height, width), largest first."""
        assert self._flat is not None, "learn() comes first"
        if len(self._room) == 0 or self._room[0].shape != picture.shape:
            self._room = [np.empty(picture.shape, np.uint8) for _ in range(4)]
        smooth, expected, searched, mask = self._room
        _smoothed(picture, mask, smooth)
        self._smooth, self.searched = smooth, searched
        seen, known = _sparse(smooth), np.maximum(_sparse(self._flat), 1)
        gain = float(np.median(seen / known))
        gain = gain if 0.05 < gain < 20 else 1.0
        cv2.convertScaleAbs(self._flat, alpha=gain, dst=expected)
        above, below = (smooth, expected) if self.bright else (expected, smooth)
        cv2.subtract(above, below, dst=searched)
        # differences of the other sign are noise
        other = (seen.astype(np.float32) - gain * known) * (-1 if self.bright else 1)
        noise = float(np.sqrt(np.mean(np.square(other[other >= 0])))) if (other >= 0).any() else 0.0
        noise = min(noise, 20.0)
        low, high = max(LOW * noise, LEAST_LOW), max(HIGH * noise, LEAST_HIGH)
        self.limits = (low, high, self.least_px2, self.most_px2)
        cv2.threshold(searched, low, 255, cv2.THRESH_BINARY, dst=mask)
        changed = cv2.countNonZero(mask) / mask.size
        contours: Sequence = ()
        if changed <= CHANGED:
            contours = _contours(mask)
        lost = changed > CHANGED or len(contours) > CONTOURS
        blobs = [] if lost else _blobs(contours, searched, self.limits)
        contrast = float(np.median([each.strength for each in blobs])) if blobs else None
        self.light = Light(gain, noise, contrast, changed, lost)
        return blobs

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
        old = self._background[top:bottom]
        new = self._smooth[top:bottom]
        mask = np.full(new.shape, 255, np.uint8)
        for left, upper, right, lower in keep:
            mask[max(0, upper - top) : max(0, lower - top), max(0, left) : max(0, right)] = 0
        scaled = new.astype(np.float32) / max(self.light.gain, 0.05)
        cv2.accumulateWeighted(scaled, old, LEARNING, mask)
        self._flat[top:bottom] = cv2.convertScaleAbs(old)


def blobs_of(
    searched: Grey, limits: Sequence[float], corner: tuple[int, int] = (0, 0)
) -> list[Blob]:
    """Return the blobs of a background-subtracted picture, or of a part of it, largest first.

    `limits` are low and high threshold [grey levels], least and most area [px^2]; `corner` is
    column and row of the part's upper left pixel.
    """
    mask = _grey(cv2.threshold(searched, limits[0], 255, cv2.THRESH_BINARY)[1])
    return _blobs(_contours(mask), searched, limits, corner)


def _contours(mask: Grey) -> Sequence:
    return cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]


def _blobs(
    contours: Sequence, difference: Grey, limits: Sequence[float], corner: tuple[int, int] = (0, 0)
) -> list[Blob]:
    boxes = [cv2.boundingRect(contour) for contour in contours]
    floor = 0.3 * limits[2]
    large = [(b, c) for b, c in zip(boxes, contours, strict=True) if b[2] * b[3] >= floor]
    large.sort(key=lambda each: -each[0][2] * each[0][3])
    found = (_blob(box, c, difference, limits, corner) for box, c in large[:BLOBS])
    return [blob for blob in found if blob is not None]


def _blob(
    box: Sequence[int],
    contour: Grey,
    difference: Grey,
    limits: Sequence[float],
    corner: tuple[int, int],
) -> Blob | None:
    left, top, wide, tall = box
    _, high, least, most = limits
    inside = np.zeros((tall, wide), np.uint8)
    cv2.drawContours(inside, [contour], -1, 1, -1, offset=(-left, -top))
    part = difference[top : top + tall, left : left + wide] * inside
    peak = float(part.max())
    if peak < high:
        return None
    kept = cv2.threshold(part, PART_LOW * peak, 1, cv2.THRESH_BINARY)[1]
    moments = cv2.moments(kept, binaryImage=True)
    mass = moments["m00"]
    if not least <= mass <= most:
        return None
    x, y = moments["m10"] / mass, moments["m01"] / mass
    xx, yy = moments["mu20"] / mass + 1 / 12, moments["mu02"] / mass + 1 / 12
    xy = moments["mu11"] / mass
    spread = math.hypot((xx - yy) / 2, xy)
    mean = (xx + yy) / 2
    height, width = difference.shape
    return Blob(
        x=left + corner[0] + x,
        y=top + corner[1] + y,
        axis=0.5 * math.atan2(2 * xy, xx - yy),
        long=4 * math.sqrt(mean + spread),
        wide=4 * math.sqrt(max(mean - spread, 1e-3)),
        strength=cv2.mean(part, kept)[0],
        body=_grey(kept),
        corner=(left + corner[0], top + corner[1]),
        at_edge=left == 0 or top == 0 or left + wide == width or top + tall == height,
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


def _chunks(height: int, rows: int = 64) -> list[slice]:
    """Return slices of at most `rows` rows each, so that medians of pictures need little memory."""
    return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]


def _excess(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return above - below where it exceeds 15 grey levels, 0 elsewhere."""
    return cv2.threshold(cv2.subtract(above, below), 15, 0, cv2.THRESH_TOZERO)[1]


def _grey(picture: np.ndarray) -> Grey:
    return np.asarray(picture, np.uint8)
