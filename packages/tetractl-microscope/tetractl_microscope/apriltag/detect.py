"""Finds AprilTags of the family 36h11 in a grey image with OpenCV, and draws tags.

The corners are refined: a line is fitted to each side of the black square, where the grey level
changes most, and neighbouring lines are intersected. A side has many more pixels than a corner, so
the corners are several times more accurate than those of OpenCV's own refinements
(benchmarks/apriltag.py).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats, GreyImage

MODULES = 8  # side of a tag in modules, including the black border
TAG_ZERO_BITS = (
    0xD5D628584  # the AprilTag project's tag 0: one bit per module, row by row, 1 is white
)


@dataclass(frozen=True, slots=True)
class Sighting:
    """An AprilTag that was found in an image.

    Attributes:
        tag: Number of the tag.
        corners: Columns and rows of the black square's corners [px], with pixel centres at whole
            numbers, shape (4, 2): top left, top right, bottom right and bottom left, as the tag is
            read upright.
        blur_px: Standard deviation of the Gaussian that blurs a sharp edge to the width of the
            square's edges [px].
    """

    tag: int
    corners: Floats
    blur_px: float

    @property
    def side_px(self) -> float:
        """Mean length of the four sides of the tag in the image [px]."""
        sides = self.corners - np.roll(self.corners, 1, axis=0)
        return float(np.linalg.norm(sides, axis=1).mean())


class Detector:
    """Finds AprilTags in an image, and refines their corners."""

    def __init__(self) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.adaptiveThreshWinSizeMin = 9
        parameters.adaptiveThreshWinSizeMax = 21
        # two adaptive thresholds: OpenCV's third one takes time and finds no further tags
        parameters.adaptiveThreshWinSizeStep = 12
        parameters.perspectiveRemovePixelPerCell = 8
        parameters.perspectiveRemoveIgnoredMarginPerCell = 0.33  # the rim of a module is blurred
        self._detector = cv2.aruco.ArucoDetector(_tag_dictionary(), parameters)
        self._top_left = _top_left_corner(self._detector)

    def find(self, picture: GreyImage) -> list[Sighting]:
        """Find all tags in an image. If two tags have the same number, both are returned.

        The list is empty if there are none.
        """
        # narrow pictures are enlarged, as a module is often too small to be read
        enlargement = 2 if picture.shape[1] < 1000 else 1
        enlarged = picture
        if enlargement > 1:
            enlarged = cv2.resize(
                picture, None, fx=enlargement, fy=enlargement, interpolation=cv2.INTER_CUBIC
            )
        rough_corners, numbers, _ = self._detector.detectMarkers(enlarged)
        if numbers is None or not len(numbers):
            return []
        corners = (np.array(rough_corners, float).reshape(-1, 4, 2) + 0.5) / enlargement - 0.5
        corners, blurs_px = refine_corners(
            picture, np.roll(corners, -self._top_left, axis=1), MODULES
        )
        return [
            Sighting(int(number), corners_of_tag, float(blur))
            for number, corners_of_tag, blur in zip(numbers.ravel(), corners, blurs_px, strict=True)
        ]


def tag_picture(number: int) -> GreyImage:
    """Draw a tag as the AprilTag project prints it.

    Returns:
        One pixel per module, shape (8, 8), 0 or 255.
    """
    rotations = [np.rot90(_draw_tag(0), k) for k in range(4)]
    printed = _draw_tag_zero()
    quarter_turns = next(k for k in range(4) if np.array_equal(rotations[k], printed))
    return np.ascontiguousarray(np.rot90(_draw_tag(number), quarter_turns))


def _top_left_corner(detector: cv2.aruco.ArucoDetector) -> int:
    """Find which corner that OpenCV reports is the top left corner of a printed tag.

    OpenCV's dictionary is rotated against the AprilTag project's pictures, by an angle that depends
    on the release. A picture of tag 0 shows the angle.
    """
    square = np.kron(_draw_tag_zero(), np.ones((20, 20), np.uint8))
    corners, _, _ = detector.detectMarkers(np.pad(square, 40, constant_values=255))
    return int(np.argmin(np.array(corners[0], float).reshape(4, 2).sum(axis=1)))


def _tag_dictionary() -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary of the family 36h11."""
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def _draw_tag(number: int) -> GreyImage:
    """Draw a tag with OpenCV, shape (8, 8), 0 or 255.

    It may be rotated relative to the AprilTag project's images.
    """
    return cv2.aruco.generateImageMarker(_tag_dictionary(), number, MODULES).astype(np.uint8)


def _draw_tag_zero() -> GreyImage:
    """Draw the AprilTag project's tag 0, one pixel per module, shape (8, 8)."""
    inside = [TAG_ZERO_BITS >> (35 - k) & 1 for k in range(36)]
    return np.pad(255 * np.array(inside, np.uint8).reshape(6, 6), 1)


# positions along a side, away from the corners, which blur rounds
SAMPLES_ALONG = np.linspace(0.15, 0.85, 15)
SAMPLES_ACROSS = np.linspace(-1.0, 1.0, 17)  # positions along its normal, as fractions of the reach
EPSILON = 1e-9


def refine_corners(
    picture: NDArray[np.uint8], corners: Floats, modules: int
) -> tuple[Floats, Floats]:
    """Refine the corners of T tags in an image to fractions of a pixel.

    Args:
        picture: The image.
        corners: Rough corners, clockwise round a dark square [px], shape (T, 4, 2).
        modules: Number of modules along each side of the square.

    Returns:
        The refined corners, shape (T, 4, 2) [px]. A tag whose sides cannot be found keeps its rough
        corners. Then the blurs, shape (T,) [px]: the standard deviation of the Gaussian that blurs
        a step to the width of the sides.
    """
    rough_corners = corners
    blur_px = np.zeros(len(corners))
    module_px = (
        np.linalg.norm(rough_corners - np.roll(rough_corners, -1, axis=1), axis=-1).mean(axis=1)
        / modules
    )
    # less than a module on either side of an edge, so that only border and margin are sampled
    offsets_px = 0.9 * module_px[:, None] * SAMPLES_ACROSS  # (T, A)
    step_px = offsets_px[:, 1:] - offsets_px[:, :-1]
    offset_middles = (offsets_px[:, 1:] + offsets_px[:, :-1])[:, None, None] / 2
    for _ in range(2):
        side_vectors = np.roll(corners, -1, axis=1) - corners
        side_directions = side_vectors / (
            np.linalg.norm(side_vectors, axis=-1, keepdims=True) + EPSILON
        )
        normals_out = np.stack([side_directions[..., 1], -side_directions[..., 0]], axis=-1)
        samples = (
            corners[..., None, :] + SAMPLES_ALONG[:, None] * side_vectors[..., None, :]
        )  # (T, 4, S, 2)
        normal_offsets = normals_out[:, :, None, None] * offsets_px[:, None, None, :, None]
        grey = _interpolate_grey(picture, samples[..., None, :] + normal_offsets)
        rises = np.maximum(np.diff(grey, axis=-1), 0.0)  # outward, black turns to white
        weights = rises**2 + EPSILON
        total_weight = weights.sum(axis=-1)
        edge_offsets = (weights * offset_middles).sum(axis=-1) / total_weight
        lines = _fit_lines(
            samples + edge_offsets[..., None] * normals_out[..., None, :], total_weight
        )
        intersections = np.cross(
            np.roll(lines, 1, axis=1), lines
        )  # neighbours, not finite if parallel
        with np.errstate(divide="ignore", invalid="ignore"):
            corners = intersections[..., :2] / intersections[..., 2:]
        profile = rises.mean(axis=(1, 2)) / step_px  # grey levels per pixel
        contrast = (profile * step_px).sum(axis=-1)
        blur_px = contrast / (profile.max(axis=-1) + EPSILON) / np.sqrt(2 * np.pi)
    shift_px = np.linalg.norm(corners - rough_corners, axis=-1).max(axis=1)
    is_refined = shift_px < 2 * module_px  # false for NaN too
    return np.where(is_refined[:, None, None], corners, rough_corners), blur_px


def _interpolate_grey(picture: NDArray[np.uint8], points: Floats) -> Floats:
    """Interpolate the grey levels (..., M) of an image at columns and rows (..., M, 2).

    Positions outside the image give the level of the nearest pixel at its edge.
    """
    flat = points.reshape(-1, points.shape[-2], 2).astype(np.float32)
    columns = flat[..., 0].copy()
    rows = flat[..., 1].copy()
    grey = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.reshape(points.shape[:-1]).astype(float)


def _fit_lines(points: Floats, weight: Floats) -> Floats:
    """Fit lines to points (..., S, 2) with weights (..., S).

    Returns:
        a, b, c (..., 3) of a x + b y + c = 0 with a^2 + b^2 = 1.
    """
    fractions = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    middle = (fractions * points).sum(axis=-2)
    deviations = points - middle[..., None, :]
    _, axes = np.linalg.eigh(np.swapaxes(fractions * deviations, -1, -2) @ deviations)
    normal = axes[..., 0]  # eigenvector of the smaller eigenvalue
    return np.concatenate([normal, -(normal * middle).sum(axis=-1, keepdims=True)], axis=-1)
