"""Samples layouts for each trial's spec: starts, targets, robots and obstacles."""

from typing import Any

import numpy as np

from tetractl.core.poses import Floats
from tetractl.spec.experiment import Experiment

ARENA_MM = 2400.0
EDGE_MM = 150.0
BETWEEN_MM = 250.0
CLEAR_MM = 200.0
ACCEPT_MM = 5.0  # a robot
SIZES = (2, 3, 4, 5, 6)
INSIDE = EDGE_MM, ARENA_MM - EDGE_MM
Random = np.random.Generator
Fields = dict[str, Any]


def near_a_wall(random: Random, spec: Experiment, trial: int) -> Fields:
    """Place three robots in a row 60 mm from a wall and 105 mm apart, with random headings."""
    arena = spec.setup.arena
    upright = bool(random.integers(2))
    size = np.array([arena.width, arena.height])
    off = 60.0 if random.integers(2) else size[int(not upright)] - 60
    along = random.uniform(60, size[int(upright)] - 60 - 2 * 105) + 105 * random.permutation(3)
    xy = [np.full(3, off), along] if upright else [along, np.full(3, off)]
    return {"robots": _moved(random, spec, np.add(np.transpose(xy), (arena.left, arena.bottom)))}


def through_a_gap(random: Random, spec: Experiment, trial: int) -> Fields:
    """Build a wall of 100 mm with one gap of 260 mm between the starts and the targets.

    Starts are on its left and targets on its right, 150 mm from walls and 250 mm from each other.
    Headings are random.
    """
    arena = spec.setup.arena
    first_x = arena.left + random.uniform(600, 900)
    low = random.uniform(150, arena.height - 260 - 150)
    wall = {"type": "rectangle", "left": first_x, "width": 100.0}
    below = {**wall, "bottom": arena.bottom, "height": low}
    above = {**wall, "bottom": arena.bottom + low + 260, "height": arena.height - low - 260}
    y = arena.bottom + 150, arena.top - 150
    starts = scattered(random, 3, (arena.left + 150, first_x - 150), y)
    targets = scattered(random, 3, (first_x + 250, arena.right - 150), y)
    return {"robots": _moved(random, spec, starts, targets), "obstacles": (below, above)}


def _moved(
    random: Random, spec: Experiment, starts: Floats, targets: Floats | None = None
) -> tuple[Fields, ...]:
    """Return a spec's robots with other starts, random headings and, optionally, other targets."""
    robots = [robot.model_dump(mode="json") for robot in spec.robots]
    for i, robot_fields in enumerate(robots):
        robot_fields |= {"start": tuple(starts[i]), "heading": float(random.uniform(-np.pi, np.pi))}
        robot_fields |= {} if targets is None else {"target": tuple(targets[i])}
    return tuple(robots)


def eight(random: Random, spec: Experiment, trial: int) -> Fields:
    """Place eight robots like `anywhere`, in 3 x 3 m without obstacles."""
    inside = EDGE_MM, 3000 - EDGE_MM
    starts, targets = (scattered(random, 8, inside, inside) for _ in range(2))
    arena = {"left": 0, "bottom": 0, "width": 3000, "height": 3000}
    return {"arena": arena, "robots": _drawn(random, starts, targets), "obstacles": ()}


def anywhere(random: Random, spec: Experiment, trial: int) -> Fields:
    """Place 2 + `trial` mod 5 robots randomly in 2.4 x 2.4 m, with one to three rectangles.

    Starts and targets are at least 150 mm from the edge, 250 mm from each other, and 200 mm from
    the rectangles. Headings are random, a is from 2 to 6 rad/s, and speeds are from 150 to 200
    mm/s. The accepted error is 5 mm for each robot.
    """
    count = SIZES[trial % len(SIZES)]
    starts = scattered(random, count)
    targets = scattered(random, count)
    controller = spec.controller.model_dump(mode="json") | {"accept_error": ACCEPT_MM * count}
    return {
        "arena": {"left": 0, "bottom": 0, "width": ARENA_MM, "height": ARENA_MM},
        "robots": _drawn(random, starts, targets),
        "obstacles": _rectangles(random, np.vstack([starts, targets])),
        "controller": controller,
    }


def scattered(
    random: Random,
    count: int,
    x: tuple[float, float] = INSIDE,
    y: tuple[float, float] = INSIDE,
) -> Floats:
    """Sample points (count, 2) within ranges of x and y, at least BETWEEN_MM from each other."""
    points: list[Floats] = []
    while len(points) < count:
        point = random.uniform(*zip(x, y, strict=True))
        if all(np.hypot(*(point - placed)) >= BETWEEN_MM for placed in points):
            points.append(point)
    return np.array(points)


def _drawn(random: Random, starts: Floats, targets: Floats) -> tuple[Fields, ...]:
    """Create robots with random headings and speeds. Successive a differ by a constant factor."""
    rates = random.permutation(np.geomspace(2, 6, len(starts)))
    return tuple(
        {
            "name": f"r{i}",
            "start": tuple(starts[i]),
            "heading": float(random.uniform(-np.pi, np.pi)),
            "target": tuple(targets[i]),
            "a": float(a),
            "speed": float(random.uniform(150, 200)),
        }
        for i, a in enumerate(rates)
    )


def _rectangles(random: Random, points: Floats) -> tuple[Fields, ...]:
    """Sample one to three rectangles at least CLEAR_MM from all points."""
    obstacles: list[Fields] = []
    several = int(random.integers(1, 4))
    for _ in range(1000 * several):
        size = random.uniform(150, 350, 2)
        corner = random.uniform(0, ARENA_MM - size)
        off = np.maximum(np.maximum(corner - points, points - corner - size), 0.0)
        if np.hypot(*off.T).min() >= CLEAR_MM and len(obstacles) < several:
            x, y = corner.tolist()
            width, height = size.tolist()
            sizes = {"left": x, "bottom": y, "width": width, "height": height}
            obstacles.append({"type": "rectangle", **sizes})
    return tuple(obstacles)
