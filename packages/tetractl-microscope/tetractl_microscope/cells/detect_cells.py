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

from tetractl.core.poses import Bools, Floats, GreyImage
from tetractl_microscope.cells.knocks import find_shift, shift_picture

STRIPE_COUNT = 16
"""Number of horizontal stripes of the background. Each image updates one of them."""
LEARNING_RATE = 0.1
"""Weight of an image in the background: a time constant of 5 s at 30 images per second."""
SAMPLED_ROWS = 64
"""Number of rows from which light and noise are estimated. A small image has fewer."""
ROWS_PX = 300_000
"""Maximum number of pixels of each image that the median processes at once."""
SQUARE_SIDE = 1.2
"""Side of the averaging square, relative to a square with the minimum area of a cell."""
LOW_STDS = 3.0
"""Threshold for every pixel of a body, in standard deviations of the averaged differences."""
HIGH_STDS = 4.5
"""Threshold for the peak of a body, in standard deviations of the averaged differences."""
NOISE_STD_MIN = 0.33
"""Minimum standard deviation of the averaged differences, because images have whole grey levels."""
NOISE_GROWTH_MAX = 4.0
"""Ratio of the noise to the noise after learning, above which the background is invalid."""
NOISE_MAX = 20.0
"""Maximum noise of an image of a dish [grey levels]."""
BLOBS_MAX = 200
"""Maximum number of blobs in an image. The smallest ones are dropped."""
CHANGED_FRACTION_MAX = 0.25
"""Fraction of changed pixels above which the background is invalid."""
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
"""Maximum number of bodies in a region."""
NEXT_PEAK_FRACTION = 0.5
"""Minimum peak of a further body in a region, as a fraction of the largest peak."""
KNOCK_CHANGE = 1.1, 0.0003
"""Factor on the usual changed fraction, and a term added to it. A larger change may be a knock."""
USUAL_WEIGHT = 0.05
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
        x: x of its centre [px].
        y: y of its centre [px].
        axis: Its direction [rad], modulo pi.
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
    """Brightness, noise and contrast of an image.

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
        """Shift the background as far as an image has shifted.

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

    def update(self, rows: slice, levels: NDArray[np.float32], calm: GreyImage) -> None:
        """Update rows of the background by a weighted mean with new grey levels.

        Args:
            rows: The rows.
            levels: The new grey levels.
            calm: Mask of the pixels to update.
        """
        fine = self.fine[rows]
        cv2.accumulateWeighted(levels, fine, LEARNING_RATE, calm)
        self.grey[rows] = cv2.convertScaleAbs(fine)


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
        return self.pixel_min - (self.peak_min - self.pixel_min) * LOW_STDS / (HIGH_STDS - LOW_STDS)


NO_BODY = SearchLimits(pixel_min=math.inf, peak_min=math.inf, area_min_px2=0.0, area_max_px2=0.0)
"""Limits that nothing exceeds, used until an image is compared with the background."""


class SearchArrays:
    """Working arrays for the newest image, all of the image's shape.

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
    """Finds blobs that are brighter or darker than the background.

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
            or light.changed_fraction > KNOCK_CHANGE[0] * usual.changed_fraction + KNOCK_CHANGE[1]
        ):
            shift_px = background.follow_knock(newest.smooth, light.gain)
            if shift_px != (0.0, 0.0):
                light = self._compare_with_background(background, newest)
            usual_fraction = light.changed_fraction
        else:
            usual_fraction = usual.changed_fraction + USUAL_WEIGHT * (
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
        """Compare the newest image with the background.

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
        square_px = _averaging_square(self.area_min_px2).shape
        border = cv2.BORDER_CONSTANT
        cv2.boxFilter(newest.difference, cv2.CV_32F, square_px, newest.averages, borderType=border)
        sample = _sample_pixels(newest.averages)
        usual_max = np.median(sample) + max(NOISE_SPAN_MIN, noise)
        is_usual = sample <= usual_max
        usual_averages = sample[is_usual].astype(float)
        mean_level = min(float(usual_averages.mean()), NOISE_MAX)
        noise_std = max(float(usual_averages.std()), NOISE_STD_MIN)
        pixel_min = mean_level + LOW_STDS * noise_std
        peak_min = mean_level + HIGH_STDS * noise_std
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
            region for region in self.regions() if _box_px2(region) >= self.area_min_px2
        ]
        large_regions.sort(key=_box_px2, reverse=True)
        blobs: list[Blob] = []
        for region in large_regions[:BLOBS_MAX]:
            blobs += _find_bodies(region, newest.difference, newest.averages, newest.limits)
        return blobs[:BLOBS_MAX]

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
            rectangle = blob.slices
            levels = self._newest.smooth[rectangle].astype(np.float32) / gain
            body = blob.mask > 0
            neighbourhood = cv2.dilate(blob.mask, _averaging_square(self.area_min_px2)) > 0
            ring = neighbourhood & (self._newest.mask[rectangle] == 0)
            background_levels = background.fine[rectangle]
            mean_change = gain * float(np.abs(levels - background.learned[rectangle])[body].mean())
            if mean_change < self._newest.limits.pixel_min:
                background.correct(rectangle, neighbourhood, levels)
            elif _is_ghost(levels, background_levels, body, ring):
                background.correct(rectangle, neighbourhood, levels)
                background.learned[rectangle][neighbourhood] = levels[neighbourhood]
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
        calm = 1 - newest.mask[rows_of_stripe]
        for left_px, top_px, right_px, bottom_px in cell_rectangles:
            rows_of_cell = slice(max(0, top_px - top), max(0, bottom_px - top))
            calm[rows_of_cell, max(0, left_px) : max(0, right_px)] = 0
        scaled = newest.smooth[rows_of_stripe].astype(np.float32) / self.light.gain
        self._background.update(rows_of_stripe, scaled, calm)
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
    levels: NDArray[np.float32], background: NDArray[np.float32], body: Bools, ring: Bools
) -> bool:
    """Check whether a body is only in the background.

    A ghost looks like the unchanged ring around it now, but differs from the ring in the
    background: there, the difference is at least GHOST_RATIO times as large.
    """
    ring_level = background[ring].mean() if ring.any() else np.median(background)
    contrast_now = float(np.abs(levels - ring_level)[body].mean())
    contrast_in_background = float(np.abs(background - ring_level)[body].mean())
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


def _box_px2(contour: np.ndarray) -> int:
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
    inside = np.zeros((box.height, box.width), np.uint8)
    cv2.drawContours(inside, [region], -1, 1, -1, offset=(-box.left, -box.top))
    if cv2.countNonZero(inside) < limits.area_min_px2:
        return
    remaining = averages[box.slices] * inside
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
        body = _to_grey(mask == 2)
        surroundings = cv2.dilate(body, _averaging_square(limits.area_min_px2)) > 0
        remaining[surroundings] = 0
        body_px2 = cv2.countNonZero(body)
        if (
            limits.area_min_px2 / 2 <= body_px2 <= limits.area_max_px2
        ):  # a neighbour cuts a part off
            rise = (difference[box.slices] - limits.level) / peak_height
            weights = (np.clip(rise, *WEIGHT_RAMP) - WEIGHT_RAMP[0]) * surroundings
            yield _measure_blob(body, weights, difference[box.slices], box, at_edge)


def _measure_blob(
    body: GreyImage, weights: NDArray[np.floating], difference: GreyImage, box: Box, at_edge: bool
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
        strength=cv2.mean(difference, body)[0],
        mask=body,
        corner=(box.left, box.top),
        at_edge=at_edge,
    )


def _averaging_square(area_min_px2: float) -> GreyImage:
    """Return the square over which differences are averaged.

    Its side is an odd number of pixels.
    """
    return np.ones((2 * int(SQUARE_SIDE * math.sqrt(area_min_px2) / 2) + 1,) * 2, np.uint8)


def _blur(picture: np.ndarray, buffer: np.ndarray, blurred: np.ndarray) -> None:
    """Blur an image with two box filters, which is four times as fast as a Gaussian filter.

    The result is close to a Gaussian blur with a standard deviation of 1.15 px.

    Args:
        picture: The image.
        buffer: A buffer.
        blurred: Filled with the result.
    """
    cv2.blur(picture, (3, 3), buffer)
    cv2.blur(buffer, (3, 3), blurred)


def _sample_pixels(picture: np.ndarray) -> np.ndarray:
    """Return every n-th pixel of an image, for statistics."""
    step = max(8, picture.shape[0] // SAMPLED_ROWS)
    return picture[::step, ::step]


def _median_image(pictures: Sequence[GreyImage], gains: Floats) -> NDArray[np.float32]:
    """Compute the median of images, each multiplied by its gain. It uses little memory."""
    median = np.empty(pictures[0].shape, np.float32)
    rows_at_once = max(1, min(SAMPLED_ROWS, ROWS_PX // median[0].size))
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
