"""The file that `tetractl identify` writes, and the spec's values that the file replaces."""

from pathlib import Path
from typing import Any

from pydantic import Field

from tetractl.core.errors import printable
from tetractl.spec.base import Finite, Model, Name, NonNegative, Positive, validate_document
from tetractl.spec.yaml.document import Document, Place, read_document
from tetractl.spec.yaml.problems import Loc


class IdentifiedValue(Model):
    """An estimate with its 95 % interval. An end of the interval is None if it is unknown."""

    value: Finite
    """The most likely value."""
    low: Finite | None = None
    """Lower end of the 95 % interval."""
    high: Finite | None = None
    """Upper end of the 95 % interval."""


class IdentifiedRobot(Model):
    """The identified values of one robot; lengths in the file's unit."""

    a: IdentifiedValue
    """Turning rate [rad/s]; replaces the spec's."""
    speed: IdentifiedValue
    """Speed [length unit/s]; replaces the spec's."""
    heading_bias: IdentifiedValue
    """Heading that the robot turns to minus the direction sent [rad]."""
    position_noise: IdentifiedValue
    """Standard deviation of the camera's positions [length unit]."""
    heading_noise: IdentifiedValue
    """Standard deviation of the camera's headings [rad]."""
    heading_walk: IdentifiedValue
    """Random walk of the heading [rad/sqrt(s)]."""


class Identified(Model):
    """The values of robots and commands that `tetractl identify` has found in logs."""

    identified: str = Field(max_length=100)
    """Date and time of the identification."""
    origin: str = Field(max_length=1000)
    """The plant of the logs, such as `disturbed simulation`, `emulated lab` or `lab`."""
    sources: tuple[str, ...] = ()
    """Logs from which the values were identified."""
    unit: str
    """Length unit of this file's numbers."""
    dead_time: IdentifiedValue
    """Time from the sending of a direction until it acts [s]."""
    frame_age: NonNegative = 0.0
    """Time from the exposure of the frame used for a direction to the direction's sending [s]."""
    strength: Positive | None = None
    """Strength of the field at which the robots turn at their rates a, in the spec's unit."""
    robots: dict[Name, IdentifiedRobot]
    """Identified values, by the name of the robot."""


def read_identified(path: Path) -> tuple[Identified, str]:
    """Read the values in a file of `tetractl identify`, and return them with the file's text.

    Problems are reported like problems of a spec.
    """
    document = read_document(path)
    identified = validate_document(Identified, document)
    for name, robot in identified.robots.items():
        if robot.a.value <= 0:
            document.refuse(("robots", name, "a", "value"), "must be greater than 0")
        if robot.speed.value < 0:
            document.refuse(("robots", name, "speed", "value"), "must be at least 0")
    document.require_no_problems()
    return identified, document.text


def merge_identified(
    document: Document, identified: Identified, origin: str, identifies_robots: bool
) -> None:
    """Replace a spec's values by identified values, and record problems in the document.

    The turning rate a and speed of each robot, and the controller's dead time, are replaced. An
    alpha is replaced by a, divided by the strength at which a was identified.

    Args:
        document: The parsed spec, which is changed.
        identified: The identified values.
        origin: The file that contains the identified values.
        identifies_robots: Whether the controller identifies robots while it drives. Then the dead
            time counts from sending a command. Otherwise it counts from the exposure of the frame.
    """
    place = Place(origin)
    unit = _length_unit(document)
    if unit != identified.unit:
        message = f"differs from the length unit of the spec, {printable(str(unit), 60)}"
        document.problems.append(place.problem(("unit",), message, printable(identified.unit, 60)))
        return
    robots = _listed_robots(document)
    names = {str(robot.get("name")) for robot in robots.values()}
    for name in identified.robots.keys() - names:
        document.problems.append(place.problem(("robots", name), "is not a robot of the spec"))
    for i, robot in robots.items():
        values = identified.robots.get(str(robot.get("name")))
        if values is not None:
            _put_rate(document, ("robots", i, "a"), values.a.value, identified.strength, place)
            document.put(("robots", i, "speed"), values.speed.value, place)
    controller = document.data.setdefault("controller", {})
    if isinstance(controller, dict):
        dead_time_s = identified.dead_time.value
        if not identifies_robots:
            dead_time_s += identified.frame_age
        document.put(("controller", "dead_time"), dead_time_s, place)


def _length_unit(document: Document) -> Any:
    """Return the length unit that a spec states, or "mm" if it states none.

    The unit has not been validated, so it may be of any type.
    """
    units = document.data.get("units")
    return units.get("length", "mm") if isinstance(units, dict) else "mm"


def _listed_robots(document: Document) -> dict[int, dict[str, Any]]:
    """Return the robots of a spec that are mappings, keyed by their index in the list.

    Empty if the spec has no list of robots.
    """
    robots = document.data.get("robots")
    if not isinstance(robots, list):
        return {}
    return {i: robot for i, robot in enumerate(robots) if isinstance(robot, dict)}


def _put_rate(
    document: Document, loc: Loc, a_rad_s: float, strength: float | None, place: Place
) -> None:
    """Replace a robot's turning rate a by the rate that was identified at a field strength.

    If the spec gives the rate per strength, the identified rate is divided by `strength`. If the
    strength is None, the rate stays the same, and a problem is added to the document.
    """
    stated = document.holder(loc).get("a")
    if not isinstance(stated, dict) or len(stated) != 1:
        document.put(loc, a_rad_s, place)
    elif strength is None:
        message = (
            "is given per unit of field strength in the spec, but the logs from"
            " which this value comes do not state a strength"
        )
        document.problems.append(place.problem(loc, message))
    else:
        (key,) = stated
        document.put((*loc, key), a_rad_s / strength, place)
