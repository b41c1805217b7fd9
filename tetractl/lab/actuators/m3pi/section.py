"""The section of the spec for m3pi robots behind an XBee: `actuator: {type: m3pi-xbee, ...}`."""

from collections.abc import Iterator
from typing import Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import Found
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.spec.base import Model, NonNegative
from tetractl.spec.lab_section import (
    ActuatorSection,
    RobotPart,
    entry,
    find_unknown_radii,
    mismatches,
)
from tetractl.spec.yaml.problems import Loc

RATES_HZ = (60.0, 40.0, 20.0)
"""Default numbers of wheel commands per second [Hz], of which the first that has room is used.

After a lost command, the wheels keep their speeds until the next one arrives. On the simulated
bench, where 5 % of the commands are lost, trials take less time at 60 Hz than at 40 Hz, and 80 Hz
brings nothing more (docs/reference/measured.md).
"""
BUSY_MAX = 0.5
"""Maximum fraction of the time for which commands may keep the radio's port busy by default.

The rest is for the random waits of the radio, escaped bytes and the answers of robots; chosen.
"""
FRAME_BYTES = 17
"""Bytes of a command on the port without wheels: 9 of the radio's frame and 8 of the command."""
WHEELS_BYTES = 2
"""Bytes for the two wheels of a robot in a command."""
BYTE_BITS = 10
"""Bits of a byte on a serial port, with its start bit and stop bit."""


class WheelSection(Model):
    """The fields of one wheel: its speed is the gain times (|count| - dead zone)."""

    gain_mm: float = Field(default=1000 / 127, gt=0, le=100, allow_inf_nan=False)
    """Speed per count [mm/s]."""
    dead_zone: int = Field(default=0, ge=0, le=60)
    """Maximum wheel count at which the wheel does not move."""
    invert: bool = False
    """Whether the motor turns backward at positive counts."""


class M3piRobot(RobotPart):
    """One m3pi robot in the spec: its number in broadcasts, and its wheels."""

    index: int | None = Field(default=None, ge=0, le=31)
    """Number of the robot in broadcasts, as built into its firmware. Default: the index of its
    entry in `robots`, from 0.
    """
    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to the robot's centre [mm]; `wheels.radius` by default."""
    left: WheelSection = WheelSection()
    """The left wheel."""
    right: WheelSection = WheelSection()
    """The right wheel."""
    swap: bool = False
    """Whether the left wheel is connected to the right motor's output."""
    limit: int = Field(default=127, ge=1, le=127)
    """Maximum wheel count that is sent to the robot. Full speed is 127."""


class M3piSection(XbeeSection, ActuatorSection):
    """m3pi robots with two wheels, steered over an XBee radio with one frame for all.

    Their firmware has a watchdog: without frames, they stop by themselves after 250 ms.
    """

    device: ClassVar[str] = "tetractl.lab.actuators.m3pi.actuator:M3piActuator"
    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    stopping: ClassVar[str] = "tetractl.lab.actuators.m3pi.broadcast:stop_all"
    dead_zone_max: ClassVar[int] = 60
    type: Literal["m3pi-xbee"]
    rate: float | None = Field(default=None, ge=20, le=120, allow_inf_nan=False)
    """Wheel commands per second [Hz].

    Default: 60, or 40 or 20 if more would keep the radio's port busy for over half of the time.
    """
    robots: tuple[M3piRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec, with its number and wheels."""
    battery_warn: NonNegative = 4.4
    """Battery voltage below which a warning is printed for a robot [V]."""

    @property
    def commands_hz(self) -> float:
        """The number of wheel commands per second [Hz]: `rate`, or its default."""
        if self.rate is not None:
            return self.rate
        n_slots = 1 + max(self.index(robot.name) for robot in self.robots)
        command_s = (FRAME_BYTES + WHEELS_BYTES * n_slots) * BYTE_BITS / self.baud
        affordable_rates_hz = (rate_hz for rate_hz in RATES_HZ if rate_hz * command_s <= BUSY_MAX)
        return next(affordable_rates_hz, RATES_HZ[-1])

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the field and message of each problem with robots, numbers or wheels."""
        indexed = [
            robot.model_copy(update={"index": self.index(robot.name)}) for robot in self.robots
        ]
        yield from mismatches(indexed, setup.names, ("index",))
        yield from find_unknown_radii(setup, [robot.radius_mm for robot in self.robots])
        for i, robot in enumerate(self.robots):
            for side, wheel in (("left", robot.left), ("right", robot.right)):
                if wheel.dead_zone >= robot.limit:
                    message = f"must be below the robot's limit of {robot.limit}"
                    yield ("robots", i, side, "dead_zone"), message

    def require_port(self) -> None:
        """Raise AbortError if the serial port of the radio does not exist on this computer."""
        from tetractl.lab.serial_port import require_port

        require_port(self.port, "the radio")

    def bounds(self) -> dict[str, str]:
        """Return the radio's port and rate, and the maximum wheel count, as {name: text}."""
        return {
            "radio": f"{self.port}, {self.commands_hz:g} commands per second",
            "wheel counts": f"at most {max(robot.limit for robot in self.robots)} of 127",
        }

    def index(self, name: str) -> int:
        """Return the number in broadcasts of the robot with this name."""
        robot = entry(self.robots, name)
        return self.robots.index(robot) if robot.index is None else robot.index

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the wheel count for a 127th of full speed, and the robot's maximum count.

        The maximum is `limit`, or the robot's own limit if that is lower.
        """
        return 1.0, min(limit, entry(self.robots, name).limit)

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's fields of the spec, with the values that a calibration measured."""
        return {
            "radius_mm": calibrated.radius_mm,
            "left": calibrated.left._asdict(),
            "right": calibrated.right._asdict(),
            "swap": calibrated.swap,
        }
