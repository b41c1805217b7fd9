"""Finds cells in a grey image as blobs: regions that differ from a slowly updated background.

The steps are:

1. Blur the image.
2. Subtract the background, scaled to the brightness of the image.
3. Average the absolute difference over a square as small as the smallest cell, so that a body and
   its halo become one region.
4. Keep the pixels that exceed the noise of these averages.
5. Compute the moments of each body.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Bools, Floats, GreyImage
from tetractl_microscope.cells.knocks import find_shift, shift_picture

STRIPE_COUNT = 16
"""Number of horizontal stripes of the background. Each image updates one of them."""
LEARNING_RATE = 0.1
"""Weight of an image in the background: a time constant of 5 s at 30 images per second."""
SAMPLED_ROWS = 64
"""Number of rows from which light and noise are estimated. A small image has fewer."""
MEDIAN_PIXELS_MAX = 300_000
"""Maximum number of pixels of each image that the median processes at once."""
SQUARE_SIDE_RATIO = 1.2
"""Side of the averaging square, relative to a square with the minimum area of a cell."""
PIXEL_THRESHOLD_STDS = 3.0
"""Minimum difference of every pixel of a body, in standard deviations of averaged differences."""
PEAK_THRESHOLD_STDS = 4.5
"""Minimum peak difference of a body, in standard deviations of the averaged differences."""
NOISE_STD_MIN = 0.33
"""Minimum standard deviation of the averaged differences, because images have whole grey levels."""
NOISE_GROWTH_MAX = 4.0
"""Maximum ratio of the noise to the noise after learning. Above it, the background is invalid."""
NOISE_MAX = 20.0
"""Maximum noise of an image of a dish [grey levels]."""
BLOBS_MAX = 200
"""Maximum number of blobs in an image. The smallest blobs are dropped."""
CHANGED_FRACTION_MAX = 0.25
"""Maximum fraction of changed pixels. Above it, the background is invalid."""
EDGE_FRACTION = 0.5
"""Averaged difference at the edge of a body, as a fraction of the body's peak."""
GHOST_RATIO = 2.0
"""Contrast in the background, relative to the contrast in the image, that marks a ghost.

A ghost is a body that is in the background but not in the image. Both contrasts are measured
against the surroundings of the body.
"""
WEIGHT_RAMP = 0.2, 0.6
"""Differences between which the weight of a pixel rises, as fractions of the body's peak."""
BODIES_MAX = 4
"""Maximum number of cell bodies that are searched in one region."""
NEXT_PEAK_FRACTION = 0.5
"""Minimum peak of a further body in a region, as a fraction of the largest peak."""
KNOCK_CHANGE_LIMIT = 1.1, 0.0003
"""Maximum fraction of changed pixels without a knock: a factor on its usual value, and a term."""
USUAL_CHANGE_WEIGHT = 0.05
"""Weight of an image in the mean changed fraction: a time constant of 20 images. Chosen by hand."""
GAIN_MIN = 0.05
"""Minimum brightness relative to the background at which an image is scaled; see GAIN_MAX."""
GAIN_MAX = 20.0
"""Maximum brightness relative to the background at which an image is scaled.

Beyond GAIN_MIN and GAIN_MAX, the image or the background is nearly black, and the image is compared
without scaling. The values were chosen by hand; no lamp is adjusted that far.
"""
NORMAL_MAD = 1.48
"""Standard deviation of normal noise, relative to its median absolute deviation: 1 / 0.6745."""
NOISE_SPAN_MIN = 2.0
"""Minimum range above the median in which averaged differences count as noise [grey levels]."""
LOST_IN_A_ROW_MAX = 5
"""Number of lost images in a row after which the background is learned again."""
SAMPLED_STRIDE = 3
"""When learning again, every SAMPLED_STRIDE-th lost image is used."""
RELEARNING_SAMPLES = 9
"""Number of images from which the background is learned again."""


@dataclass(frozen=True, slots=True)
class Blob:
    """A region of an image that differs from the background.

    Attributes:
        x: Column of the centre [px].
        y: Row of the centre [px].
        axis: Direction of the long axis [rad], modulo pi.
        length: Long axis of the ellipse with the same moments [px].
        width: Short axis of that ellipse [px].
        strength: Mean difference from the background [grey levels].
        mask: Mask of the blob's pixels in a rectangle of the image.
        corner: Column and row of the rectangle's upper left pixel.
        at_edge: Whether the image's edge cuts the blob.
    """

    x: float
    y: float
    axis: float
    length: float
    width: float
    strength: float
    mask: GreyImage
    corner: tuple[int, int]
    at_edge: bool

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle of `mask` in the image."""
        height, width = self.mask.shape
        return Box(*self.corner, width, height).slices

    @property
    def pixels(self) -> Floats:
        """Column and row of each of the blob's M pixels, shape (M, 2)."""
        rows, columns = np.nonzero(self.mask)
        return np.column_stack([columns + self.corner[0], rows + self.corner[1]]).astype(float)


@dataclass(frozen=True, slots=True)
class Light:
    """The light conditions of an image: its brightness, noise and contrast.

    Attributes:
        gain: Brightness of the image, relative to the background.
        noise: Standard deviation of its noise [grey levels].
        contrast: Median strength of its blobs [grey levels]. None without blobs.
        changed_fraction: Fraction of the pixels that differ from the background.
        lost: Whether the image cannot be compared with the background, because cells cannot explain
            how much of it has changed.
        shift_px: How far the stage has moved since the previous image [px]: columns to the right,
            rows down.
        contrast_min: Minimum contrast at which a cell is found [grey levels].
    """

    gain: float
    noise: float
    contrast: float | None
    changed_fraction: float
    lost: bool
    shift_px: tuple[float, float] = (0.0, 0.0)
    contrast_min: float = 0.0


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
        self.grey = _to_grey(cv2.convertScaleAbs(fine))

    def move(self, shift_px: tuple[float, float]) -> None:
        """Shift the background with the content of the image.

        Args:
            shift_px: Shift [px]: columns to the right, rows down.
        """
        self.fine = np.asarray(shift_picture(self.fine, shift_px), np.float32)
        self.learned = np.asarray(shift_picture(self.learned, shift_px), np.float32)
        self.grey = _to_grey(cv2.convertScaleAbs(self.fine))

    def follow_knock(self, smooth: GreyImage, gain: float) -> tuple[float, float]:
        """Find how far the image has shifted after a knock, and shift the background as far.

        Args:
            smooth: The blurred image.
            gain: Brightness of the image, relative to the background.

        Returns:
            The shift [px]: columns to the right, rows down.
        """
        shift_px = find_shift(cv2.convertScaleAbs(self.grey, alpha=gain), smooth)
        if shift_px != (0.0, 0.0):
            self.move(shift_px)
        return shift_px

    def correct(
        self, rectangle: tuple[slice, slice], is_wrong: Bools, levels: NDArray[np.floating]
    ) -> None:
        """Replace wrong pixels in a rectangle of the background.

        Args:
            rectangle: The rectangle, as slices of rows and columns.
            is_wrong: Which of its pixels to replace.
            levels: The grey levels that replace them.
        """
        self.fine[rectangle][is_wrong] = levels[is_wrong]
        self.grey[rectangle][is_wrong] = np.clip(self.fine[rectangle][is_wrong], 0, 255)

    def update(self, rows: slice, levels: NDArray[np.float32], update_mask: GreyImage) -> None:
        """Update rows of the background by a weighted mean with new grey levels.

        Args:
            rows: The rows.
            levels: The new grey levels.
            update_mask: Mask of the pixels to update.
        """
        background_rows = self.fine[rows]
        cv2.accumulateWeighted(levels, background_rows, LEARNING_RATE, update_mask)
        self.grey[rows] = cv2.convertScaleAbs(background_rows)


class SearchLimits(NamedTuple):
    """Limits for finding bodies in the averaged difference from the background.

    Attributes:
        pixel_min: Minimum difference at every pixel of a body [grey levels].
        peak_min: Minimum of the largest difference in a body [grey levels].
        area_min_px2: Minimum area of a body [px^2].
        area_max_px2: Maximum area of a body [px^2].
    """

    pixel_min: float
    peak_min: float
    area_min_px2: float
    area_max_px2: float

    @property
    def level(self) -> float:
        """The mean of the averaged differences where there is no body [grey levels]."""
        return self.pixel_min - (self.peak_min - self.pixel_min) * PIXEL_THRESHOLD_STDS / (
            PEAK_THRESHOLD_STDS - PIXEL_THRESHOLD_STDS
        )


NO_BODY = SearchLimits(pixel_min=math.inf, peak_min=math.inf, area_min_px2=0.0, area_max_px2=0.0)
"""Limits that nothing exceeds, used until an image is compared with the background."""


class SearchArrays:
    """Arrays for the search of the newest image, all of the image's shape.

    Attributes:
        limits: The limits of the search.
        smooth: The blurred image.
        difference: Absolute difference between the blurred image and the background.
        averages: The difference averaged over squares.
        mask: Where `averages` is above the lower limit.
        stripe: Index of the stripe of the background that is updated next.
    """

    def __init__(self, picture: GreyImage) -> None:
        self.limits = NO_BODY
        self.smooth: GreyImage = np.zeros_like(picture)
        self.difference: GreyImage = np.zeros_like(picture)
        self.averages = np.empty(picture.shape, np.float32)
        self.mask: GreyImage = np.zeros_like(picture)
        self.stripe = 0

    def next_stripe(self) -> slice:
        """Return the rows of the stripe to update, and advance to the next one.

        After the lowest stripe, the topmost follows.
        """
        height = len(self.smooth)
        top = self.stripe * height // STRIPE_COUNT
        bottom = (self.stripe + 1) * height // STRIPE_COUNT
        self.stripe = (self.stripe + 1) % STRIPE_COUNT
        return slice(top, bottom)


@dataclass(slots=True)
class LostPictures:
    """The images that could not be compared with the background.

    Attributes:
        in_a_row: Number of such images in a row.
        sample: A sample of them, from which a new background is learned.
    """

    in_a_row: int = 0
    sample: list[GreyImage] = field(default_factory=list)


class BlobFinder:
    """Finds blobs, such as cells, that are brighter or darker than the background of images.

    A blob covers `area_min_px2` to `area_max_px2` pixels after differences were averaged over
    squares slightly larger than the minimum. `learn` computes the background from images taken over
    a second or more. `update_background` updates it with later images, except around the cells, so
    that the background never shows resting cells. After a knock, the background is moved by the
    image's shift. If a cell rested while the background was learned, that place is repaired once
    the cell has left. If the background no longer applies, it is learned again.

    `bright` is True if most moving objects are brighter than the background. `light` belongs to
    the newest image.
    """

    def __init__(self, area_min_px2: float, area_max_px2: float) -> None:
        self.area_min_px2 = area_min_px2
        self.area_max_px2 = area_max_px2
        self.bright = False
        self.light = Light(1.0, 0.0, None, 0.0, False)
        self._background: Background | None = None
        self._newest = SearchArrays(np.empty((0, 0), np.uint8))
        # the mean fraction of changed pixels, and the noise of the first picture after learning
        self._usual: Light | None = None
        self._lost = LostPictures()

    @property
    def background(self) -> GreyImage | None:
        """The background in whole grey levels. None before it was learned."""
        return None if self._background is None else self._background.grey

    def learn(self, pictures: Sequence[GreyImage]) -> None:
        """Compute the background as the median of images (height, width).

        Each image is first shifted and scaled to fit the middle one. The method also determines
        whether most cells are brighter or darker than the background.
        """
        medians = np.array([np.median(_sample_pixels(picture)) for picture in pictures])
        levels = np.maximum(medians, 1.0)
        gains = np.median(levels) / levels
        middle = len(pictures) // 2
        middle_images = slice(max(0, middle - 2), middle + 3)
        middle_median = _to_grey(
            cv2.convertScaleAbs(_median_image(pictures[middle_images], gains[middle_images]))
        )
        aligned = [
            shift_picture(
                picture, find_shift(cv2.convertScaleAbs(picture, alpha=gain), middle_median)
            )
            for picture, gain in zip(pictures, gains, strict=True)
        ]
        median_levels = _median_image(aligned, gains)
        _blur(median_levels, np.empty_like(median_levels), median_levels)
        self._background = Background(median_levels)
        median_sample = _sample_pixels(median_levels)
        differences = [
            gain * _sample_pixels(picture) - median_sample
            for picture, gain in zip(aligned, gains, strict=True)
        ]
        self.bright = (
            float(np.sum(np.power(differences, 3))) > 0
        )  # noise is symmetric, cells are not
        self._usual = None
        self._lost = LostPictures()

    def find_blobs(self, picture: GreyImage) -> list[Blob]:
        """Find the blobs of an image (height, width), the largest first.

        The list is empty if the image cannot be compared with the background (`light.lost`).
        `learn` must have been called before.
        """
        assert self._background is not None, "learn() comes first"
        background = self._background
        if self._newest.smooth.shape != picture.shape:
            self._newest = SearchArrays(picture)
        newest = self._newest
        _blur(picture, newest.difference, newest.smooth)
        light = self._compare_with_background(background, newest)
        usual = self._usual
        shift_px = (0.0, 0.0)
        if (
            usual is None
            or light.changed_fraction
            > KNOCK_CHANGE_LIMIT[0] * usual.changed_fraction + KNOCK_CHANGE_LIMIT[1]
        ):
            shift_px = background.follow_knock(newest.smooth, light.gain)
            if shift_px != (0.0, 0.0):
                light = self._compare_with_background(background, newest)
            usual_fraction = light.changed_fraction
        else:
            usual_fraction = usual.changed_fraction + USUAL_CHANGE_WEIGHT * (
                light.changed_fraction - usual.changed_fraction
            )
        first_noise = light.noise if usual is None else usual.noise
        self._usual = replace(light, changed_fraction=usual_fraction, noise=first_noise)
        is_noisy = light.noise > NOISE_GROWTH_MAX * max(first_noise, 1.0)
        is_relearning = len(self._lost.sample) > 0  # once begun, until there is a new background
        is_lost = (
            light.lost or is_noisy or light.changed_fraction > CHANGED_FRACTION_MAX or is_relearning
        )
        candidates = [] if is_lost else self._largest_blobs(newest)
        blobs = self._without_ghosts(candidates, light.gain, background)
        contrast = float(np.median([blob.strength for blob in blobs])) if blobs else None
        self.light = replace(
            light,
            contrast=contrast,
            lost=is_lost,
            shift_px=(0.0, 0.0) if usual is None else shift_px,
        )
        self._lost.in_a_row = self._lost.in_a_row + 1 if is_lost else 0
        return blobs

    def _compare_with_background(self, background: Background, newest: SearchArrays) -> Light:
        """Compare the newest image with the background, and measure its brightness and noise.

        The difference, its limits, its averages and the mask are stored in `newest`.

        Returns:
            The brightness and noise of the image.
        """
        levels = _sample_pixels(newest.smooth)
        background_levels = np.maximum(_sample_pixels(background.grey), 1)
        gain = float(np.median(levels / background_levels))
        gain = gain if GAIN_MIN < gain < GAIN_MAX else 1.0
        cv2.convertScaleAbs(background.grey, newest.difference, gain)
        cv2.absdiff(newest.smooth, newest.difference, newest.difference)
        # medians, and averages of what is near them: cells and debris do not count
        deviations = np.abs(levels - gain * background_levels)
        noise = min(NORMAL_MAD * float(np.median(deviations)), NOISE_MAX)
        square_px = _create_averaging_square(self.area_min_px2).shape
        border = cv2.BORDER_CONSTANT
        cv2.boxFilter(newest.difference, cv2.CV_32F, square_px, newest.averages, borderType=border)
        sample = _sample_pixels(newest.averages)
        usual_max = np.median(sample) + max(NOISE_SPAN_MIN, noise)
        is_usual = sample <= usual_max
        usual_averages = sample[is_usual].astype(float)
        mean_level = min(float(usual_averages.mean()), NOISE_MAX)
        noise_std = max(float(usual_averages.std()), NOISE_STD_MIN)
        pixel_min = mean_level + PIXEL_THRESHOLD_STDS * noise_std
        peak_min = mean_level + PEAK_THRESHOLD_STDS * noise_std
        newest.limits = SearchLimits(pixel_min, peak_min, self.area_min_px2, self.area_max_px2)
        np.greater(newest.averages, pixel_min, out=newest.mask)
        # a saturated or noisy picture differs little from one expected to be as bright or noisy
        is_newly_white = np.median(levels) == 255 and np.median(background_levels) < 255
        is_lost = noise == NOISE_MAX or bool(is_newly_white)
        changed_fraction = cv2.countNonZero(newest.mask) / newest.mask.size
        return Light(gain, noise, None, changed_fraction, is_lost, contrast_min=peak_min)

    def _largest_blobs(self, newest: SearchArrays) -> list[Blob]:
        """Find the BLOBS_MAX largest blobs of the newest image, the largest regions first.

        Regions whose bounding box is smaller than `area_min_px2` are left out.
        """
        large_regions = [
            region
            for region in self.regions()
            if _bounding_box_area_px2(region) >= self.area_min_px2
        ]
        large_regions.sort(key=_bounding_box_area_px2, reverse=True)
        blobs: list[Blob] = []
        for region in large_regions[:BLOBS_MAX]:
            blobs += _find_bodies(region, newest.difference, newest.averages, newest.limits)
        return blobs[:BLOBS_MAX]

    def regions(self) -> Sequence[np.ndarray]:
        """Find the contours of all regions of the newest image that differ from the background.

        The order of the regions has no meaning. Holes in a region are ignored.
        """
        return cv2.findContours(self._newest.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]

    def _without_ghosts(
        self, candidates: Sequence[Blob], gain: float, background: Background
    ) -> list[Blob]:
        """Select the blobs that show bodies, and correct the background at the other blobs.

        A blob shows no body if the image there is as it was when the background was learned, or if
        a body is only in the background. Blobs are corrected one after another, because they may
        share a rectangle.
        """
        blobs: list[Blob] = []
        for blob in candidates:
            rectangle = blob.slices
            levels = self._newest.smooth[rectangle].astype(np.float32) / gain
            is_body = blob.mask > 0
            is_near_body = cv2.dilate(blob.mask, _create_averaging_square(self.area_min_px2)) > 0
            is_ring = is_near_body & (self._newest.mask[rectangle] == 0)
            background_levels = background.fine[rectangle]
            mean_change = gain * float(
                np.abs(levels - background.learned[rectangle])[is_body].mean()
            )
            if mean_change < self._newest.limits.pixel_min:
                background.correct(rectangle, is_near_body, levels)
            elif _is_ghost(levels, background_levels, is_body, is_ring):
                background.correct(rectangle, is_near_body, levels)
                background.learned[rectangle][is_near_body] = levels[is_near_body]
            else:
                blobs.append(blob)
        return blobs

    def update_background(self, cell_rectangles: Sequence[tuple[int, int, int, int]]) -> None:
        """Update the next stripe of the background with the newest image, except around cells.

        If the background no longer applies, it is learned again.

        Args:
            cell_rectangles: Rectangles around the cells: left, top, right and bottom [px].
        """
        assert self._background is not None, "learn() comes first"
        newest = self._newest
        rows_of_stripe = newest.next_stripe()
        top = rows_of_stripe.start
        if top == rows_of_stripe.stop:  # a picture with fewer rows than stripes
            return
        update_mask = 1 - newest.mask[rows_of_stripe]
        for left_px, top_px, right_px, bottom_px in cell_rectangles:
            rows_of_cell = slice(max(0, top_px - top), max(0, bottom_px - top))
            update_mask[rows_of_cell, max(0, left_px) : max(0, right_px)] = 0
        scaled_levels = newest.smooth[rows_of_stripe].astype(np.float32) / self.light.gain
        self._background.update(rows_of_stripe, scaled_levels, update_mask)
        self._relearn_if_lost()

    def _relearn_if_lost(self) -> None:
        """Learn the background again if many images in a row are lost.

        After LOST_IN_A_ROW_MAX lost images, every SAMPLED_STRIDE-th image is kept as a sample. The
        background is learned from RELEARNING_SAMPLES samples.
        """
        newest = self._newest
        if self._lost.in_a_row > LOST_IN_A_ROW_MAX and newest.stripe % SAMPLED_STRIDE == 0:
            self._lost.sample.append(newest.smooth.copy())
            if len(self._lost.sample) == RELEARNING_SAMPLES:
                self.learn(self._lost.sample)


def _is_ghost(
    levels: NDArray[np.float32], background: NDArray[np.float32], is_body: Bools, is_ring: Bools
) -> bool:
    """Check whether a blob is a ghost: a body that is only in the background, not in the image.

    A ghost now looks like the unchanged ring around it. In the background, it differs from the
    ring, at least GHOST_RATIO times as much as in the image.
    """
    ring_level = background[is_ring].mean() if is_ring.any() else np.median(background)
    contrast_now = float(np.abs(levels - ring_level)[is_body].mean())
    contrast_in_background = float(np.abs(background - ring_level)[is_body].mean())
    return contrast_in_background >= GHOST_RATIO * max(contrast_now, 1.0)


class Box(NamedTuple):
    """A rectangle of pixels: its left column, top row, width and height."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle in an image."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


def _bounding_box_area_px2(contour: np.ndarray) -> int:
    """Compute the area of a contour's bounding box [px^2]."""
    _, _, width, height = cv2.boundingRect(contour)
    return width * height


def _find_bodies(
    region: np.ndarray, difference: GreyImage, averages: NDArray[np.float32], limits: SearchLimits
) -> Iterator[Blob]:
    """Find the bodies in a region, in the order of decreasing difference from the background.

    Args:
        region: Contour of the region.
        difference: Absolute difference between the image and the background.
        averages: The difference averaged over squares.
        limits: The limits of the search.
    """
    box = Box(*cv2.boundingRect(region))
    is_inside = np.zeros((box.height, box.width), np.uint8)
    cv2.drawContours(is_inside, [region], -1, 1, -1, offset=(-box.left, -box.top))
    if cv2.countNonZero(is_inside) < limits.area_min_px2:
        return
    remaining = averages[box.slices] * is_inside
    height_px, width_px = averages.shape
    is_at_side = box.left == 0 or box.left + box.width == width_px
    at_edge = is_at_side or box.top == 0 or box.top + box.height == height_px
    peak_min = limits.peak_min
    for _ in range(BODIES_MAX):
        _, peak, _, peak_position = cv2.minMaxLoc(remaining)
        if peak <= peak_min:
            return
        peak_min = max(peak_min, NEXT_PEAK_FRACTION * peak)
        peak_height = peak - limits.level
        mask = _to_grey(
            remaining > max(limits.pixel_min, limits.level + EDGE_FRACTION * peak_height)
        )
        cv2.floodFill(mask, None, peak_position, 2)
        body_mask = _to_grey(mask == 2)
        is_near_body = cv2.dilate(body_mask, _create_averaging_square(limits.area_min_px2)) > 0
        remaining[is_near_body] = 0
        body_px2 = cv2.countNonZero(body_mask)
        if (
            limits.area_min_px2 / 2 <= body_px2 <= limits.area_max_px2
        ):  # a neighbour cuts a part off
            weight_levels = (difference[box.slices] - limits.level) / peak_height
            weights = (np.clip(weight_levels, *WEIGHT_RAMP) - WEIGHT_RAMP[0]) * is_near_body
            yield _measure_blob(body_mask, weights, difference[box.slices], box, at_edge)


def _measure_blob(
    body_mask: GreyImage,
    weights: NDArray[np.floating],
    difference: GreyImage,
    box: Box,
    at_edge: bool,
) -> Blob:
    """Measure a body in an image: compute the ellipse with the same weighted moments.

    The weights rise from 0 with the difference, up to a maximum, so that neither single pixels at
    the body's edge nor structures inside it change the moments much. An ellipse has the second
    moments length^2 / 16 and width^2 / 16 along its axes. Each pixel adds 1 / 12.
    """
    moments = cv2.moments(weights)
    if moments["m00"] == 0:
        moments = cv2.moments(body_mask, binaryImage=True)
    mass = moments["m00"]
    variance_x = moments["mu20"] / mass + 1 / 12
    variance_y = moments["mu02"] / mass + 1 / 12
    covariance_xy = moments["mu11"] / mass
    mean_variance = (variance_x + variance_y) / 2
    half_difference = math.hypot((variance_x - variance_y) / 2, covariance_xy)
    return Blob(
        x=box.left + moments["m10"] / mass,
        y=box.top + moments["m01"] / mass,
        axis=0.5 * math.atan2(2 * covariance_xy, variance_x - variance_y),
        length=4 * math.sqrt(mean_variance + half_difference),
        width=4 * math.sqrt(max(mean_variance - half_difference, 1e-3)),
        strength=cv2.mean(difference, body_mask)[0],
        mask=body_mask,
        corner=(box.left, box.top),
        at_edge=at_edge,
    )


def _create_averaging_square(area_min_px2: float) -> GreyImage:
    """Create the square over which differences from the background are averaged.

    Its side is an odd number of pixels.
    """
    return np.ones((2 * int(SQUARE_SIDE_RATIO * math.sqrt(area_min_px2) / 2) + 1,) * 2, np.uint8)


def _blur(picture: np.ndarray, buffer: np.ndarray, blurred: np.ndarray) -> None:
    """Blur an image with two box filters, which is four times as fast as a Gaussian filter.

    The result is close to a Gaussian blur with a standard deviation of 1.15 px.

    Args:
        picture: The image.
        buffer: Working array of the same shape. Its contents are overwritten.
        blurred: Array that is filled with the result.
    """
    cv2.blur(picture, (3, 3), buffer)
    cv2.blur(buffer, (3, 3), blurred)


def _sample_pixels(picture: np.ndarray) -> np.ndarray:
    """Return every n-th pixel of an image, for statistics."""
    step = max(8, picture.shape[0] // SAMPLED_ROWS)
    return picture[::step, ::step]


def _median_image(pictures: Sequence[GreyImage], gains: Floats) -> NDArray[np.float32]:
    """Compute the pixelwise median of images, each multiplied by its gain, with little memory."""
    median = np.empty(pictures[0].shape, np.float32)
    rows_at_once = max(1, min(SAMPLED_ROWS, MEDIAN_PIXELS_MAX // median[0].size))
    for top in range(0, len(median), rows_at_once):
        band = slice(top, top + rows_at_once)
        scaled = [
            gain * picture[band].astype(np.float32)
            for picture, gain in zip(pictures, gains, strict=True)
        ]
        np.median(scaled, axis=0, out=median[band], overwrite_input=True)
    return median


def _to_grey(picture: np.ndarray) -> GreyImage:
    """Convert an image to 8-bit grey levels.

    Fractions are cut off, and the range is not checked.
    """
    return np.asarray(picture, np.uint8)
