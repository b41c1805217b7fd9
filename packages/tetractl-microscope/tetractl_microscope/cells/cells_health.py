"""Checks a microscope's images of cells for problems with light, focus and cells. No I/O."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tetractl.core.poses import GreyImage, Pose
from tetractl_microscope.cells.cell import SeenCell
from tetractl_microscope.cells.detect_cells import Light
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.cells.robot_cells import RobotCells
from tetractl_microscope.pictures.searches import PictureSearch, drop_none

DARK_LEVEL = 12.0  # median grey level at which a picture is too dark
SATURATED_LEVEL = 245.0  # median grey level at which an image is too bright
# Ratio of the cells' contrast to the minimum for detection, below which some cells are missed.
FAINT_RATIO = 1.5
# Minimum sharpness of cells' edges, 1 / width [1/px], without a warning. Rendered cells in focus
# have 0.4, and cells blurred by a Gaussian of 3 px have 0.15.
SHARPNESS_MIN = 0.15
SHARPNESS_CELLS = 8  # maximum number of cells whose edges are measured
SHARPNESS_REACH = 0.7  # half the side of the square that is examined around a cell [its lengths]
SHARPNESS_SIDE_PX = 6  # minimum side of this square within the image
STEEPEST_QUANTILE = 0.98  # quantile of the slopes in the square that counts as the steepest slope
SOBEL_WEIGHT = 8  # factor by which Sobel's operator multiplies the slope
WIDTH_MIN_PX = 8.0  # minimum width of a cell in an image without a warning


@dataclass(frozen=True, slots=True)
class SeenDish:
    """The result of searching one image for cells.

    Attributes:
        robots: The cells that were the robots at that time.
        poses: Pose of each robot. None if it is untracked.
        unknown_objects: Poses of other cells.
        light: Brightness, noise and contrast of the image.
        level: Median grey level.
        sharpness: Sharpness of the cells' edges [1/px]. None if unknown.
        certainty_min: Minimum probability of the identity of a robot in view. 0 if none is in view.
    """

    robots: RobotCells
    poses: tuple[Pose | None, ...]
    unknown_objects: tuple[Pose, ...]
    light: Light
    level: float
    sharpness: float | None
    certainty_min: float


def measure_sharpness(
    picture: GreyImage, cells: Sequence[SeenCell], um_px: float, contrast: float | None
) -> float | None:
    """Measure the sharpness of an image at the edges of its cells [1/px].

    It is the median, over the first cells, of the steepest slope of grey levels in any direction,
    divided by the cells' contrast.

    Args:
        picture: The image.
        cells: The cells in it.
        um_px: Scale of the image [um/px].
        contrast: Contrast of the cells [grey levels]. None if unknown.

    Returns:
        The sharpness. None without contrast, or if no cell is large enough.
    """
    if not contrast:
        return None
    steepest_slopes = list[float]()
    for cell in cells[:SHARPNESS_CELLS]:
        column = round(cell.x / um_px)
        row = round(picture.shape[0] - cell.y / um_px)
        reach = round(SHARPNESS_REACH * cell.long_um / um_px)
        region = picture[max(0, row - reach) : row + reach, max(0, column - reach) : column + reach]
        if min(region.shape) > SHARPNESS_SIDE_PX:
            along_rows = cv2.Sobel(region, cv2.CV_32F, 1, 0)
            along_columns = cv2.Sobel(region, cv2.CV_32F, 0, 1)
            slopes = np.hypot(along_rows, along_columns) / SOBEL_WEIGHT
            steepest_slopes.append(float(np.quantile(slopes, STEEPEST_QUANTILE)) / contrast)
    return statistics.median(steepest_slopes) if steepest_slopes else None


def find_problems(
    names: Sequence[str], searches: Sequence[PictureSearch[SeenDish]], width_px: float
) -> tuple[list[str], list[str]]:
    """Find problems and warnings about light, focus and cells in a camera's newest images.

    Args:
        names: Names of the robots.
        searches: The searches of the images, oldest first.
        width_px: Width of a cell [px].

    Returns:
        Problems and warnings. Both are empty if there are no images.
    """
    if not searches:
        return [], []
    newest = searches[-1].result
    problems = list[str]()
    warnings = list[str]()
    level = statistics.median(search.result.level for search in searches)
    if level < DARK_LEVEL:
        problems.append(f"the image is black (median {level:.0f} of 255): is the lamp on?")
    elif level > SATURATED_LEVEL:
        problems.append(
            f"the image is saturated (median {level:.0f} of 255): use less light or a shorter "
            "exposure"
        )
    if newest.light.lost:
        changed_percent = 100 * newest.light.changed_fraction
        problems.append(
            f"{changed_percent:.0f} % of the image differs from the background: was the stage or "
            "the lamp moved? Start again"
        )
    untracked = [name for name, pose in zip(names, newest.poses, strict=True) if pose is None]
    if untracked:
        problems.append(
            f"the camera does not track {', '.join(untracked)}: {count_cells(searches)} cells are "
            f"in view, but {len(names)} are needed"
        )
    elif newest.certainty_min < KNOWN_PROBABILITY:
        warnings.append(
            "cells have met, and it is uncertain which cell is which: let the field turn a few "
            "times"
        )
    contrasts = drop_none(search.result.light.contrast for search in searches)
    contrast = statistics.median(contrasts) if contrasts else None
    faint_warning = describe_faint_cells(contrast, newest.light.contrast_min)
    if faint_warning is not None and not newest.light.lost:
        warnings.append(faint_warning)
    sharpnesses = drop_none(search.result.sharpness for search in searches)
    if sharpnesses and statistics.median(sharpnesses) < SHARPNESS_MIN:
        warnings.append(
            "the outlines of the cells are blurred: focus the microscope, or shorten the exposure"
        )
    if width_px < WIDTH_MIN_PX:
        warnings.append(
            f"a cell is only {width_px:.0f} px wide, but at least {WIDTH_MIN_PX:.0f} px are needed"
        )
    return problems, warnings


def describe_faint_cells(contrast: float | None, contrast_min: float) -> str | None:
    """Warn if the contrast of objects is so low that cells may be missed.

    Args:
        contrast: Median contrast of the objects [grey levels]. None without objects.
        contrast_min: Minimum contrast at which an object is found [grey levels].

    Returns:
        The warning. None if the contrast is high enough.
    """
    if contrast is None:
        problem = (
            f"no object differs from the medium by {contrast_min:.0f} grey levels, the minimum for "
            "detection"
        )
    elif contrast < FAINT_RATIO * contrast_min:
        problem = (
            f"objects differ from the medium by a median of {contrast:.0f} grey levels, and "
            f"objects below {contrast_min:.0f} are missed"
        )
    else:
        return None
    return f"{problem}: use more light, a smaller aperture or phase contrast"


def count_cells(searches: Sequence[PictureSearch[SeenDish]]) -> int:
    """Compute the median number of cells in view over one or more images, as a whole number.

    Cells of robots that are not tracked are not counted.
    """
    dishes = [search.result for search in searches]
    counts = [
        len(dish.unknown_objects) + len(dish.poses) - dish.poses.count(None) for dish in dishes
    ]
    return round(statistics.median(counts))
