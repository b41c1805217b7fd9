"""Base class of the spec's section for your own robots: two wheels, and one port for each robot."""

from collections.abc import Iterator
from typing import ClassVar

from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.actuators.wheeled_section import SpeedRobot, SpeedSection
from tetractl.spec.lab_section import mismatches
from tetractl.spec.yaml.problems import Loc


class OwnRobot(SpeedRobot):
    """The spec's entry for one of your own two-wheeled robots: its wheels and its address."""

    address: str = Field(min_length=1, max_length=500)
    """Port that the robot's commands are sent to: udp://HOST:PORT, or a serial port.

    An example of a serial port is /dev/rfcomm0.
    """


class OwnSection(SpeedSection):
    """Robots on two wheels, each with its own port.

    A subclass names its subclass of `OwnRobots` in `device`, and defines `type`. If the entries of
    its robots have more fields, it also defines `robots`.
    """

    stopping: ClassVar[str] = "tetractl.lab.actuators.own_robots:stop_all"
    watchdog_s: ClassVar[float] = 0.25
    """Time without a command after which the robots stop by themselves [s]."""
    unique: ClassVar[tuple[str, ...]] = ("address",)
    """Fields in which the entries of two robots must differ, in addition to the name."""
    robots: tuple[OwnRobot, ...] = Field(min_length=1, max_length=32)
    """One entry for each robot of the spec."""

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield each problem with these fields of the spec: its field, and a message.

        The robots, addresses, wheels, speeds and rate are checked.
        """
        from tetractl.lab.udp_port import SCHEME, parse_address

        yield from mismatches(self.robots, setup.names, self.unique)
        yield from self.wheel_contradictions(setup, self.robots)
        for i, robot in enumerate(self.robots):
            if robot.address.startswith(SCHEME) and parse_address(robot.address) is None:
                yield ("robots", i, "address"), f"must be {SCHEME}HOST:PORT"
        if setup.watchdog_s > self.watchdog_s:
            text = (
                f"stop after {self.watchdog_s:g} s without a command: set wheels.watchdog "
                "to this value"
            )
            yield (), f"robots of type {self.type} {text}"
        if self.rate * self.watchdog_s < 3:
            yield (
                ("rate",),
                (
                    "must be high enough for three commands within "
                    f"{self.watchdog_s:g} s, because some commands are lost"
                ),
            )

    def bounds(self) -> dict[str, str]:
        """Return addresses, rate and maximum wheel speed as {name: text}, for display."""
        ports = ", ".join(robot.address for robot in self.robots)
        return {
            "robots": f"{ports}, {self.rate:g} commands per second each",
            "wheel speeds": f"at most {self.speed_max_mm_s:g} mm/s",
        }
