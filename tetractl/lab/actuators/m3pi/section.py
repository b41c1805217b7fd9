"""The section of the spec for m3pi robots behind an XBee: `actuator: {type: m3pi-xbee, ...}`."""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative
from tetractl.experiment.lab_section import ActuatorSection, RobotPart, mismatches
from tetractl.experiment.yaml.problems import Loc
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.model.wheels import COUNT_MAX


class BroadcastSection(Model):
    """For robots with the mbed firmware: one frame steers all of them, and without frames they stop
    by themselves after 250 ms.
    """

    watchdog: ClassVar[bool] = True
    limit: ClassVar[int] = COUNT_MAX
    type: Literal["broadcast"]


class SlaveSection(Model):
    """For robots with the 3pi's serial-slave program: one message per robot. There is no watchdog:
    a robot that loses the radio connection drives on.
    """

    watchdog: ClassVar[bool] = False
    type: Literal["slave"]
    accept_no_watchdog: Literal[True]
    """Must be true: confirms that a person stands by to switch the robots off."""
    limit: int = Field(default=25, ge=1, le=40)
    """Largest wheel count that is sent; full speed is 127."""


class WheelSection(Model):
    """One wheel: its speed is the gain times (|count| - dead zone)."""

    gain_mm: float = Field(default=1000 / 127, gt=0, le=100, allow_inf_nan=False)
    """Speed per count [mm/s]."""
    dead_zone: int = Field(default=0, ge=0, le=60)
    """Largest count that does not move the wheel."""
    invert: bool = False
    """Whether the motor turns backward at positive counts."""


class M3piRobot(RobotPart):
    """A robot's entry in the actuator's section: radio address and wheels."""

    index: int | None = Field(default=None, ge=0, le=31)
    """Number of the robot in broadcasts, as built into its firmware; by default the number of its
    entry in `robots`, from 0.
    """
    address: int | None = Field(default=None, ge=0, le=0xFFFD)
    """16-bit radio address (MY) of the robot's module; needed for `slave`."""
    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to the robot's centre [mm]; `wheels.radius` by default."""
    left: WheelSection = WheelSection()
    """The left wheel."""
    right: WheelSection = WheelSection()
    """The right wheel."""
    swap: bool = False
    """Whether the left wheel is connected to the right motor's output."""
    limit: int = Field(default=127, ge=1, le=127)
    """Largest wheel count that is sent to the robot; full speed is 127."""


class M3piSection(XbeeSection, ActuatorSection):
    """m3pi robots with two wheels, steered over an XBee radio."""

    device: ClassVar[str] = "tetractl.lab.actuators.m3pi.actuator:M3piActuator"
    calibration: ClassVar[str] = "tetractl.lab.actuators.m3pi.calibrate:calibrate_robots"
    type: Literal["m3pi-xbee"]
    rate: float = Field(default=40.0, ge=20, le=120, allow_inf_nan=False)
    """Wheel commands per second [Hz]."""
    protocol: Annotated[BroadcastSection | SlaveSection, Field(discriminator="type")] = (
        BroadcastSection(type="broadcast")
    )
    """Protocol of the robots' program: one broadcast for all, or one message each."""
    robots: tuple[M3piRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec, with its radio address and wheels."""
    battery_warn: NonNegative = 4.4
    """A warning is printed for a robot below this battery voltage [V]."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield the place and text of each problem with robots, numbers, wheels or radio mode."""
        indexed = [
            robot.model_copy(update={"index": self.index(robot.name)}) for robot in self.robots
        ]
        yield from mismatches(indexed, setup.names, ("index", "address"))
        slave = not self.protocol.watchdog
        if slave and self.mode == "transparent":
            message = "cannot send to a single robot, which the slave protocol needs; use api2"
            yield ("mode",), message
        if slave and setup.watchdog_s < math.inf:
            message = "serial slaves do not stop without commands; leave out wheels.watchdog"
            yield ("protocol",), message
        for i, robot in enumerate(self.robots):
            if setup.wheel_radius is None and robot.radius_mm is None:
                message = "is missing; add it, or 'wheels: {radius: ..}' for all robots"
                yield ("robots", i, "radius_mm"), message
            if slave and robot.address is None:
                message = "is missing; the slave protocol addresses each robot"
                yield ("robots", i, "address"), message
            limit = self.limit(robot)
            for side, wheel in (("left", robot.left), ("right", robot.right)):
                if wheel.dead_zone >= limit:
                    yield ("robots", i, side, "dead_zone"), f"must be below the limit of {limit}"

    def require_port(self) -> None:
        """Raise AbortError if the radio's port does not exist."""
        from tetractl.lab.serial_port import require_port

        require_port(self.port, "the radio")

    def bounds(self) -> dict[str, str]:
        """Return the radio's port and rate and the highest limit of wheel counts as {name: text},
        for display.
        """
        return {
            "radio": f"{self.port}, {self.rate:g} commands per second",
            "wheel counts": f"at most {max(map(self.limit, self.robots))} of 127",
        }

    def robot(self, name: str) -> M3piRobot:
        """Return the entry of the robot with this name."""
        return next(robot for robot in self.robots if robot.name == name)

    def index(self, name: str) -> int:
        """Return the number in broadcasts of the robot with this name."""
        robot = self.robot(name)
        return self.robots.index(robot) if robot.index is None else robot.index

    def limit(self, robot: M3piRobot) -> int:
        """Return the largest wheel count sent to a robot: the lower of the robot's and the
        protocol's limits.
        """
        return min(robot.limit, self.protocol.limit)

    def stop_all(self, setup: Setup, alone: bool = True) -> str:
        """Stop every robot in radio range, whichever program it runs; return a summary.

        The mbed firmware latches the stop. If not `alone`, another process may have the port open.
        """
        from tetractl.lab.actuators.m3pi.stop_sequence import stop_all

        addresses = [robot.address for robot in self.robots if robot.address is not None]
        return stop_all(self, addresses, alone)
