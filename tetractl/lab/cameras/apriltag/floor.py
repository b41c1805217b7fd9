"""Pose and lens of the camera, from the corners of the floor tags in its pictures.

A lens in the spec is used as given. Without one, the principal point is the picture's middle, and
the focal length f and one coefficient of distortion, k1, are fitted with the pose. The usual values
of lenses are priors of the fit: looking straight down, any f fits, and the prior decides.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
from scipy.optimize import least_squares

from tetractl.core.poses import Floats
from tetractl.lab.cameras.apriltag.plane import MM, Plane, placed
from tetractl.lab.cameras.apriltag.section import FloorTag, Lens

USUAL_FOCAL = 0.35  # deviation of log(f / width) among lenses: 40 to 70 degrees of view
USUAL_BEND = 0.15  # deviation of k1 among lenses
CORNER_PX = 0.1  # deviation of a corner as found
SURE = 2.0  # deviations


def calibrated(
    pixels: Floats,
    places: Floats,
    size: tuple[int, int],
    lens: Lens | None = None,
    highest: float = 0.0,
) -> Plane:
    """Return the plane on which corners (F, 4, 2) [px] lie at positions (F, 4, 2) [m].

    `size` is the picture's width and height, `highest` the height for `doubt_mm` [m].
    """
    points, spots = pixels.reshape(-1, 2), places.reshape(-1, 2)
    middle = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    doubt = 0.0
    if lens is not None:
        matrix = _matrix(lens.focal_px, lens.centre or middle)
        plane = _posed(matrix, np.array(lens.distortion, float), points, spots)
    else:
        usual, deviations = _fitted(points, spots, size[0], middle)
        plane = _posed(*_lens(usual, size[0], middle), points, spots)
        centres = pixels.mean(axis=1)
        between = (centres[:, None] + centres[None]) / 2  # where robots may be
        here = plane.locate(between, highest)
        for deviation in deviations:
            other = _posed(*_lens(usual + SURE * deviation, size[0], middle), points, spots)
            gaps = np.linalg.norm(other.locate(between, highest) - here, axis=-1)
            doubt = math.hypot(doubt, float(gaps.max()) / MM)
    off = np.linalg.norm(plane.locate(points) - spots, axis=-1) / MM
    error = float(np.sqrt(np.mean(off**2)))
    return replace(plane, error_mm=error, worst_mm=float(off.max()), doubt_mm=doubt)


def _matrix(focal: float, centre: Sequence[float]) -> Floats:
    return np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])


def _lens(usual: Floats, width: int, middle: Sequence[float]) -> tuple[Floats, Floats]:
    """Return the matrix and the distortion of log(f / width) and k1 in their usual deviations."""
    focal, bend = width * math.exp(USUAL_FOCAL * usual[0]), USUAL_BEND * usual[1]
    return _matrix(focal, middle), np.array([bend, 0.0, 0.0, 0.0])


def _posed(matrix: Floats, distortion: Floats, points: Floats, spots: Floats) -> Plane:
    """Return the plane of known intrinsics on which points (M, 2) [px] lie at spots (M, 2) [m]."""
    _, turn, shift = cv2.solvePnP(_flat(spots), points, matrix, distortion)
    rotation, _ = cv2.Rodrigues(turn)
    return Plane(matrix, distortion, rotation.astype(float), shift.ravel().astype(float))


def _fitted(
    points: Floats, spots: Floats, width: int, middle: Sequence[float]
) -> tuple[Floats, Floats]:
    """Return the most probable log(f / width) and k1 (2,) and their deviations (2, 2).

    Both are in their usual deviations. Each row of the deviations is one standard deviation, in a
    direction in which it is independent of the other.
    """
    start = _posed(*_lens(np.zeros(2), width, middle), points, spots)
    turn, _ = cv2.Rodrigues(start.rotation)

    def projected(x: Floats) -> tuple[Floats, Floats]:
        """Pixels of the spots for pose and lens x (8,), and their slopes (2M, 8)."""
        matrix, distortion = _lens(x[6:], width, middle)
        pixels, slopes = cv2.projectPoints(_flat(spots), x[:3], x[3:6], matrix, distortion)
        # columns: turn, shift, fx, fy, cx, cy, k1, ...; f = fx = fy
        focal = USUAL_FOCAL * matrix[0, 0] * (slopes[:, 6] + slopes[:, 7])
        columns = np.column_stack([slopes[:, :6], focal, USUAL_BEND * slopes[:, 10]])
        return pixels.reshape(-1, 2).astype(float), columns.astype(float)

    def misfit(x: Floats) -> Floats:
        return np.append((projected(x)[0] - points).ravel() / CORNER_PX, x[6:])

    def slope(x: Floats) -> Floats:
        return np.vstack([projected(x)[1] / CORNER_PX, np.eye(8)[6:]])

    first = np.concatenate([turn.ravel(), start.shift, np.zeros(2)])
    fit = least_squares(misfit, first, cast(Any, slope), method="lm", x_scale="jac")
    variances, axes = np.linalg.eigh(np.linalg.inv(fit.jac.T @ fit.jac)[6:, 6:])
    return fit.x[6:], np.sqrt(variances)[:, None] * axes.T


def _flat(spots: Floats) -> Floats:
    """Return points on the floor (M, 2) as points in space (M, 3)."""
    return np.column_stack([spots, np.zeros(len(spots))])


MOVED_PX = 3.0  # a floor tag this far from its mean was moved, or the camera was
AVERAGED = 32  # pictures
MISFIT_MM = 10.0  # floor tags further off than this are not where the spec puts them


class Floor:
    """Keeps the plane calibrated from the floor tags while they are seen.

    The corners are averaged over some pictures, since neither the camera nor a floor tag moves. If
    one does, by `MOVED_PX`, the plane is given up until all floor tags are seen in one picture
    again; a plane on which they do not lie as the spec says, by `MISFIT_MM`, is not used.
    """

    def __init__(
        self, tags: Sequence[FloorTag], metres: float, lens: Lens | None, highest_mm: float
    ) -> None:
        self.plane: Plane | None = None
        self.misfit: Plane | None = None
        self._numbers = [tag.tag for tag in tags]
        self._places = np.array([placed(tag, metres) for tag in tags])  # (F, 4, 2) m
        self._lens, self._highest = lens, highest_mm * MM
        self._mean: Floats | None = None
        self._count = 0

    def see(self, corners: Mapping[int, Floats], size: tuple[int, int]) -> None:
        """Account for the floor tags of one picture: corners (4, 2) [px] by tag, each seen once.

        `size` is the picture's width and height.
        """
        seen = {i: corners[n] for i, n in enumerate(self._numbers) if n in corners}
        if self._mean is not None and any(
            np.abs(each - self._mean[i]).max() > MOVED_PX for i, each in seen.items()
        ):
            self._mean = self.plane = self.misfit = None
        if len(seen) < len(self._numbers):
            return
        now = np.array([seen[i] for i in range(len(seen))])
        if self._mean is None:
            self._mean, self._count = now, 0
        self._count += 1
        self._mean = self._mean + (now - self._mean) / min(self._count, AVERAGED)
        if self._count % AVERAGED == 0 or self._count.bit_count() == 1:
            plane = calibrated(self._mean, self._places, size, self._lens, self._highest)
            fits = plane.worst_mm <= MISFIT_MM
            self.plane, self.misfit = (plane, None) if fits else (None, plane)
