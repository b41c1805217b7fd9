"""The file that `tetractl identify` writes, and the spec's values that the file replaces."""

from pathlib import Path
from typing import Any

from pydantic import Field

from tetractl.core.errors import printable
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Positive
from tetractl.experiment.explain import validated
from tetractl.experiment.yaml.document import Document, Place, parse_document, read_text
from tetractl.experiment.yaml.problems import InvalidSpecError


class IdentifiedValue(Model):
    """An estimate and its 95 % interval; an end of the interval is None if unknown."""

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
    """The identified values of robots and commands."""

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
    """Identified values of each robot, by its name."""


def read_identified(path: Path) -> tuple[Identified, str]:
    """Return a file's values and its text; problems are reported like problems of a spec."""
    text = read_text(path)
    document = parse_document(text, str(path))
    found = validated(Identified, document)
    for name, robot in found.robots.items():
        for key, wrong, words in (
            ("a", robot.a.value <= 0, "must be greater than 0"),
            ("speed", robot.speed.value < 0, "must be at least 0"),
        ):
            if wrong:
                place = document.place(("robots", name, key, "value"))
                problem = place.problem(("robots", name, key, "value"), words, place.text)
                document.problems.append(problem)
    if document.found:
        raise InvalidSpecError(document.found)
    return found, text


def merge(document: Document, found: Identified, origin: str) -> None:
    """Replace a spec's values by the identified values; add problems to the document.

    Each robot's turning rate a and speed, and the controller's dead time, are replaced; an alpha by
    a over the strength at which a was identified. The dead
    time counts from sending a command if the controller identifies while driving (`estimate`),
    otherwise from the exposure of the frame.
    """
    data = document.data
    place = Place(origin)
    units = data.get("units")
    unit = units.get("length", "mm") if isinstance(units, dict) else "mm"
    if unit != found.unit:
        document.problems.append(
            place.problem(
                ("unit",),
                f"differs from the spec's, {printable(str(unit), 60)}",
                printable(found.unit, 60),
            )
        )
        return
    robots = data.get("robots")
    listed = [one for one in robots if isinstance(one, dict)] if isinstance(robots, list) else []
    names = [one.get("name") for one in listed]
    for name in found.robots.keys() - set(names):
        document.problems.append(place.problem(("robots", name), "is not a robot of the spec"))
    for i, robot in enumerate(listed):
        if values := found.robots.get(str(robot.get("name"))):
            _put_rate(document, place, i, robot, values.a.value, found.strength)
            document.put(robot, ("robots", i, "speed"), values.speed.value, place)
    controller = data.setdefault("controller", {})
    if isinstance(controller, dict):
        estimates = controller.get("estimate") is True
        dead_time = found.dead_time.value + (0.0 if estimates else found.frame_age)
        document.put(controller, ("controller", "dead_time"), dead_time, place)


def _put_rate(
    document: Document, place: Place, i: int, robot: dict[str, Any], a: float, at: float | None
) -> None:
    """Replace robot i's a by one [rad/s] that was identified at a strength `at`."""
    loc, given = ("robots", i, "a"), robot.get("a")
    if not isinstance(given, dict) or len(given) != 1:
        document.put(robot, loc, a, place)
    elif at is None:
        message = "is per strength in the spec, but its logs state no strength"
        document.problems.append(place.problem(loc, message))
    else:
        (key,) = given
        document.put(given, (*loc, key), a / at, place)
