"""What a film says of a tracker without a truth: three measures of rows in pictures.

- **No body**: the share of rows called found, and not merged with others, with no body within
  NEAR_PX. Bodies are where a picture, blurred, differs from the film's median by more than a
  threshold.
- **Contradicted**: a row and that of the same number so many pictures later are a link. In the film
  run backwards the number that is at the second place must be at the first one, too; the share of
  links for which it is elsewhere, by more than ELSEWHERE_PX, among those whose ends it shows. A
  wrong number may be the one of the film run forwards or that of the other: either counts.
- **Followed**: the share of bodies that move, some STEP pictures before and after, with a row
  within REACH_PX.

Detection shares no code with the tracker's. A body that rests for most of the film is in the median
and so is none. Rows are (N, 6): picture, number, column, row, sure, found.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from tetractl_microscope.cells.picture_now import pixels_of
from tetractl_microscope.film.fit_cell import fit_cells
from tetractl_microscope.film.follow import Followed, follow
from tetractl_microscope.film.pictures import open_film
from tetractl_microscope.organisms import Organism, named

from .in_memory import FilmInMemory
from .peers import trackpy_rows
from .rows import share

MEDIAN_OF = 60  # pictures of the film's median
NEAR_PX = 6.0  # distance from a body of a row that has one
LINKED_PX = 8.0  # distance at which rows of both directions show the same cell
ELSEWHERE_PX = 20.0
EVERY = 3  # every third picture is examined
PICTURES = 30  # length of a link
REACH_PX = 8.0
STEP = 5
RESTS = 0.6  # share of a body's pixels that are a body's before and after, above which it rests
FAST = 1.5  # factor by which trackpy lets a cell be faster than its organism


@dataclass(slots=True)
class Counts:
    """Counts (hits, all) of one tracker on one film."""

    no_body: tuple[int, int]
    contradicted: tuple[int, int]
    sure_contradicted: tuple[int, int]
    followed: tuple[int, int]


def report(
    path: Path, name: str, rate_hz: float | None, um_px: float | None, threshold: float
) -> None:
    """Print the measures of tetractl and, if it is installed, trackpy on a film of the organism
    with a name.
    """
    organism = named(name)
    film = open_film(path, rate_hz, um_px)
    pictures = [picture for _, picture in film]
    bodies = body_masks(pictures, threshold)
    ways = [FilmInMemory.read(film, is_backwards) for is_backwards in (False, True)]
    rows_of = {"tetractl": [_tetractl(way, um_px, organism) for way in ways]}
    try:
        scale_um_px = um_px or rows_of["tetractl"][0][1]
        linked = [_trackpy(bodies[::step], film.rate_hz, scale_um_px, organism) for step in (1, -1)]
        rows_of["trackpy"] = [(rows, scale_um_px) for rows in linked]
    except ImportError:
        print("trackpy is not installed")
    columns = []
    for (forwards, _), (backwards, _) in rows_of.values():
        columns.append(measured(forwards, backwards, bodies))
    print(f"\n## {path.name}: {len(pictures)} pictures, {organism.name}\n")
    print(f"| | {' | '.join(rows_of)} |")
    print(f"|---|{'---|' * len(columns)}")
    for field in fields(Counts):
        shares = [share(*getattr(column, field.name)) for column in columns]
        print(f"| {field.name.replace('_', ' ')} | {' | '.join(shares)} |", flush=True)


def measured(forwards: np.ndarray, backwards: np.ndarray, bodies: Sequence[np.ndarray]) -> Counts:
    """Return the measures of the rows of a film, and of the same run backwards."""
    return Counts(
        no_body=no_body(forwards, bodies),
        contradicted=contradicted(forwards, backwards, len(bodies), only_sure=False),
        sure_contradicted=contradicted(forwards, backwards, len(bodies), only_sure=True),
        followed=followed(forwards, bodies),
    )


def body_masks(pictures: Sequence[np.ndarray], threshold: float) -> list[np.ndarray]:
    """Return where each picture shows bodies: below the median by a `threshold` [grey levels], or
    above it if that is negative.
    """
    step = max(1, len(pictures) // MEDIAN_OF)
    background = np.median(np.array(pictures[::step]), axis=0)
    square = np.ones((3, 3), np.uint8)
    masks = []
    for picture in pictures:
        darker = np.sign(threshold) * (background - picture.astype(np.float32))
        blurred = cv2.GaussianBlur(darker, (3, 3), 0)
        mask = (blurred > abs(threshold)).astype(np.uint8)
        masks.append(cv2.morphologyEx(mask, cv2.MORPH_OPEN, square))
    return masks


def no_body(rows: np.ndarray, bodies: Sequence[np.ndarray]) -> tuple[int, int]:
    """Return how many found rows have no body near, or are outside of the picture; and all."""
    found = rows[rows[:, 5] > 0]
    without = 0
    for number in np.unique(found[:, 0]).astype(int).tolist():
        away = cv2.distanceTransform(1 - bodies[number], cv2.DIST_L2, 5)
        height, width = away.shape
        for x, y in found[found[:, 0] == number, 2:4].astype(int).tolist():
            is_inside = 0 <= x < width and 0 <= y < height
            without += not is_inside or away[y, x] > NEAR_PX
    return int(without), len(found)


def contradicted(
    forwards: np.ndarray, backwards: np.ndarray, count: int, only_sure: bool
) -> tuple[int, int]:
    """Return how many links of a film of `count` pictures its reverse contradicts, and of how many
    it says something.
    """
    by_number = _by_number(forwards)
    turned = backwards.copy()
    turned[:, 0] = count - 1 - turned[:, 0]
    reverse_of = _by_number(turned)
    reverse_in = defaultdict[int, list[np.ndarray]](list)
    for row in turned:
        reverse_in[int(row[0])].append(row)
    wrong = 0
    links = 0
    for places in by_number.values():
        for number in list(places)[::EVERY]:
            first = places[number]
            second = places.get(number + PICTURES)
            if second is None or (only_sure and not (first[4] and second[4])):
                continue
            here = [(_apart(row, first), row[1]) for row in reverse_in[number]]
            gap_px, name = min(here, default=(np.inf, -1))
            there = reverse_of.get(name, {}).get(number + PICTURES)
            if gap_px < LINKED_PX and there is not None:
                links += 1
                wrong += _apart(there, second) >= ELSEWHERE_PX
    return int(wrong), links


def followed(rows: np.ndarray, bodies: Sequence[np.ndarray]) -> tuple[int, int]:
    """Return how many moving bodies have a row, and how many there are. A body is as large as half
    of the median one.
    """
    labelled = [cv2.connectedComponentsWithStats(mask) for mask in bodies]
    areas = np.concatenate([stats[1:, cv2.CC_STAT_AREA] for _, _, stats, _ in labelled])
    least_px2 = np.median(areas[areas > STEP**2]) / 2
    hits = 0
    moving = 0
    for number in range(STEP, len(bodies) - STEP, EVERY):
        _, labels, stats, _ = labelled[number]
        near = _labels_near(labels, rows[rows[:, 0] == number, 2:4])
        for label in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= least_px2).tolist():
            left, top, wide, tall = stats[label, : cv2.CC_STAT_AREA].tolist()
            part = slice(top, top + tall), slice(left, left + wide)
            body = labels[part] == label
            stays = min(bodies[number + way][part][body].mean() for way in (-STEP, STEP))
            if label == 0 or stays > RESTS:
                continue
            moving += 1
            hits += label in near
    return hits, moving


def _labels_near(labels: np.ndarray, places: np.ndarray) -> set[int]:
    """Return the labels of a picture within REACH_PX of columns and rows (K, 2)."""
    near = set[int]()
    height, width = labels.shape
    reach = int(REACH_PX)
    for x, y in places.astype(int).tolist():
        if 0 <= x < width and 0 <= y < height:
            top = max(y - reach, 0)
            left = max(x - reach, 0)
            part = labels[top : y + reach + 1, left : x + reach + 1]
            lines, columns = np.indices(part.shape)
            is_near = np.hypot(lines + top - y, columns + left - x) <= REACH_PX
            near.update(part[is_near].tolist())
    return near


def _by_number(rows: np.ndarray) -> dict[float, dict[int, np.ndarray]]:
    """Return the rows of each number by picture."""
    by_number: dict[float, dict[int, np.ndarray]] = {}
    for row in rows:
        by_number.setdefault(row[1], {})[int(row[0])] = row
    return by_number


def _apart(row: np.ndarray, other: np.ndarray) -> float:
    return float(np.hypot(*(row[2:4] - other[2:4])))


def _tetractl(
    film: FilmInMemory, um_px: float | None, organism: Organism
) -> tuple[np.ndarray, float]:
    """Return the rows of `tetractl track`, and the scale [um/px]."""
    return _rows(fit_cells(follow(film, um_px, None, organism), None)[0])


def unfitted(
    film: FilmInMemory, um_px: float | None, organism: Organism
) -> tuple[np.ndarray, float]:
    """Return the same without smoothing."""
    return _rows(follow(film, um_px, None, organism))


def _rows(tracked: Followed) -> tuple[np.ndarray, float]:
    rows = []
    for path in tracked.paths:
        columns = pixels_of(path.places, tracked.um_px, tracked.size[1]).tolist()
        for (_, frame, cell), (x, y) in zip(path.pictures(), columns, strict=True):
            is_found = cell.has_blob and not cell.merged
            rows.append((frame, path.identity, x, y, cell.sure, is_found))
    return np.array(sorted(rows), float).reshape(-1, 6), tracked.um_px


def _trackpy(
    bodies: Sequence[np.ndarray], rate_hz: float, um_px: float, organism: Organism
) -> np.ndarray:
    """Return the rows of trackpy, which links the middles of bodies of the organism's size."""
    low, high = (area / um_px**2 for area in organism.outline_um2)
    places = []
    for number, mask in enumerate(bodies):
        _, _, stats, middles = cv2.connectedComponentsWithStats(mask)
        areas = stats[1:, cv2.CC_STAT_AREA]
        places += [(number, *place) for place in middles[1:][(areas > low) & (areas < high)]]
    features = pd.DataFrame(places, columns=["frame", "x", "y"])
    way = FAST * organism.speed_um_s[1] / rate_hz / um_px
    linked = trackpy_rows(features, way)
    moved = linked.groupby("particle")[["x", "y"]].transform(lambda place: np.ptp(place))
    swum = linked[np.hypot(moved.x, moved.y) * um_px > organism.body_um[0]]
    told = np.ones(len(swum))
    return np.column_stack([swum[["frame", "particle", "x", "y"]].to_numpy(float), told, told])
