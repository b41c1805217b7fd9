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
- **Contradicted**: a cell's position and its position LINK images later form a link. A link is sure
  if the tracker gives both of its ends a probability at which the lab steers the cell
  (`identity_watch.SURE`). The tracker also sees the film backwards. The cell that it shows at the
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
from tetractl_microscope.cells.identity_watch import SURE
from tetractl_microscope.cells.tracking import CellTracker
from tetractl_microscope.organisms import Organism, named
from tetractl_microscope.pictures.feed import SourceEndedError
from tetractl_microscope.pictures.picture_section import FileSource
from tetractl_microscope.tracks.field_file import no_field

from tetractl.core.clock import VirtualClock
from tetractl.core.errors import TetractlError
from tetractl.statistics.estimate import proportion_interval

LEARNING_S = 1.5  # the default of the camera's `learning` [s]
LEARNED = 15  # images from which the background is computed
MEDIAN_OF = 60  # images of the film's median
NEAR_PX = 6.0  # distance to a body of a position that has one
SURROUNDINGS_PX = 61  # side of the square with which a resting body is compared
LINKED_PX = 8.0  # distance at which positions of both directions show the same cell
ELSEWHERE_PX = 20.0
EVERY = 3  # every third image is examined for links
LINK = 30  # length of a link [images]

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


def followed(
    images: Sequence[np.ndarray], rate_hz: float, um_px: float, organism: Organism
) -> np.ndarray:
    """Run the live tracker, and return the positions at which it sees cells, shape (N, 6)."""
    tracker = CellTracker(um_px, field_known=False, organism=organism)
    first = images[: max(LEARNED, round(LEARNING_S * rate_hz))]
    tracker.finder.learn(list(first[:: max(1, len(first) // LEARNED)]))
    rows = []
    for number, image in enumerate(images):
        for cell in tracker.see(image, number / rate_hz, no_field):
            column = cell.x / um_px - 0.5
            row = len(image) - 0.5 - cell.y / um_px
            is_found = cell.has_blob and not cell.merged
            rows.append((number, cell.identity, column, row, cell.probability >= SURE, is_found))
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
    step = max(1, len(images) // MEDIAN_OF)
    background = np.median(np.array(images[::step]), axis=0).astype(np.float32)
    bodies = Bodies([], [])
    for image in images:
        moving = _differs(image, background, threshold)
        surroundings = cv2.medianBlur(image, SURROUNDINGS_PX)
        bodies.moving.append(moving)
        bodies.any.append(moving | _differs(image, surroundings, threshold))
    return bodies


def _differs(image: np.ndarray, other: np.ndarray, threshold: float) -> np.ndarray:
    """Return where two images differ by more than a threshold, without single pixels."""
    difference = cv2.GaussianBlur(image.astype(np.float32) - other, (3, 3), 0)
    mask = (np.abs(difference) > threshold).astype(np.uint8)
    return cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))


def area_without(bodies: Sequence[np.ndarray]) -> float:
    """Return the fraction of the images' area that has no body near."""
    away = [cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) for mask in bodies]
    return float(np.mean([(gaps > NEAR_PX).mean() for gaps in away]))


def no_body(rows: np.ndarray, bodies: Sequence[np.ndarray]) -> tuple[int, int]:
    """Count the positions without a near body or outside the image, and all positions."""
    found = rows[rows[:, IS_FOUND] > 0]
    without = 0
    for number in np.unique(found[:, IMAGE]).astype(int).tolist():
        away = cv2.distanceTransform(1 - bodies[number], cv2.DIST_L2, 5)
        height, width = away.shape
        in_image = found[found[:, IMAGE] == number]
        for x, y in in_image[:, [COLUMN, ROW]].astype(int).tolist():
            is_inside = 0 <= x < width and 0 <= y < height
            without += not is_inside or away[y, x] > NEAR_PX
    return int(without), len(found)


class Links(NamedTuple):
    """Counts of sure links of which the reverse film shows both ends.

    Attributes:
        sure: The links.
        contradicted: Those that the reverse contradicts.
        both_sure: The links that are sure in both directions.
        both_contradicted: Those of them that the reverse contradicts.
    """

    sure: int
    contradicted: int
    both_sure: int
    both_contradicted: int


def check_links(forwards: np.ndarray, backwards: np.ndarray, count: int) -> Links:
    """Compare the sure links of a film of `count` images with what its reverse shows."""
    turned = backwards.copy()
    turned[:, IMAGE] = count - 1 - turned[:, IMAGE]
    reverse_of = _by_number(turned)
    reverse_in = defaultdict[int, list[np.ndarray]](list)
    for row in turned:
        reverse_in[int(row[IMAGE])].append(row)
    links = []
    for places in _by_number(forwards).values():
        for number in list(places)[::EVERY]:
            first = places[number]
            second = places.get(number + LINK)
            if second is None or not (first[IS_SURE] and second[IS_SURE]):
                continue
            nearest = min(reverse_in[number], key=lambda row: _apart(row, first), default=None)
            if nearest is None or _apart(nearest, first) >= LINKED_PX:
                continue
            there = reverse_of[nearest[NUMBER]].get(number + LINK)
            if there is not None:
                is_wrong = _apart(there, second) >= ELSEWHERE_PX
                links.append((is_wrong, bool(nearest[IS_SURE] and there[IS_SURE])))
    return Links(
        sure=len(links),
        contradicted=sum(is_wrong for is_wrong, _ in links),
        both_sure=sum(both for _, both in links),
        both_contradicted=sum(is_wrong and both for is_wrong, both in links),
    )


def _by_number(rows: np.ndarray) -> dict[float, dict[int, np.ndarray]]:
    """Group the rows of each cell by image."""
    by_number: dict[float, dict[int, np.ndarray]] = {}
    for row in rows:
        by_number.setdefault(row[NUMBER], {})[int(row[IMAGE])] = row
    return by_number


def _apart(row: np.ndarray, other: np.ndarray) -> float:
    return float(np.hypot(*(row[[COLUMN, ROW]] - other[[COLUMN, ROW]])))


def share(hits: int, count: int) -> str:
    """Format a fraction with its 95 % interval."""
    if not count:
        return "none"
    ends = proportion_interval(hits, count)
    return f"{hits} of {count} ({100 * ends.low:.1f} to {100 * ends.high:.1f} %)"


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
        organism = named(chosen.organism)
    except TetractlError as error:
        sys.exit(f"error: {error.message}")
    forwards, backwards = (
        followed(way, rate_hz, chosen.scale, organism) for way in (images, images[::-1])
    )
    bodies = find_bodies(images, chosen.threshold)
    links = check_links(forwards, backwards, len(images))
    cells = len(np.unique(forwards[:, NUMBER]))
    print(f"{chosen.film.name}: {len(images)} images at {rate_hz:g} Hz, {cells} numbers")
    for kind, rows in (
        ("positions", forwards),
        ("sure positions", forwards[forwards[:, IS_SURE] > 0]),
    ):
        print(f"{kind} without a body that moves: {share(*no_body(rows, bodies.moving))}")
        print(f"{kind} without any body: {share(*no_body(rows, bodies.any))}")
    without = area_without(bodies.moving), area_without(bodies.any)
    print("area without a body that moves: {:.0%}, without any body: {:.0%}".format(*without))
    print(f"sure links contradicted: {share(links.contradicted, links.sure)}")
    print(
        "links sure in both directions, contradicted: "
        f"{share(links.both_contradicted, links.both_sure)}"
    )


if __name__ == "__main__":
    main()
