"""How large floor tags are in relation to their distances: a printer that fits pages shrinks both
the tags on a page, not the distances between pages.

The squares' size is fitted together with the camera's pose and, unless the spec gives it, the lens.
An estimated lens would otherwise take half of a wrong size for distortion.
"""

import math

import cv2
import numpy as np
from scipy.optimize import least_squares

from tetractl.core.poses import Floats
from tetractl_microscope.apriltag.floor import CORNER_PX, Plane, lens_of
from tetractl_microscope.apriltag.section import Lens

SURE = 3.0  # standard deviations beyond which noise does not explain a size
RULER_MM = 0.5  # error with which a black square's side is measured by a ruler [mm]
HEIGHT_MM = 5.0  # error with which the height of a robot's tag is known [mm]


def print_scale(
    pixels: Floats, places: Floats, lens: Lens | None, plane: Plane, least_mm: float
) -> float | None:
    """Return the ratio of the size of F floor tags, of which the smallest has a side of `least_mm`,
    to that of the spec; None if noise or a ruler explains it. Their corners are at `places`
    (F, 4, 2) [m] by the spec and in `pixels` (F, 4, 2); the fit starts from the camera `plane`.
    """
    centres = places.mean(axis=1, keepdims=True)
    corners = places - centres
    points = pixels.reshape(-1, 2)
    middle = (float(plane.matrix[0, 2]), float(plane.matrix[1, 2]))
    width = round(2 * middle[0] + 1)  # of the picture [px]; without a lens, that is its middle

    def misfit(x: Floats) -> Floats:
        """Return the errors of the corners' pixels for turn, shift, logarithm of the size and, if
        it is estimated, the lens (7 or 9,), and the lens's own, all in standard deviations."""
        spots = (centres + math.exp(x[6]) * corners).reshape(-1, 2)
        space = np.column_stack([spots, np.zeros(len(spots))])
        usual = x[7:]
        lens_of_picture = (
            (plane.matrix, plane.distortion) if lens else lens_of(usual, width, middle)
        )
        projected, _ = cv2.projectPoints(space, x[:3], x[3:6], *lens_of_picture)
        return np.append((projected.reshape(-1, 2) - points).ravel() / CORNER_PX, usual)

    turn, _ = cv2.Rodrigues(plane.rotation)
    first = np.concatenate([turn.ravel(), plane.shift, np.zeros(1 if lens else 3)])
    fit = least_squares(misfit, first, method="lm", x_scale="jac")
    variance = np.linalg.inv(fit.jac.T @ fit.jac)[6, 6]
    # corners that fit worse than they are found, as in a blurred picture, are found less well
    worse = max(1.0, 2 * fit.cost / (points.size - len(first)))
    ratio = math.exp(fit.x[6])
    is_odd = abs(ratio - 1) > SURE * math.sqrt(variance * worse) + RULER_MM / least_mm
    return ratio if is_odd else None


def odd_robot(ratio: float, side_px: float, size_mm: float, distance_mm: float) -> bool:
    """Return whether neither noise, a ruler nor the tag's height explain the size of a robot's tag.

    `ratio` is the measured side divided by `size_mm`, `side_px` the side in the picture [px], and
    `distance_mm` how far the camera is above the tag [mm].
    """
    noise = CORNER_PX / math.sqrt(2) / side_px  # of a side that is fitted to four corners
    return abs(ratio - 1) > SURE * noise + RULER_MM / size_mm + HEIGHT_MM / distance_mm
