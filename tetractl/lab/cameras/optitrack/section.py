"""The section of the spec for OptiTrack cameras: `camera: {type: optitrack, ...}`."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from tetractl.core.setup import Setup
from tetractl.spec.base import Angle, Point, Positive
from tetractl.spec.lab_section import CameraSection, RobotPart, entry, mismatches
from tetractl.spec.yaml.problems import Loc

Ipv4 = Annotated[
    str, Field(pattern=r"^(25[0-5]|2[0-4]\d|1?\d?\d)(\.(25[0-5]|2[0-4]\d|1?\d?\d)){3}$")
]
Port = Annotated[int, Field(ge=1, le=65_535)]


def _version_as_text(value: Any) -> Any:
    """Convert a protocol version that YAML has read as a number, such as 4.1, to text."""
    if value in (2.1, 2.2):
        message = (
            f"must be at least 2.5; if {value}0 is meant, put it in quotes: YAML reads {value}"
        )
        raise ValueError(message)
    return str(float(value)) if isinstance(value, int | float) else value


VersionText = Annotated[
    str,
    Field(pattern=r"^(2\.([5-9]|1\d)|[34]\.\d{1,2})$"),
    BeforeValidator(_version_as_text, json_schema_input_type=str | float),
]
"""A protocol version, such as "4.1".

A number is also accepted if its minor version has one digit.
"""


class TrackedRobot(RobotPart):
    """The entry of one robot in the spec of the camera: the rigid body by which it is tracked."""

    body: str | int
    """Name or id of the robot's rigid body in the camera system."""
    heading_offset: Angle = 0.0
    """Angle added to the rigid body's heading to give the robot's heading [rad]."""


class OptitrackSection(CameraSection):
    """OptiTrack cameras with a Motive server that streams by NatNet."""

    device: ClassVar[str] = "tetractl.lab.cameras.optitrack.camera:OptitrackCamera"
    type: Literal["optitrack"]
    server: Ipv4
    """The server's address: IPv4, such as 192.168.1.10."""
    interface: Ipv4 = "0.0.0.0"
    """IPv4 address of this computer's network card that reaches the cameras.

    With 0.0.0.0, the operating system chooses.
    """
    transport: Literal["multicast", "unicast"] = "multicast"
    """Transmission mode of the stream, as set in Motive."""
    command_port: Port = 1510
    """The server's UDP port for commands."""
    data_port: Port = 1511
    """UDP port of the multicast stream; unused in unicast."""
    group: Ipv4 = "239.255.42.99"
    """Multicast address of the stream: IPv4."""
    version: VersionText | None = None
    """Protocol version to request: major.minor, such as 4.1, or in quotes if it ends in 0, such as
    '2.10'. By default, and always in multicast, the server's own version.
    """
    up_axis: Literal["auto", "y", "z"] = "auto"
    """The camera server's axis that points up; `auto` asks the server."""
    origin: Point = (0.0, 0.0)
    """Position of the cameras' origin in the spec's coordinates [length unit]."""
    rotation: Angle = 0.0
    """Angle from the spec's x axis to the cameras' x axis [rad]."""
    connect: Positive = 2.0
    """Maximum wait for the server's answer, and then for its stream [s]."""
    robots: tuple[TrackedRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec, with its rigid body."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the field and message of each problem with the robots or the version."""
        yield from mismatches(self.robots, setup.names, ("body",))
        if self.version is not None and self.transport == "multicast":
            yield ("version",), "can be requested only in unicast; remove it"

    def bounds(self) -> dict[str, str]:
        """Describe the address of the camera server for display, under the key `cameras`."""
        return {"cameras": f"{self.server}:{self.command_port}, {self.transport}"}

    def heading_offset(self, name: str) -> float:
        """Return the angle added to the heading of a robot's rigid body [rad]."""
        return entry(self.robots, name).heading_offset
