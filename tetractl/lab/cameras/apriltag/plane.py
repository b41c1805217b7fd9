"""The floor in front of the camera: from pixels to positions on planes parallel to the floor.

The camera is a pinhole, x = K (R X + t) up to scale, with square pixels. A pixel is a ray, once
distortion is removed, and a tag h above the floor is where its ray meets the plane z = h. On the
floor itself this is the homography; above it, it corrects the parallax.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tetractl.core.poses import Floats
from tetractl.core.setup import MM
from tetractl.lab.cameras.apriltag.section import FloorTag

# A tag's corners, in sides of the tag: top left first, clockwise; x is the direction of reading.
SQUARE = np.array([(-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)])

ALIKE_PX = 0.1  # two fits that differ by less cannot be distinguished


@dataclass(frozen=True, slots=True)
class Plane:
    """A calibrated camera over the floor.

    `matrix` is K (3, 3), `distortion` OpenCV's coefficients, `rotation` R (3, 3) and `shift` t (3,)
    [m]. `error_mm` is the root mean square, and `worst_mm` the largest, of the distances between
    the floor tags' corners as seen and as the spec puts them. `doubt_mm` is how far robots at the
    height of the highest tag may be off, by two standard deviations of what is estimated of the
    lens.
    """

    matrix: Floats
    distortion: Floats
    rotation: Floats
    shift: Floats
    error_mm: float = 0.0
    worst_mm: float = 0.0
    doubt_mm: float = 0.0

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return float(self.matrix[0, 0])

    def locate(self, pixels: Floats, height: Floats | float = 0.0) -> Floats:
        """Return where pixels (..., 2) lie on the plane `height` [m] above the floor, (..., 2) [m].

        `height` broadcasts against the pixels' leading shape.
        """
        flat = pixels.reshape(-1, 1, 2)
        rays = cv2.undistortPoints(flat, self.matrix, self.distortion).reshape(pixels.shape)
        ahead = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) @ self.rotation
        camera = -self.rotation.T @ self.shift
        reach = (height - camera[2]) / ahead[..., 2]
        return camera[:2] + reach[..., None] * ahead[..., :2]

    def stance(self, pixels: Floats, side: float) -> tuple[float, float] | None:
        """Return the height above the floor [m] and the tilt [rad] of a tag.

        `pixels` (4, 2) are the corners of the tag, of side `side` [m]. A small square seen from
        afar may fit two tilts: the smaller is returned. None if none is found.
        """
        square = np.column_stack([side * SQUARE, np.zeros(4)])
        _, turns, shifts, errors = cv2.solvePnPGeneric(
            square, pixels, self.matrix, self.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        misfits = np.ravel(errors)
        found = [
            self._upright(np.asarray(turn, float), np.asarray(shift, float))
            for turn, shift, misfit in zip(turns, shifts, misfits, strict=True)
            if misfit <= misfits.min() + ALIKE_PX
        ]
        return min(found, key=lambda each: each[1], default=None)

    def _upright(self, turn: Floats, shift: Floats) -> tuple[float, float]:
        """Return height [m] and tilt [rad] of a body turned and shifted in the camera's axes."""
        place = self.rotation.T @ (shift.ravel() - self.shift.ravel())
        upward = self.rotation.T @ cv2.Rodrigues(turn)[0][:, 2]
        return float(place[2]), float(np.arccos(np.clip(upward[2], -1.0, 1.0)))


def placed(tag: FloorTag, metres: float) -> Floats:
    """Return the corners of a floor tag on the floor, (4, 2) [m]."""
    cos, sin = np.cos(tag.heading), np.sin(tag.heading)
    turned = SQUARE @ np.array([(cos, sin), (-sin, cos)])
    return tag.size_mm * MM * turned + metres * np.array(tag.at)
