"""Base class of actuators for your own robots: two wheels, and one port for each robot."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from pkgutil import resolve_name

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.lab.actuators.own_section import OwnRobot, OwnSection
from tetractl.lab.actuators.wheel_commands import WheeledActuator, wheels_by_speed
from tetractl.lab.actuators.wheeled_section import SpeedRobot, SpeedSection
from tetractl.lab.serial_port import PortFactory, PortGroup, stop_all_at
from tetractl.lab.udp_port import open_port
from tetractl.model.wheels import CountArray
from tetractl.spec.lab_section import entry

ROBOT_BAUD = 57600
"""Speed of robots' serial ports [bits per second]."""
SILENT_ROBOT_HINT = "is the robot switched on, and in the same network as this computer?"
"""The hint of errors if a robot cannot be reached."""


class SpeedRobots(WheeledActuator):
    """Base class of actuators that send each robot the speeds of its two wheels.

    Args:
        section: The actuator's section of the spec.
        robots: The entries of the robots in the section, in the setup's order.
        setup: The constants of the experiment, with the robots' names.
        clock: The clock of the run.
        ports: The robots' ports, not yet open.
    """

    def __init__(
        self,
        section: SpeedSection,
        robots: Sequence[SpeedRobot],
        setup: Setup,
        clock: Clock,
        ports: PortGroup,
    ) -> None:
        self.links = ports
        gains = np.array([(robot.left_gain, robot.right_gain) for robot in robots]).T
        self.gain = gains * section.unit_mm
        """True speed of a wheel per unit sent [mm/s], shape (2, N): left and right wheels."""
        super().__init__(
            setup,
            clock,
            link=self.links,
            stated_radii_mm=[robot.radius_mm for robot in robots],
            drivetrains=wheels_by_speed(self.gain, section.speed_max_mm_s / section.unit_mm),
            delay_ns=round(section.delay * SECOND),
            rate=section.rate,
        )


class OwnRobots(SpeedRobots):
    """Base class of actuators for your own two-wheeled robots, which do not answer.

    A subclass defines `packed`, which encodes the wheel speeds of a robot. If the robots have an
    emergency stop that lasts, it also defines `halt`. See `tetractl.core.protocols.Actuator`.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment.
        clock: The clock for times.
        ports: Creates a port from the arguments of `SerialPort`, for example a port in memory. None
            for the ports of this computer.

    Attributes:
        robots: The entry of each robot in the section, in the order of the setup.
        radii: Distance of each robot's wheels from its centre [mm], shape (N,).
    """

    def __init__(
        self, section: OwnSection, setup: Setup, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.robots: list[OwnRobot] = [entry(section.robots, name) for name in setup.names]
        create_port = ports or open_port
        robot_ports = PortGroup(
            create_port(
                robot.address, ROBOT_BAUD, robot.name, clock, lambda *_: None, SILENT_ROBOT_HINT
            )
            for robot in self.robots
        )
        super().__init__(section, self.robots, setup, clock, robot_ports)

    @abstractmethod
    def packed(self, row: int, left: int, right: int) -> bytes:
        """Encode the message to one robot that sets the speeds of its wheels.

        Args:
            row: Index of the robot in the setup.
            left: Speed of the left wheel, in units of the section's `unit_mm`.
            right: Speed of the right wheel, in the same unit.

        Returns:
            The bytes that are sent to the robot's port.
        """

    def halt(self, row: int, emergency: bool) -> bytes:
        """Encode the message that stops one robot. By default, it sets both wheel speeds to 0.

        Args:
            row: Index of the robot in the setup.
            emergency: Whether the stop should last until the robot is switched off.

        Returns:
            The bytes that are sent to the robot's port.
        """
        return self.packed(row, 0, 0)

    def _halt(self, emergency: bool) -> int:
        """Send each robot the message that stops it; see `WheeledActuator`."""
        rows = range(len(self.robots))
        return self.links.send(self.halt(row, emergency) for row in rows)

    def _drive(self, outputs: CountArray) -> tuple[int, Floats]:
        """Send each robot the message with its wheel speeds; see `WheeledActuator`."""
        wheel_outputs = enumerate(outputs.T.tolist())
        sent_ns = self.links.send(
            self.packed(row, left, right) for row, (left, right) in wheel_outputs
        )
        return sent_ns, outputs * self.gain


def stop_all(section: OwnSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Send every robot ten emergency stops within 200 ms; see `ActuatorSection.stop_all`.

    Args:
        section: The fields of the actuator in the spec.
        setup: The constants of the experiment, with the robots' names.
        clock: The clock for timeouts.
        alone: False if a run uses the ports at the same time.

    Returns:
        A sentence that tells the operator how many stops were sent.

    Raises:
        AbortError: If some robots were not reached. The error names them.
        PortHeldError: If `alone` is True and another process has a port open.
    """
    actuator: OwnRobots = resolve_name(section.device)(section, setup, clock)
    return stop_all_at(actuator.links.ports, partial(actuator.stop, emergency=True), clock, alone)
