"""Measures how well the live tracker follows real cells, in a film without a known truth.

    python benchmarks/real_films.py FILM --scale UM_PER_PIXEL --organism NAME

The camera `cells` steers with the positions from its tracker. Here the tracker sees the images of a
film. Two measures judge it without a truth:

- **No body**: the fraction of positions that have no body within NEAR_PX. A body that moves is
  where an image, blurred, differs from the film's median by more than a threshold. A body that
  rests for most of the film is part of the median. Therefore, a second count also accepts a body
  that differs from the median of its surroundings, a square with sides of SURROUNDINGS_PX. Bodies
  are darker or lighter. For comparison, the benchmark prints how much of the images' area has no
  body within NEAR_PX. Positions in a blob that several cells share are not counted.
- **Contradicted**: a cell's position and its position LINK_LENGTH images later form a link. A link
  is sure if the tracker gives both of its ends a probability at which the lab steers the cell
  (`KNOWN_PROBABILITY`). The tracker also sees the film backwards. The cell that it shows at the
  second position must also be at the first one. A link is contradicted if that cell is elsewhere,
  by ELSEWHERE_PX or more. Either direction may be wrong, so this is an upper bound. A second count
  takes only links of which both directions are sure. At least one of two sure links that contradict
  each other has a probability that is too high.

The detection of bodies shares no code with the tracker's. The background is learned from the first
seconds of the film, in each direction, as the camera learns it.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from tetractl_microscope.cells.identity_watch import KNOWN_PROBABILITY
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.organisms import Organism, find_organism
from tetractl_microscope.pictures.feed import SourceEndedError
from tetractl_microscope.pictures.picture_section import FileSource
from tetractl_microscope.tracks.field_file import no_field

from tetractl.core.clock import VirtualClock
from tetractl.core.errors import TetractlError
from tetractl.statistics.estimate import proportion_interval

LEARNING_S = 1.5
"""Time from which the background is learned [s]: the default of the camera's `learning`."""
LEARNING_IMAGES = 15
"""Number of images from which the background is computed."""
MEDIAN_IMAGES = 60
"""Number of images from which the film's median is computed."""
NEAR_PX = 6.0
"""Maximum distance from a position to its body [px]."""
SURROUNDINGS_PX = 61
"""Side of the square with which a resting body is compared [px]."""
LINKED_PX = 8.0
"""Distance below which positions of both directions show the same cell [px]."""
ELSEWHERE_PX = 20.0
"""Distance from which on a link is contradicted [px]."""
LINK_STRIDE = 3
"""Links begin at every third image of a cell."""
LINK_LENGTH = 30
"""Length of a link [images]."""

IMAGE, NUMBER, COLUMN, ROW, IS_SURE, IS_FOUND = range(6)
"""Columns of a table of positions, one row for each cell in each image."""


def read_film(path: Path, rate_hz: float | None) -> tuple[list[np.ndarray], float]:
    """Read the images of a film as grey levels, and its rate [Hz]."""
    source = FileSource(type="file", path=str(path), rate=rate_hz)
    feed = source.open(VirtualClock(), 1.0)
    images = []
    try:
        while True:
            images.append(feed.read().content)
    except SourceEndedError:
        feed.close()
    return images, feed.rate_hz


def track_cells(
    images: Sequence[np.ndarray], rate_hz: float, um_px: float, organism: Organism
) -> np.ndarray:
    """Run the live tracker on a film.

    Args:
        images: The images of the film, in the order in which the tracker sees them.
        rate_hz: Rate of the film [Hz].
        um_px: Scale of the images [um/px].
        organism: The cells' organism.

    Returns:
        The positions at which the tracker sees cells, shape (N, 6), in the columns named above.
    """
    tracker = CellTracker(um_px, field_known=False, organism=organism)
    learning_images = images[: max(LEARNING_IMAGES, round(LEARNING_S * rate_hz))]
    tracker.finder.learn(list(learning_images[:: max(1, len(learning_images) // LEARNING_IMAGES)]))
    rows = []
    for number, image in enumerate(images):
        for cell in tracker.track_image(image, number / rate_hz, no_field):
            column = cell.x / um_px - 0.5
            row = len(image) - 0.5 - cell.y / um_px
            is_found = cell.has_blob and not cell.merged
            rows.append(
                (
                    number,
                    cell.identity,
                    column,
                    row,
                    cell.probability >= KNOWN_PROBABILITY,
                    is_found,
                )
            )
    return np.array(rows, float).reshape(-1, 6)


class Bodies(NamedTuple):
    """Masks of the bodies that each image shows.

    Attributes:
        moving: Bodies that move.
        any: Bodies that move or rest.
    """

    moving: list[np.ndarray]
    any: list[np.ndarray]


def find_bodies(images: Sequence[np.ndarray], threshold: float) -> Bodies:
    """Find the bodies in each image.

    Args:
        images: The images of the film.
        threshold: How much a body differs from what is behind or around it [grey levels].
    """
    step = max(1, len(images) // MEDIAN_IMAGES)
    background = np.median(np.array(images[::step]), axis=0).astype(np.float32)
    bodies = Bodies([], [])
    for image in images:
        moving = _mask_difference(image, background, threshold)
        surroundings = cv2.medianBlur(image, SURROUNDINGS_PX)
        bodies.moving.append(moving)
        bodies.any.append(moving | _mask_difference(image, surroundings, threshold))
    return bodies


def _mask_difference(image: np.ndarray, reference: np.ndarray, threshold: float) -> np.ndarray:
    """Create a mask of where two images differ by more than a threshold, without single pixels."""
    difference = cv2.GaussianBlur(image.astype(np.float32) - reference, (3, 3), 0)
    mask = (np.abs(difference) > threshold).astype(np.uint8)
    return cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))


def fraction_without_body(bodies: Sequence[np.ndarray]) -> float:
    """Compute the fraction of the images' area that has no body within NEAR_PX."""
    distances_px = [cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) for mask in bodies]
    return float(np.mean([(gaps > NEAR_PX).mean() for gaps in distances_px]))


def count_without_body(rows: np.ndarray, bodies: Sequence[np.ndarray]) -> tuple[int, int]:
    """Count the positions that are outside of the image or have no body within NEAR_PX.

    Args:
        rows: The positions, shape (N, 6).
        bodies: Masks of the bodies, one for each image.

    Returns:
        The number of these positions, and the number of all positions.
    """
    with_blob = rows[rows[:, IS_FOUND] > 0]
    missing_count = 0
    for number in np.unique(with_blob[:, IMAGE]).astype(int).tolist():
        distance_px = cv2.distanceTransform(1 - bodies[number], cv2.DIST_L2, 5)
        height, width = distance_px.shape
        in_image = with_blob[with_blob[:, IMAGE] == number]
        for x, y in in_image[:, [COLUMN, ROW]].astype(int).tolist():
            is_inside = 0 <= x < width and 0 <= y < height
            missing_count += not is_inside or distance_px[y, x] > NEAR_PX
    return int(missing_count), len(with_blob)


class Links(NamedTuple):
    """Counts of the sure links whose two ends the reverse film shows, too.

    Attributes:
        sure: Number of these links.
        contradicted: Number of links that the reverse film contradicts.
        both_sure: Number of links that are sure in both directions.
        both_contradicted: Number of links that are sure in both directions but contradicted.
    """

    sure: int
    contradicted: int
    both_sure: int
    both_contradicted: int


def check_links(forwards: np.ndarray, backwards: np.ndarray, count: int) -> Links:
    """Compare the sure links of a film with what the tracker shows in the reversed film.

    Args:
        forwards: Positions in the film, shape (N, 6).
        backwards: Positions in the reversed film, shape (M, 6).
        count: Number of images of the film.
    """
    reversed_film = backwards.copy()
    reversed_film[:, IMAGE] = count - 1 - reversed_film[:, IMAGE]
    reverse_by_cell = _group_by_cell(reversed_film)
    reverse_by_image = defaultdict[int, list[np.ndarray]](list)
    for row in reversed_film:
        reverse_by_image[int(row[IMAGE])].append(row)
    links = []
    for rows_of_cell in _group_by_cell(forwards).values():
        for number in list(rows_of_cell)[::LINK_STRIDE]:
            first_row = rows_of_cell[number]
            second_row = rows_of_cell.get(number + LINK_LENGTH)
            if second_row is None or not (first_row[IS_SURE] and second_row[IS_SURE]):
                continue
            nearest = min(
                reverse_by_image[number], key=lambda row: _distance_px(row, first_row), default=None
            )
            if nearest is None or _distance_px(nearest, first_row) >= LINKED_PX:
                continue
            row_of_reverse = reverse_by_cell[nearest[NUMBER]].get(number + LINK_LENGTH)
            if row_of_reverse is not None:
                is_wrong = _distance_px(row_of_reverse, second_row) >= ELSEWHERE_PX
                links.append((is_wrong, bool(nearest[IS_SURE] and row_of_reverse[IS_SURE])))
    return Links(
        sure=len(links),
        contradicted=sum(is_wrong for is_wrong, _ in links),
        both_sure=sum(is_both_sure for _, is_both_sure in links),
        both_contradicted=sum(is_wrong and is_both_sure for is_wrong, is_both_sure in links),
    )


def _group_by_cell(rows: np.ndarray) -> dict[float, dict[int, np.ndarray]]:
    """Group positions by cell and by image: the row of a cell in each image."""
    by_number: dict[float, dict[int, np.ndarray]] = {}
    for row in rows:
        by_number.setdefault(row[NUMBER], {})[int(row[IMAGE])] = row
    return by_number


def _distance_px(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.hypot(*(first[[COLUMN, ROW]] - second[[COLUMN, ROW]])))


def format_fraction(successes: int, count: int) -> str:
    """Format a fraction with its 95 % interval."""
    if not count:
        return "none"
    interval = proportion_interval(successes, count)
    return f"{successes} of {count} ({100 * interval.low:.1f} to {100 * interval.high:.1f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("--scale", type=float, required=True, help="micrometres per pixel")
    parser.add_argument("--rate", type=float, help="images per second, if the film states none")
    parser.add_argument("--organism", default="tetrahymena")
    parser.add_argument("--threshold", type=float, default=8.0, help="grey levels of a body")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    try:
        images, rate_hz = read_film(chosen.film, chosen.rate)
        organism = find_organism(chosen.organism)
    except TetractlError as error:
        sys.exit(f"error: {error.message}")
    forwards, backwards = (
        track_cells(film_images, rate_hz, chosen.scale, organism)
        for film_images in (images, images[::-1])
    )
    bodies = find_bodies(images, chosen.threshold)
    links = check_links(forwards, backwards, len(images))
    cells = len(np.unique(forwards[:, NUMBER]))
    print(f"{chosen.film.name}: {len(images)} images at {rate_hz:g} Hz, {cells} numbers")
    for label, rows in (
        ("positions", forwards),
        ("sure positions", forwards[forwards[:, IS_SURE] > 0]),
    ):
        without_moving = format_fraction(*count_without_body(rows, bodies.moving))
        without_any = format_fraction(*count_without_body(rows, bodies.any))
        print(f"{label} without a body that moves: {without_moving}")
        print(f"{label} without any body: {without_any}")
    areas_without = fraction_without_body(bodies.moving), fraction_without_body(bodies.any)
    print("area without a body that moves: {:.0%}, without any body: {:.0%}".format(*areas_without))
    print(f"sure links contradicted: {format_fraction(links.contradicted, links.sure)}")
    print(
        "links sure in both directions, contradicted: "
        f"{format_fraction(links.both_contradicted, links.both_sure)}"
    )


if __name__ == "__main__":
    main()
