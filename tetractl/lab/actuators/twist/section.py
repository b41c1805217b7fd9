"""The section of the spec for robots that take lines of text: `actuator: {type: twist, ...}`."""

from collections.abc import Iterator
from typing import Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import Found, wheel_gains
from tetractl.spec.base import NonNegative, Positive
from tetractl.spec.lab_section import (
    ActuatorSection,
    RobotPart,
    entry,
    find_unknown_radii,
    mismatches,
    too_fast,
)
from tetractl.spec.yaml.problems import Loc


class TwistRobot(RobotPart):
    """One robot of the actuator `twist`, with its number and its wheels, in the spec."""

    index: int | None = Field(default=None, ge=0, le=31)
    """Number of the robot in lines, as set in its program.

    Default: the index of its entry in `robots`, from 0.
    """
    port: str | None = Field(default=None, min_length=1, max_length=500)
    """The robot's own port, if each robot has one. Default: the actuator's port."""
    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to the robot's centre [mm], as in its program.

    Default: `wheels.radius`.
    """
    left_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the left wheel, divided by the speed that was sent to it."""
    right_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the right wheel, divided by the speed that was sent to it."""


class TwistSection(ActuatorSection):
    """Robots with two wheels that take lines of text, over a serial port or UDP.

    Without a line, they stop by themselves after 250 ms.
    """

    device: ClassVar[str] = "tetractl.lab.actuators.twist.actuator:TwistActuator"
    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    stopping: ClassVar[str] = "tetractl.lab.actuators.twist.line_ports:stop_all"
    dead_zone_max: ClassVar[int] = 0
    type: Literal["twist"]
    port: str = Field(min_length=1, max_length=500)
    """The serial port of a radio, such as /dev/ttyUSB0, or udp://HOST:PORT.

    A broadcast address reaches all robots at once.
    """
    baud: Literal[9600, 19200, 38400, 57600, 115200] = 57600
    """Bits per second on serial ports."""
    sends: Literal["twist", "wheels"] = "twist"
    """What a line contains for each robot: its speed and turning rate (`twist`), or the speeds of
    its `wheels`.
    """
    rate: float = Field(default=40.0, ge=20, le=120, allow_inf_nan=False)
    """Lines per second [Hz]."""
    delay: float = Field(default=0.01, ge=0, le=0.2, allow_inf_nan=False)
    """Time from the sending of a line until the wheels follow it [s]."""
    speed_max_mm_s: Positive = Field(default=500.0, le=5000)
    """Maximum wheel speed that is sent [mm/s]."""
    robots: tuple[TwistRobot, ...] = Field(min_length=1, max_length=16)
    """One entry for each robot of the spec."""
    battery_warn: NonNegative = 4.4
    """Battery voltage below which a warning is printed for a robot [V]."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the field and message of each problem with robots, numbers, ports or wheels."""
        from tetractl.lab.udp_port import SCHEME, parse_address

        indexed = [
            robot.model_copy(update={"index": self.index(robot.name)}) for robot in self.robots
        ]
        yield from mismatches(indexed, setup.names, ("index",))
        yield from too_fast(setup, self.speed_max_mm_s)
        yield from find_unknown_radii(setup, [robot.radius_mm for robot in self.robots])
        ports: list[tuple[Loc, str]] = [(("port",), self.port)]
        for i, robot in enumerate(self.robots):
            if robot.port is not None:
                ports.append((("robots", i, "port"), robot.port))
        for loc, port in ports:
            if port.startswith(SCHEME) and parse_address(port) is None:
                yield loc, f"must be {SCHEME}HOST:PORT"

    def require_port(self) -> None:
        """Raise AbortError if a serial port of the robots does not exist.

        UDP is not checked.
        """
        from tetractl.lab.serial_port import require_port
        from tetractl.lab.udp_port import SCHEME

        for port in self.ports():
            if not port.startswith(SCHEME):
                require_port(port, "the radio")

    def bounds(self) -> dict[str, str]:
        """Return the ports, the rate and the maximum wheel speed as {name: text}, for display."""
        return {
            "robots": f"{', '.join(self.ports())}, {self.rate:g} lines per second",
            "wheel speeds": f"at most {self.speed_max_mm_s:g} mm/s",
        }

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the wheel speed for a 127th of the maximum speed, and for `limit` of these.

        Both are in mm/s.
        """
        return self.speed_max_mm_s / 127, int(self.speed_max_mm_s * limit / 127)

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's fields of the spec, with the values that a calibration measured."""
        return wheel_gains(calibrated, 1.0)

    def index(self, name: str) -> int:
        """Return the number in lines of the robot with this name."""
        robot = entry(self.robots, name)
        return self.robots.index(robot) if robot.index is None else robot.index

    def port_of(self, name: str) -> str:
        """Return the port of the robot with this name."""
        return entry(self.robots, name).port or self.port

    def ports(self) -> list[str]:
        """Return the ports of all robots, each once."""
        return list(dict.fromkeys(robot.port or self.port for robot in self.robots))
