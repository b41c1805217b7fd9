"""The base of sections for robots of another make: two wheels, and a port for each robot."""

from collections.abc import Iterator
from typing import Any, ClassVar

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import Found, wheel_gains
from tetractl.spec.base import Positive
from tetractl.spec.lab_section import (
    ActuatorSection,
    RobotPart,
    mismatches,
    too_fast,
    unknown_radii,
)
from tetractl.spec.yaml.problems import Loc


class OwnRobot(RobotPart):
    """A robot's entry in the actuator's section."""

    address: str = Field(min_length=1, max_length=500)
    """Where its commands go: udp://HOST:PORT, or a serial port such as /dev/rfcomm0."""
    radius_mm: float | None = Field(default=None, gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to its centre [mm], as in its program. Default: the spec's."""
    left_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the left wheel over the speed that it was sent."""
    right_gain: float = Field(default=1.0, ge=0.2, le=5, allow_inf_nan=False)
    """True speed of the right wheel over the speed that it was sent."""


class OwnSection(ActuatorSection):
    """Robots on two wheels, each with its own port.

    A subclass names its `OwnRobots` in `device`, and defines `type`. If entries have more fields,
    it also defines `robots`.
    """

    calibration: ClassVar[str] = "tetractl.lab.calibrate:calibrate_robots"
    stopping: ClassVar[str] = "tetractl.lab.actuators.own_robots:stop_all"
    dead_zone_max: ClassVar[int] = 0
    unit_mm: ClassVar[float] = 1.0
    """The speed of a wheel that receives 1 [mm/s]."""
    watchdog_s: ClassVar[float] = 0.25
    """Time without a command after which the robots stop by themselves [s]."""
    unique: ClassVar[tuple[str, ...]] = ("address",)
    """Fields in which the entries of two robots must differ, in addition to the name."""
    rate: float = Field(default=20.0, ge=10, le=200, allow_inf_nan=False)
    """Commands to each robot per second [Hz]."""
    delay: float = Field(default=0.01, ge=0, le=0.2, allow_inf_nan=False)
    """Time from sending a command until the wheels follow it [s]."""
    speed_max_mm_s: Positive = Field(default=400.0, le=5000)
    """Maximum wheel speed that is sent [mm/s]."""
    robots: tuple[OwnRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield place and text of each problem with robots, addresses, wheels, speeds and rate."""
        from tetractl.lab.udp_port import SCHEME, address_of

        yield from mismatches(self.robots, setup.names, self.unique)
        yield from too_fast(setup, self.speed_max_mm_s)
        yield from unknown_radii(setup, [robot.radius_mm for robot in self.robots])
        for i, robot in enumerate(self.robots):
            if robot.address.startswith(SCHEME) and address_of(robot.address) is None:
                yield ("robots", i, "address"), f"must be {SCHEME}HOST:PORT"
        if setup.watchdog_s > self.watchdog_s:
            text = f"stop after {self.watchdog_s:g} s without a command: set wheels.watchdog to it"
            yield (), f"robots of type {self.type} {text}"
        if self.rate * self.watchdog_s < 3:
            yield ("rate",), f"must be three commands in {self.watchdog_s:g} s, as some are lost"

    def bounds(self) -> dict[str, str]:
        """Return addresses, rate and the largest wheel speed as {name: text}, for display."""
        ports = ", ".join(robot.address for robot in self.robots)
        return {
            "robots": f"{ports}, {self.rate:g} commands per second each",
            "wheel speeds": f"at most {self.speed_max_mm_s:g} mm/s",
        }

    def outputs(self, name: str, limit: int) -> tuple[float, int]:
        """Return the output for a 127th of the maximum wheel speed, and for `limit` of these."""
        unit = self.speed_max_mm_s / self.unit_mm / 127
        return unit, int(unit * limit)

    def measured(self, calibrated: Found) -> dict[str, Any]:
        """Return a robot's r and gains."""
        return wheel_gains(calibrated, self.unit_mm)
