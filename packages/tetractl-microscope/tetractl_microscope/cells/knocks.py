"""Finds the shift of a microscope's image after a knock, which moves everything in it."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE = 512  # largest side of the pictures whose shift is computed [px]
LEAST = 0.5  # least shift that counts, in pixels of these pictures
MOST = 0.3  # largest, in sides of the picture
PLAIN = 31  # side of the square whose mean is subtracted [px]
STANDS_OUT = 6.0  # least difference from it, in medians of the differences
LEFT = 0.85  # fraction of changed pixels that may be left if pictures are shifted


def shift_of(before: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """Find by how many columns and rows the content of a grey image was shifted.

    The result is (0, 0) unless a shift explains a part of the difference between the two images.
    """
    scale = min(1.0, SIDE / max(now.shape))
    if round(scale * min(now.shape)) < PLAIN:
        return 0.0, 0.0
    even_before, even_now = (_even(picture, scale) for picture in (before, now))
    window = cv2.createHanningWindow(even_before.shape[::-1], cv2.CV_32F)
    (x, y), _ = cv2.phaseCorrelate(_features(even_before), _features(even_now), window)
    far = max(abs(x), abs(y))
    if math.hypot(x, y) < LEAST or not far < MOST * min(even_before.shape):
        return 0.0, 0.0
    apart = cv2.absdiff(even_before, even_now)
    remaining = cv2.absdiff(moved(even_before, (x, y)), even_now)
    changed = max(STANDS_OUT * float(np.median(apart)), 8.0)
    shared = _both(y, even_before.shape[0]), _both(x, even_before.shape[1])
    counts = [np.count_nonzero(difference[shared] > changed) for difference in (apart, remaining)]
    return (x / scale, y / scale) if counts[1] < LEFT * counts[0] else (0.0, 0.0)


def _both(shift: float, size: int) -> slice:
    """Return the pixels along one axis that an image shows both before and after a shift [px].

    They are counted in the image after the shift.
    """
    begin = max(0, math.ceil(shift))
    end = size + min(0, math.floor(shift))
    return slice(begin, end)


def moved(picture: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Return an image with its content shifted by columns and rows.

    New pixels at an edge are like their neighbours.
    """
    if shift == (0.0, 0.0):
        return picture
    by = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(picture, by, size, borderMode=cv2.BORDER_REPLICATE)


def _even(picture: np.ndarray, scale: float) -> NDArray[np.float32]:
    """Scale an image, and remove what changes slowly across it, such as uneven light."""
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    even = np.asarray(small, np.float32)
    return even - cv2.blur(even, (PLAIN, PLAIN))


def _features(even: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the features that stand out of an even image, reduced by the threshold.

    Everything that stands out less, such as noise and fixed patterns, becomes 0.
    """
    least = STANDS_OUT * float(np.median(np.abs(even[::4, ::4])))
    return even - np.clip(even, -least, least)
