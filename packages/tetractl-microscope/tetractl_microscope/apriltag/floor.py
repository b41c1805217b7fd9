"""Calibrates the camera with the floor tags, and converts pixels to positions above the floor.

The camera is a pinhole with square pixels: it shows the point X at the pixel x = K (R X + t), up to
scale. Once distortion is removed, a pixel defines a ray. A tag at the height h is where its ray
meets the plane z = h. On the floor, this mapping is the homography. Above the floor, it corrects
the parallax.

A lens in the spec is used unchanged. If the spec has no lens, the principal point is the middle of
the image, and the focal length f and one distortion coefficient, k1, are fitted together with the
camera's pose. The usual values of lenses are priors of the fit. If the camera looks straight down,
every f fits equally well, and the prior decides.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from tetractl.core.poses import Floats
from tetractl.core.setup import MILLIMETRE_M
from tetractl_microscope.apriltag.section import FloorTag, Lens

# corners of a tag of side 1: top left first, clockwise; x is the direction of reading
SQUARE = np.array([(-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)])
CORNER_PX = 0.1  # standard deviation of a detected corner [px]
MISFIT_TOLERANCE_PX = (
    0.15  # fits that differ less cannot be distinguished: corners are found to about 0.1 px
)


@dataclass(frozen=True, slots=True)
class Plane:
    """A calibrated camera over the floor, which converts pixels to positions.

    Attributes:
        matrix: The camera matrix K, shape (3, 3).
        distortion: OpenCV's distortion coefficients.
        rotation: Rotation R of the camera, shape (3, 3).
        translation: Translation t of the camera [m], shape (3,).
        error_mm: Root mean square of the errors of distances between the floor tags' corners, as
            measured and as in the spec [mm].
        error_max_mm: Largest of these errors [mm].
        lens_error_mm: Position error, at the height of the highest robot's tag, that results if the
            estimated lens is wrong by two standard deviations [mm]. 0 if the lens is given.
    """

    matrix: Floats
    distortion: Floats
    rotation: Floats
    translation: Floats
    error_mm: float = 0.0
    error_max_mm: float = 0.0
    lens_error_mm: float = 0.0

    @property
    def focal_px(self) -> float:
        """Focal length of the lens, in pixels of the image [px]."""
        return float(self.matrix[0, 0])

    @property
    def camera_height_mm(self) -> float:
        """Height of the camera above the floor [mm]."""
        return -float(self.rotation[:, 2] @ self.translation) / MILLIMETRE_M

    def locate(self, pixels: Floats, height: Floats | float = 0.0) -> Floats:
        """Convert pixels to positions at a height above the floor.

        Args:
            pixels: The pixels, shape (..., 2).
            height: The height [m]. Broadcast against the leading dimensions of `pixels`.

        Returns:
            The positions, shape (..., 2) [m].
        """
        flat = pixels.reshape(-1, 1, 2)
        rays = cv2.undistortPoints(flat, self.matrix, self.distortion).reshape(pixels.shape)
        directions = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) @ self.rotation
        camera = -self.rotation.T @ self.translation
        distances = (height - camera[2]) / directions[..., 2]
        return camera[:2] + distances[..., None] * directions[..., :2]

    def height_and_tilt(self, pixels: Floats, side_m: float) -> tuple[float, float] | None:
        """Compute a tag's height above the floor [m] and its tilt against the floor [rad].

        Two tilts may fit a small or distant tag equally well. The smaller tilt is returned.

        Args:
            pixels: The tag's corners [px], shape (4, 2).
            side_m: Its side [m].

        Returns:
            Height and tilt. None if no pose fits.
        """
        square = np.column_stack([side_m * SQUARE, np.zeros(4)])
        _, rotations, translations, errors = cv2.solvePnPGeneric(
            square, pixels, self.matrix, self.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        errors_px = np.ravel(errors)
        stances = [
            self._to_height_and_tilt(np.asarray(rotation, float), np.asarray(translation, float))
            for rotation, translation, misfit in zip(
                rotations, translations, errors_px, strict=True
            )
            if misfit <= errors_px.min() + MISFIT_TOLERANCE_PX
        ]
        return min(stances, key=lambda stance: stance[1], default=None)

    def _to_height_and_tilt(
        self, rotation_vector: Floats, translation: Floats
    ) -> tuple[float, float]:
        """Convert a tag's pose in camera axes to height above the floor [m] and tilt [rad]."""
        offset = self.rotation.T @ (translation.ravel() - self.translation.ravel())
        upward = self.rotation.T @ cv2.Rodrigues(rotation_vector)[0][:, 2]
        tilt = np.arccos(np.clip(upward[2], -1.0, 1.0))
        return float(offset[2]), float(tilt)


def compute_floor_corners(tag: FloorTag, metres: float) -> Floats:
    """Compute the corners of a floor tag in the spec's axes, shape (4, 2) [m].

    `metres` is the length of the spec's unit [m].
    """
    cos = np.cos(tag.heading)
    sin = np.sin(tag.heading)
    rotated = SQUARE @ np.array([(cos, sin), (-sin, cos)])
    return tag.size_mm * MILLIMETRE_M * rotated + metres * np.array(tag.at)


def calibrate_camera(
    pixels: Floats,
    positions_m: Floats,
    size: tuple[int, int],
    lens: Lens | None = None,
    height_max_m: float = 0.0,
) -> Plane:
    """Calibrate a camera: find the pose and the lens with which it sees the floor tags.

    Args:
        pixels: Corners of F floor tags in the image [px], shape (F, 4, 2).
        positions_m: Positions of these corners on the floor [m], shape (F, 4, 2).
        size: Width and height of the image [px].
        lens: The lens. None if it is unknown and must be fitted.
        height_max_m: Maximum height of a robot's tag above the floor [m].
    """
    points = pixels.reshape(-1, 2)
    floor_points = positions_m.reshape(-1, 2)
    centre_px = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    lens_error_mm = 0.0
    if lens is not None:
        matrix = _create_camera_matrix(lens.focal_px, lens.centre or centre_px)
        plane = _find_pose(matrix, np.array(lens.distortion, float), points, floor_points)
    else:
        scaled_lens, deviations = _fit_lens(points, floor_points, size[0], centre_px)
        plane = _find_pose(
            *_convert_scaled_lens(scaled_lens, size[0], centre_px), points, floor_points
        )
        centres = pixels.mean(axis=1)
        # points between the tags, where robots may be
        middles = (centres[:, None] + centres[None]) / 2
        positions = plane.locate(middles, height_max_m)
        for deviation in deviations:
            # a lens that is wrong by two standard deviations
            wrong_plane = _find_pose(
                *_convert_scaled_lens(scaled_lens + 2.0 * deviation, size[0], centre_px),
                points,
                floor_points,
            )
            shifts = np.linalg.norm(wrong_plane.locate(middles, height_max_m) - positions, axis=-1)
            lens_error_mm = math.hypot(lens_error_mm, float(shifts.max()) / MILLIMETRE_M)
    errors_mm = np.linalg.norm(plane.locate(points) - floor_points, axis=-1) / MILLIMETRE_M
    error_mm = float(np.sqrt(np.mean(errors_mm**2)))
    return replace(
        plane, error_mm=error_mm, error_max_mm=float(errors_mm.max()), lens_error_mm=lens_error_mm
    )


def _create_camera_matrix(focal: float, centre: Sequence[float]) -> Floats:
    """Return the camera matrix K for a focal length and a principal point [px]."""
    return np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])


def _convert_scaled_lens(
    scaled_lens: Floats, width: int, centre_px: Sequence[float]
) -> tuple[Floats, Floats]:
    """Convert the scaled parameters of a lens to its camera matrix K and its distortion.

    Args:
        scaled_lens: log(f / width) and k1, each divided by the standard deviation of its prior,
            shape (2,).
        width: Width of the image [px].
        centre_px: Principal point [px].
    """
    # standard deviations among lenses, of log(f / width): 40 to 70 degrees of view, and of k1
    focal = width * math.exp(0.35 * scaled_lens[0])
    k1 = 0.15 * scaled_lens[1]
    return _create_camera_matrix(focal, centre_px), np.array([k1, 0.0, 0.0, 0.0])


def _find_pose(matrix: Floats, distortion: Floats, points: Floats, floor_points: Floats) -> Plane:
    """Find the pose of a camera with a known lens from points on the floor.

    Args:
        matrix: The camera matrix K, shape (3, 3).
        distortion: OpenCV's distortion coefficients.
        points: Pixels of the points, shape (M, 2).
        floor_points: Positions of the points on the floor, shape (M, 2) [m].
    """
    _, rotation_vector, translation = cv2.solvePnP(
        _add_zero_height(floor_points), points, matrix, distortion
    )
    rotation, _ = cv2.Rodrigues(rotation_vector)
    translation_m = translation.ravel().astype(float)
    return Plane(matrix, distortion, rotation.astype(float), translation_m)


def _fit_lens(
    points: Floats, floor_points: Floats, width: int, centre_px: Sequence[float]
) -> tuple[Floats, Floats]:
    """Fit the most probable lens of a camera from points on the floor.

    Args:
        points: Pixels of the points, shape (M, 2).
        floor_points: Positions of the points on the floor, shape (M, 2) [m].
        width: Width of the image [px].
        centre_px: Principal point [px].

    Returns:
        log(f / width) and k1, shape (2,), and their standard deviations, shape (2, 2), all divided
        by the standard deviations of the priors. Each row of the second array is one standard
        deviation along an axis of the error ellipse.
    """
    start_plane = _find_pose(
        *_convert_scaled_lens(np.zeros(2), width, centre_px), points, floor_points
    )
    rotation_vector, _ = cv2.Rodrigues(start_plane.rotation)

    def residuals(pose_and_lens: Floats) -> Floats:
        """Compute the errors of the floor points' pixels for a pose and lens (8,), and of the lens.

        All are in standard deviations.
        """
        pixels, _ = cv2.projectPoints(
            _add_zero_height(floor_points),
            pose_and_lens[:3],
            pose_and_lens[3:6],
            *_convert_scaled_lens(pose_and_lens[6:], width, centre_px),
        )
        return np.append((pixels.reshape(-1, 2) - points).ravel() / CORNER_PX, pose_and_lens[6:])

    initial = np.concatenate([rotation_vector.ravel(), start_plane.translation, np.zeros(2)])
    fit = least_squares(residuals, initial, method="lm", x_scale="jac")
    variances, axes = np.linalg.eigh(np.linalg.inv(fit.jac.T @ fit.jac)[6:, 6:])
    return fit.x[6:], np.sqrt(variances)[:, None] * axes.T


def _add_zero_height(floor_points: Floats) -> Floats:
    """Convert points on the floor (M, 2) to points in space (M, 3) at height 0."""
    return np.column_stack([floor_points, np.zeros(len(floor_points))])


MOVED_PX = 3.0  # a floor tag this far from its mean position, or the camera, has been moved
IMAGES_AVERAGED_MAX = 32  # largest number of pictures over which corners are averaged
MISFIT_MM = 10.0  # larger errors of floor tags mean that a tag's position in the spec is wrong


class Floor:
    """Keeps a camera calibrated by the floor tags that it sees.

    Corners are averaged over up to `IMAGES_AVERAGED_MAX` images, since neither camera nor floor
    tags move. If a corner moves by more than `MOVED_PX`, the calibration is discarded until an
    image shows all floor tags again. A calibration by which a floor tag is more than `MISFIT_MM`
    away from its position in the spec is not used; it is kept in `misfit`.

    Args:
        tags: The floor tags with their positions.
        metres: The spec's length unit [m].
        lens: The lens. None to estimate it.
        height_max_mm: Maximum height of a robot's tag [mm].
    """

    def __init__(
        self, tags: Sequence[FloorTag], metres: float, lens: Lens | None, height_max_mm: float
    ) -> None:
        self.plane: Plane | None = None
        self.misfit: Plane | None = None
        self._numbers = [tag.tag for tag in tags]
        self._positions_m = np.array([compute_floor_corners(tag, metres) for tag in tags])
        self._lens = lens
        self._height_max_m = height_max_mm * MILLIMETRE_M
        self._mean_corners: Floats | None = None  # averaged corners (F, 4, 2) [px]
        self._image_count = 0

    def update(self, corners: Mapping[int, Floats], size: tuple[int, int]) -> None:
        """Update the calibration with the floor tags of an image that are seen exactly once.

        Args:
            corners: The tags' corners (4, 2) [px], by tag number.
            size: Width and height of the image [px].
        """
        corners_by_index = {i: corners[n] for i, n in enumerate(self._numbers) if n in corners}
        if self._mean_corners is not None and any(
            np.abs(tag_corners - self._mean_corners[i]).max() > MOVED_PX
            for i, tag_corners in corners_by_index.items()
        ):
            self._mean_corners = self.plane = self.misfit = None
        if len(corners_by_index) < len(self._numbers):
            return
        newest = np.array([corners_by_index[i] for i in range(len(corners_by_index))])
        if self._mean_corners is None:
            self._mean_corners = newest
            self._image_count = 0
        self._image_count += 1
        self._mean_corners = self._mean_corners + (newest - self._mean_corners) / min(
            self._image_count, IMAGES_AVERAGED_MAX
        )
        if self._image_count % IMAGES_AVERAGED_MAX == 0 or self._image_count.bit_count() == 1:
            plane = calibrate_camera(
                self._mean_corners, self._positions_m, size, self._lens, self._height_max_m
            )
            is_accurate = plane.error_max_mm <= MISFIT_MM
            self.plane, self.misfit = (plane, None) if is_accurate else (None, plane)
