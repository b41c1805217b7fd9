"""Finds the shift of a microscope's image after a knock, which moves everything in it."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE_MAX_PX = 512
"""Maximum side of the reduced images whose shift is computed [px]."""
SHIFT_MIN_PX = 0.5
"""Minimum shift that counts [px of the reduced images]."""
SHIFT_MAX_FRACTION = 0.3
"""Maximum shift that counts, as a fraction of the shorter side of the image."""
MEAN_SQUARE_PX = 31
"""Side of the square whose mean is subtracted from each pixel [px of the reduced images]."""
FEATURE_MEDIANS = 6.0
"""Minimum deviation from the local mean that counts as a feature, in medians of deviations."""
LEFT_FRACTION_MAX = 0.85
"""Maximum fraction of the changed pixels that a shift may leave unexplained."""


def find_shift(previous: np.ndarray, newest: np.ndarray) -> tuple[float, float]:
    """Find by how many columns and rows the content of a grey image was shifted.

    Args:
        previous: The image before.
        newest: The image after the shift, of the same shape.

    Returns:
        The shift [px]: columns to the right, rows down. It is (0, 0) unless a shift explains a part
        of the difference between the two images.
    """
    scale = min(1.0, SIDE_MAX_PX / max(newest.shape))
    if round(scale * min(newest.shape)) < MEAN_SQUARE_PX:
        return 0.0, 0.0
    flat_previous, flat_newest = (_flatten(picture, scale) for picture in (previous, newest))
    window = cv2.createHanningWindow(flat_previous.shape[::-1], cv2.CV_32F)
    (x, y), _ = cv2.phaseCorrelate(
        _extract_features(flat_previous), _extract_features(flat_newest), window
    )
    largest_component = max(abs(x), abs(y))
    if math.hypot(x, y) < SHIFT_MIN_PX or not largest_component < SHIFT_MAX_FRACTION * min(
        flat_previous.shape
    ):
        return 0.0, 0.0
    differences_before = cv2.absdiff(flat_previous, flat_newest)
    differences_after = cv2.absdiff(shift_picture(flat_previous, (x, y)), flat_newest)
    change_min = max(FEATURE_MEDIANS * float(np.median(differences_before)), 8.0)
    common_part = (
        _find_common_pixels(y, flat_previous.shape[0]),
        _find_common_pixels(x, flat_previous.shape[1]),
    )
    counts = [
        np.count_nonzero(difference[common_part] > change_min)
        for difference in (differences_before, differences_after)
    ]
    return (x / scale, y / scale) if counts[1] < LEFT_FRACTION_MAX * counts[0] else (0.0, 0.0)


def _find_common_pixels(shift_px: float, size_px: int) -> slice:
    """Find the pixels along one axis that an image shows both before and after a shift [px].

    They are counted in the image after the shift.
    """
    start = max(0, math.ceil(shift_px))
    stop = size_px + min(0, math.floor(shift_px))
    return slice(start, stop)


def shift_picture(picture: np.ndarray, shift_px: tuple[float, float]) -> np.ndarray:
    """Return an image with its content shifted by columns and rows.

    New pixels at an edge are like their neighbours.
    """
    if shift_px == (0.0, 0.0):
        return picture
    transform = np.array([[1.0, 0.0, shift_px[0]], [0.0, 1.0, shift_px[1]]])
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(picture, transform, size, borderMode=cv2.BORDER_REPLICATE)


def _flatten(picture: np.ndarray, scale: float) -> NDArray[np.float32]:
    """Scale an image, and remove slow changes of brightness across it, such as uneven light."""
    reduced = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    flat = np.asarray(reduced, np.float32)
    return flat - cv2.blur(flat, (MEAN_SQUARE_PX, MEAN_SQUARE_PX))


def _extract_features(flat: NDArray[np.float32]) -> NDArray[np.float32]:
    """Extract the features of a flattened image: deviations above a threshold, reduced by it.

    Everything that stands out less, such as noise and fixed patterns, becomes 0.
    """
    threshold = FEATURE_MEDIANS * float(np.median(np.abs(flat[::4, ::4])))
    return flat - np.clip(flat, -threshold, threshold)
