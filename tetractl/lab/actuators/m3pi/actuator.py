"""The actuator of m3pi robots, which converts the common direction to wheel speeds.

An XBee radio sends the wheel speeds to the robots.
"""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.poses import Floats
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.actuators.m3pi.broadcast import Broadcaster
from tetractl.lab.actuators.m3pi.section import M3piRobot, M3piSection, WheelSection
from tetractl.lab.actuators.wheel_commands import WheeledActuator
from tetractl.lab.actuators.xbee.link import XbeeLink
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import PortFactory
from tetractl.model.wheels import CountArray, Drivetrains
from tetractl.spec.lab_section import entry

RADIO_NS = 7_000_000
"""Time from writing a broadcast at 57600 baud until the wheels follow it [ns]."""


class M3piActuator(WheeledActuator):
    """Drives m3pi robots, which have two wheels, over an XBee radio; see `Actuator`.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        ports: Creates the serial port of the `XbeeLink`. None for a port of this computer.
    """

    def __init__(
        self, section: M3piSection, setup: Setup, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.robots = [entry(section.robots, name) for name in setup.names]
        self.link = XbeeLink(section, clock, ports)
        self._radio = Broadcaster(self.link, clock, [section.index(name) for name in setup.names])
        self.drivetrains = drivetrains(self.robots)
        super().__init__(
            setup,
            clock,
            link=self.link,
            stated_radii_mm=[robot.radius_mm for robot in self.robots],
            drivetrains=self.drivetrains,
            delay_ns=RADIO_NS,
            rate=section.commands_hz,
            ask=self._radio.poll,
            warn_v=section.battery_warn,
        )

    def check(self) -> Health:
        """Return the operator's questions about the radio module, such as about its firmware."""
        return Health(questions=self.link.questions)

    def _halt(self, emergency: bool) -> int:
        """Send one stop to all robots; see `WheeledActuator`."""
        return self._radio.send(Flag.EMERGENCY_STOP if emergency else Flag(0))

    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send the wheel counts of all robots in one frame; see `WheeledActuator`."""
        counts_by_robot = outputs.T.tolist()
        sent_ns = self._radio.drive([(counts[0], counts[1]) for counts in counts_by_robot])
        return sent_ns, self.drivetrains.speeds(outputs)


def _signed_gains(wheels: Sequence[WheelSection]) -> list[float]:
    """Return the gains of wheels [mm/s per count], negative for inverted wheels."""
    return [-wheel.gain_mm if wheel.invert else wheel.gain_mm for wheel in wheels]


def drivetrains(robots: Sequence[M3piRobot]) -> Drivetrains:
    """Return the wheels of m3pi robots, with their gains, dead zones and directions."""
    left_wheels = [robot.left for robot in robots]
    right_wheels = [robot.right for robot in robots]
    left_zones = [wheel.dead_zone for wheel in left_wheels]
    right_zones = [wheel.dead_zone for wheel in right_wheels]
    return Drivetrains(
        gain=np.array([_signed_gains(left_wheels), _signed_gains(right_wheels)]),
        dead_zone=np.array([left_zones, right_zones]),
        limit=np.array([robot.limit for robot in robots]),
        swap=np.array([robot.swap for robot in robots]),
    )
