"""Find contradictions between the parts of a spec, even if each part alone is valid.

`find_errors` applies all rules. If a command changes the lab, only the rules of sections are
checked again (`find_section_errors`). A spec in a log was written by tetractl, and a trial may have
measured its starts. Its starts are therefore allowed where a person's spec would be refused.
Warnings, which do not make a spec invalid, are findings of the same kind; their rules are in
`tetractl.run.plausibility`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.spec.base import Point
from tetractl.spec.experiment import Arena, Experiment, Robot, ShapeSection
from tetractl.spec.lab_section import LabSection
from tetractl.spec.section_abilities import KeepsClear
from tetractl.spec.yaml.problems import Loc

MEMORY_MAX_GB = 1.0
"""Maximum memory of a control step [GB]."""
GB_PER_NUMBER = 8e-9
"""Memory of a number of 64 bits [GB]."""
ROUNDING_FRACTION_MAX = 1e-9
"""Relative difference below which two bodies count as touching instead of overlapping."""


@dataclass(frozen=True, slots=True)
class SpecFinding:
    """An error or a warning about a field of a spec.

    Attributes:
        loc: Location of the field.
        text: The problem, as the end of a sentence that begins with the name and the value of the
            field, for example "is outside the arena".
        hint: What to do. Empty if the text says so, as in most errors.
    """

    loc: Loc
    text: str
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.text}; {self.hint}" if self.hint else self.text


Findings = Iterator[SpecFinding]


def find_errors(experiment: Experiment, is_resolved: bool) -> Findings:
    """Yield the contradictions between the parts of a spec.

    Args:
        experiment: The experiment that the spec describes.
        is_resolved: Whether tetractl has written the spec into a log. Then the places of robots and
            obstacles are not checked, because a trial may have measured them.
    """
    yield from find_same_names(experiment)
    if not is_resolved:
        yield from find_misplaced(experiment)
    yield from find_section_errors(experiment)
    needed_gb = GB_PER_NUMBER * experiment.controller.numbers_held(experiment.setup)
    if needed_gb > MEMORY_MAX_GB:
        message = f"a control step would need about {needed_gb:.3g} GB of memory, more than 1 GB"
        yield SpecFinding(("controller",), f"{message}; use fewer particles, robots or signals")
    if not is_resolved:
        yield from find_overlapping(experiment)
        yield from find_unreachable(experiment)


# rules of robots and obstacles


def find_same_names(experiment: Experiment) -> Findings:
    """Yield a finding for each robot that has the same name as an earlier robot."""
    first_index: dict[str, int] = {}
    for i, robot in enumerate(experiment.robots):
        earlier = first_index.setdefault(robot.name, i)
        if earlier != i:
            message = f"is already the name of robots.{earlier}; names must differ"
            yield SpecFinding(("robots", i, "name"), message)


def find_misplaced(experiment: Experiment) -> Findings:
    """Find starts, targets and way-points outside the arena or in an obstacle.

    Obstacles that are entirely outside the arena are also found.
    """
    arena = experiment.arena
    places = [] if experiment.chosen else _list_places(experiment.robots)  # others are stand-ins
    points = np.array([point for _, point in places], dtype=float).reshape(-1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        shapes = [obstacle.shape() for obstacle in experiment.obstacles]
        inside = [shape.contains(points[:, 0], points[:, 1]) for shape in shapes]
    for row, (loc, point) in enumerate(places):
        if not arena.bounds.contains(*point):
            yield SpecFinding(
                loc, f"is outside the arena; it must be within {_describe_extent(arena)}"
            )
        for j, obstacle in enumerate(experiment.obstacles):
            if inside[j][row]:
                message = f"is inside obstacles.{j}, a {obstacle.type}; move one of them"
                yield SpecFinding(loc, message)
    for j, obstacle in enumerate(experiment.obstacles):
        if not _touches_arena(arena, obstacle):
            message = f"is entirely outside the arena, which is {_describe_extent(arena)}"
            yield SpecFinding(("obstacles", j), message)


def _list_places(robots: Sequence[Robot]) -> list[tuple[Loc, Point]]:
    """List every start, target and way-point, robot by robot.

    Each entry consists of the location in the spec and the coordinates [length unit].
    """
    places: list[tuple[Loc, Point]] = []
    for i, robot in enumerate(robots):
        places.append((("robots", i, "start"), robot.start))
        places.append((("robots", i, "target"), robot.target))
        for way_point, point in enumerate(robot.via):
            places.append((("robots", i, "via", way_point), point))
    return places


def _describe_extent(arena: Arena) -> str:
    """Describe the bounds of the arena for a message, as numbers without a unit."""
    bounds = arena.bounds
    return f"x {bounds.left:g} to {bounds.right:g}, y {bounds.bottom:g} to {bounds.top:g}"


def _touches_arena(arena: Arena, obstacle: ShapeSection) -> bool:
    """Check whether an obstacle meets the arena's edge or has a corner inside the arena.

    The points of its outline count as corners, also those of a circle.
    """
    bounds = arena.bounds
    x = np.array([bounds.left, bounds.right, bounds.right, bounds.left])
    y = np.array([bounds.bottom, bounds.bottom, bounds.top, bounds.top])
    next_x = np.roll(x, -1)
    next_y = np.roll(y, -1)
    shape = obstacle.shape()
    with np.errstate(over="ignore", invalid="ignore"):
        if shape.meets_segments(x, y, next_x, next_y).any():
            return True
    corners = shape.outline().tolist()
    return any(bounds.contains(*corner) for corner in corners)


# rules of sections


def find_section_errors(experiment: Experiment) -> Findings:
    """Find contradictions between the sections of controller, plant and lab.

    A controller that switches the field off needs a plant that can do so. A spec with way-points or
    a hold needs a controller that supports them. If trials have to find their robots, the devices
    must be able to. Finally, the rules of the sections themselves are checked. A command that shows
    only the first error relies on this order.
    """
    control = experiment.controller
    if control.switches_field and not experiment.plant.switches_field:
        message = f"cannot switch off the field, but the controller {control.type} does so"
        yield SpecFinding(("plant",), f"{message}; use a simulation (type: sim)")
    if not control.tours and (experiment.hold or len(experiment.setup.legs) > 1):
        message = f"controller {control.type} supports neither way-points nor a hold; use mpc"
        yield SpecFinding(("controller",), message)
    for loc, message in control.contradictions(experiment.setup):
        yield SpecFinding(("controller", *loc), message)
    for name, plant in (("plant", experiment.plant), ("lab", experiment.lab)):
        if isinstance(plant, LabSection) and experiment.chosen is not None:
            for device, section in (("camera", plant.camera), ("actuator", plant.actuator)):
                if not section.settles:
                    message = "cannot choose the robots of a trial; list the robots in the spec"
                    yield SpecFinding((name, device), f"{section.type} {message}")
        if plant is not None:
            for loc, message in plant.contradictions(experiment.setup):
                yield SpecFinding((name, *loc), message)


# rules of places


def find_overlapping(experiment: Experiment) -> Findings:
    """Find robots whose bodies overlap their nearest earlier robot at a start, way-point or target.

    Bodies that touch do not overlap. Nothing is found if each trial chooses its robots, because
    their places are not known yet.
    """
    if experiment.chosen is not None:
        return
    setup = experiment.setup
    radius = experiment.controller.body_radius
    touching_distance = 2 * radius * (1 - ROUNDING_FRACTION_MAX)
    places: list[tuple[Loc, str, Floats]] = [(("start",), "start", setup.starts.xy)]
    for way_point, points in enumerate(setup.legs[:-1]):
        places.append((("via", way_point), "way-point", points))
    places.append((("target",), "target", setup.targets))
    for loc, place_name, points in places:
        for i, neighbour, distance in find_nearest(setup, points):
            if distance < touching_distance:
                message = f"bodies of radius {radius:g} overlap; move one of them"
                distance_text = f"is {distance:.4g} {setup.unit} from the {place_name}"
                yield SpecFinding(("robots", i, *loc), f"{distance_text} of {neighbour}: {message}")


def find_unreachable(experiment: Experiment) -> Findings:
    """Find targets where a robot's body would be in an obstacle or over the arena's edge.

    The edge counts only if plans keep a distance to walls. If the target itself is in an obstacle
    or outside the arena, `find_misplaced` alone reports it.
    """
    control = experiment.controller
    if not isinstance(control, KeepsClear) or experiment.chosen is not None:
        return
    setup = experiment.setup
    x, y = setup.targets.T
    edge_gap = setup.arena.depth_inside(x, y)
    obstacle_gap = np.full(len(x), np.inf)
    for shape in setup.obstacles:
        obstacle_gap = np.minimum(obstacle_gap, shape.distance(x, y))
    well_placed = (edge_gap >= 0) & (obstacle_gap > 0)
    keeps_to_walls = control.collision.walls
    nearest_gap = np.minimum(obstacle_gap, edge_gap) if keeps_to_walls else obstacle_gap
    for i in np.flatnonzero(well_placed & (nearest_gap < setup.body_radius)).tolist():
        distance_text = f"is {nearest_gap[i]:.4g} {setup.unit} from the nearest obstacle or edge"
        message = f"a body of radius {setup.body_radius:g} does not fit there; move the target"
        yield SpecFinding(("robots", i, "target"), f"{distance_text}: {message}")


def find_nearest(setup: Setup, points: Floats) -> Iterator[tuple[int, str, float]]:
    """Find the nearest earlier robot to each robot except the first.

    Args:
        setup: The constants of the experiment.
        points: The position of each robot, shape (N, 2).

    Yields:
        The index of the robot, the name of the nearest earlier robot, and the distance [length
        unit].
    """
    for i in range(1, len(points)):
        gaps = elementwise.hypot(*(points[:i] - points[i]).T)
        closest = int(gaps.argmin())
        yield i, setup.names[closest], float(gaps[closest])
