"""Checks that the sections of a spec do not contradict each other."""

from collections.abc import Iterator, Mapping

import numpy as np

from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Setup
from tetractl.experiment.base import Point
from tetractl.experiment.experiment import Arena, Experiment, Robot
from tetractl.experiment.lab_section import LabSection
from tetractl.experiment.section_abilities import KeepsClear
from tetractl.experiment.shape_section import ShapeSection
from tetractl.experiment.yaml.problems import Loc


def same_names(robots: Mapping[int, Robot]) -> Iterator[tuple[Loc, str]]:
    """Yield location and text of each name that an earlier robot has already."""
    first: dict[str, int] = {}
    for i, robot in robots.items():
        if first.setdefault(robot.name, i) != i:
            message = f"robots.{first[robot.name]} has this name already; names must differ"
            yield ("robots", i, "name"), message


def misplaced(
    arena: Arena | None, robots: Mapping[int, Robot], obstacles: Mapping[int, ShapeSection]
) -> Iterator[tuple[Loc, str]]:
    """Yield location and text of each contradiction between the places in a person's spec.

    `robots` and `obstacles` hold the valid entries of these lists by their index in the spec. A
    spec in a log may have such places: there, starts may have been measured.
    """
    places: list[tuple[int, Loc, Point]] = [
        (i, loc, point)
        for i, robot in robots.items()
        for loc, point in (
            (("start",), robot.start),
            (("target",), robot.target),
            *((("via", at), point) for at, point in enumerate(robot.via)),
        )
    ]
    points = np.array([point for _, _, point in places], dtype=float).reshape(-1, 2)
    inside = {j: _inside(obstacle, points) for j, obstacle in obstacles.items()}
    for row, (i, field, point) in enumerate(places):
        loc: Loc = ("robots", i, *field)
        if arena is not None and not arena.bounds.contains(*point):
            yield loc, f"is outside the arena; must be within {_extent(arena)}"
        for j, obstacle in obstacles.items():
            if inside[j][row]:
                yield loc, f"is inside obstacles.{j}, a {obstacle.type}; move one of them"
    for j, obstacle in obstacles.items():
        if arena is not None and not _touches(arena, obstacle):
            message = f"is entirely outside the arena, which is {_extent(arena)}"
            yield ("obstacles", j), message


def overlapping(experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    """Yield location and text of each start at which a robot's body overlaps an earlier robot's."""
    radius = experiment.controller.body_radius
    if experiment.chosen is not None:
        return
    for field, i, other, gap in nearest(experiment.setup):
        if field == "start" and gap < 2 * radius:
            message = f"bodies of radius {radius:g} overlap; move one of them"
            yield ("robots", i, field), f"is {gap:.4g} from the start of {other}: {message}"


def unreachable(experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    """Yield location and text of each target at which a robot's body would be in an obstacle or, if
    plans keep to the walls, over the arena's edge."""
    control = experiment.controller
    if not isinstance(control, KeepsClear) or experiment.chosen is not None:
        return
    setup = experiment.setup
    x, y = setup.targets.T
    gaps = [shape.distance(x, y) for shape in setup.obstacles]
    if control.collision.walls:
        gaps.append(setup.arena.inside(x, y))
    nearest_gap = np.min(gaps, axis=0, initial=np.inf)
    for i in np.flatnonzero(nearest_gap < setup.body_radius).tolist():
        where = f"is {nearest_gap[i]:.4g} {setup.unit} from the nearest obstacle or edge"
        message = f"a body of radius {setup.body_radius:g} does not fit there; move the target"
        yield ("robots", i, "target"), f"{where}: {message}"


def nearest(setup: Setup) -> Iterator[tuple[str, int, str, float]]:
    """Yield "start" or "target", a robot's index, the nearest earlier robot, and its distance."""
    for field, points in (("start", setup.starts.xy), ("target", setup.targets)):
        for i in range(1, len(points)):
            gaps = np.hypot(*(points[:i] - points[i]).T)
            yield field, i, setup.names[int(gaps.argmin())], float(gaps.min())


def too_large(experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    """Yield location and text if a control step would need more memory than 1 GB."""
    held = 8e-9 * experiment.controller.numbers_held(experiment.setup)
    if held > 1:
        yield (
            ("controller",),
            f"a control step would need some {held:.3g} GB of memory, more than "
            "1 GB; use fewer particles, robots or signals",
        )


def section_contradictions(experiment: Experiment) -> Iterator[tuple[Loc, str]]:
    """Yield location and text of each contradiction in the sections of controller and plant."""
    control = experiment.controller
    if control.switches_field and not experiment.plant.switches_field:
        message = f"cannot switch the field off, as controller {control.type} does"
        yield ("plant",), f"{message}; simulations can"
    if not control.tours and (experiment.hold or len(experiment.setup.legs) > 1):
        yield ("controller",), f"{control.type} supports neither way-points nor a hold; mpc does"
    for loc, message in control.contradictions(experiment.setup):
        yield ("controller", *loc), message
    for name, plant in (("plant", experiment.plant), ("lab", experiment.lab)):
        if isinstance(plant, LabSection) and experiment.chosen is not None:
            for device, section in (("camera", plant.camera), ("actuator", plant.actuator)):
                if not section.settles:
                    message = (
                        f"{section.type} cannot find the robots of a trial; name them in robots"
                    )
                    yield (name, device), message
        if plant is not None:
            for loc, message in plant.contradictions(experiment.setup):
                yield (name, *loc), message


def _extent(arena: Arena) -> str:
    at = arena.bounds
    return f"x {at.left:g} to {at.right:g}, y {at.bottom:g} to {at.top:g}"


def _inside(obstacle: ShapeSection, points: Floats) -> Bools:
    """Return whether each point (n, 2) lies in an obstacle or on its edge, (n,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return obstacle.shape().contain(points[:, 0], points[:, 1])


def _touches(arena: Arena, obstacle: ShapeSection) -> bool:
    """Return whether an obstacle meets the arena's edge or has a corner inside the arena."""
    at = arena.bounds
    x = np.array([at.left, at.right, at.right, at.left])
    y = np.array([at.bottom, at.bottom, at.top, at.top])
    with np.errstate(over="ignore", invalid="ignore"):
        if obstacle.shape().cross(x, y, np.roll(x, -1), np.roll(y, -1)).any():
            return True
    return any(at.contains(*corner) for corner in obstacle.shape().outline().tolist())
