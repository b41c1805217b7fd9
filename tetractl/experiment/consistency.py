"""What the parts of a spec must be to each other."""

from collections.abc import Iterator, Mapping

import numpy as np

from tetractl.experiment.experiment import Arena, Experiment, Robot
from tetractl.experiment.lab import LabSpec, Slave
from tetractl.experiment.shape import ShapeSection
from tetractl.experiment.yaml.problems import Loc


def contradictions(
    arena: Arena | None, robots: Mapping[int, Robot], obstacles: Mapping[int, ShapeSection]
) -> Iterator[tuple[Loc, str]]:
    """Yield where the parts contradict each other, and how.

    The parts are those that are valid by themselves, by their index in the spec.
    """
    first: dict[str, int] = {}
    for i, robot in robots.items():
        if first.setdefault(robot.name, i) != i:
            message = f"robots.{first[robot.name]} has this name already; names must differ"
            yield ("robots", i, "name"), message
        for field, point in (("start", robot.start), ("target", robot.target)):
            loc: Loc = ("robots", i, field)
            if arena is not None and not arena.contains(*point):
                yield loc, f"is outside the arena; must be within {_extent(arena)}"
            for j, obstacle in obstacles.items():
                if _depth(obstacle, point) >= 0:
                    yield loc, f"is inside obstacles.{j}, a {obstacle.type}; move one of them"
    for j, obstacle in obstacles.items():
        if arena is not None and not _touches(arena, obstacle):
            message = f"is entirely outside the arena, which is {_extent(arena)}"
            yield ("obstacles", j), message


def lab_contradictions(experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    """Yield where a lab contradicts the experiment or itself, and how."""
    for section, lab in (("plant", experiment.plant), ("lab", experiment.lab)):
        if not isinstance(lab, LabSpec):
            continue
        if experiment.wheels is None:
            yield (section,), "needs the robots' wheels; add 'wheels: {radius: ..}'"
        yield from _robots_of_lab((section, "robots"), lab, experiment)
        if lab.mocap.version is not None and lab.mocap.transport == "multicast":
            message = "can only be asked for in unicast; leave it out"
            yield (section, "mocap", "version"), message
        if isinstance(lab.protocol, Slave) and lab.radio.mode == "transparent":
            message = "cannot address one robot, which the slave protocol needs; use api2"
            yield (section, "radio", "mode"), message


def _robots_of_lab(loc: Loc, lab: LabSpec, experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    names = [robot.name for robot in experiment.robots]
    for missing in sorted(set(names) - {robot.name for robot in lab.robots}):
        yield loc, f"has no {missing}; every robot of the spec must be here"
    taken: dict[tuple[str, object], int] = {}
    for i, robot in enumerate(lab.robots):
        if robot.name not in names:
            yield (*loc, i, "name"), f"is no robot of the spec; those are {', '.join(names)}"
        mine = {"name": robot.name, "body": robot.body, "index": lab.index(robot)}
        if robot.address is not None:
            mine["address"] = robot.address
        elif isinstance(lab.protocol, Slave):
            yield (*loc, i, "address"), "is missing; the slave protocol addresses each robot"
        for field, value in mine.items():
            if (first := taken.setdefault((field, value), i)) != i:
                yield (*loc, i, field), f"is that of {lab.robots[first].name}; must differ"
        limit = robot.limit
        if isinstance(lab.protocol, Slave):
            limit = min(limit, lab.protocol.limit)
        for side in ("left", "right"):
            if getattr(robot, side).dead_zone >= limit:
                yield (*loc, i, side, "dead_zone"), f"must be below its limit, {limit}"


def _extent(arena: Arena) -> str:
    right, top = arena.left + arena.width, arena.bottom + arena.height
    return f"x {arena.left:g} to {right:g}, y {arena.bottom:g} to {top:g}"


def _depth(obstacle: ShapeSection, point: tuple[float, float]) -> float:
    """Return how deep a point lies inside an obstacle, negative outside [length unit]."""
    with np.errstate(over="ignore", invalid="ignore"):
        return -float(obstacle.distance(*np.array(point)))


def _touches(arena: Arena, obstacle: ShapeSection) -> bool:
    """Return whether the edge of the arena meets an obstacle, or a corner of it lies within."""
    right, top = arena.left + arena.width, arena.bottom + arena.height
    x = np.array([arena.left, right, right, arena.left])
    y = np.array([arena.bottom, arena.bottom, top, top])
    with np.errstate(over="ignore", invalid="ignore"):
        if obstacle.cross(x, y, np.roll(x, -1), np.roll(y, -1)).any():
            return True
    return any(arena.contains(*corner) for corner in obstacle.outline().tolist())
