"""The actuator of m3pi robots: turns the common direction into wheel counts, sent over an XBee."""

from collections.abc import Sequence
from typing import Self

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Action, Health, RobotStatus, Steer, Stop, Transmission, Turn
from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.lab.actuators.m3pi.broadcast import Broadcaster
from tetractl.lab.actuators.m3pi.section import M3piRobot, M3piSection
from tetractl.lab.actuators.wheel_commands import WheelCommands, robot_status
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import Ports
from tetractl.model.wheels import STOP, Counts, Drivetrains

RADIO_NS = 7_000_000  # from writing a broadcast at 57600 baud until it reaches the wheels


class M3piActuator:
    """Drives the setup's robots; see `tetractl.core.protocols.Actuator`. `ports` is for `Link`."""

    individual = True
    halts = True

    def __init__(
        self, section: M3piSection, setup: Setup, clock: Clock, ports: Ports | None = None
    ) -> None:
        self.section, self.names = section, setup.names
        self.robots = [section.robot(name) for name in setup.names]
        self.link = Link(section, clock, ports)
        self._radio = Broadcaster(self.link, clock, [section.index(name) for name in setup.names])
        self.drivetrains = drivetrains(self.robots)
        radii = [robot.radius_mm for robot in self.robots]
        self._commands = WheelCommands(setup, clock, radii, self.drivetrains, RADIO_NS)

    def __enter__(self) -> Self:
        """Open the port and check the XBee module."""
        try:
            self.link.open()
        except BaseException:
            self.link.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()

    @property
    def period_ns(self) -> int:
        """Time between two wheel commands while the direction stays the same [ns]."""
        return round(SECOND / self.section.rate)

    @property
    def failure(self) -> str | None:
        """The reason why nothing can be sent any more; None without a fault."""
        return self.link.failure

    def check(self) -> Health:
        """Return the radio's questions to the operator."""
        return Health(questions=self.link.questions)

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Send each robot its wheel counts; robots not `moving` get 0."""
        wished = self.counts(action, poses, exposed_ns)
        counts = [pair if may else STOP for pair, may in zip(wished, moving, strict=True)]
        return self._transmission(self._radio.drive(counts), action, counts, tuple(moving))

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop every robot; it latches an emergency stop until it is switched off."""
        sent_ns = self._radio.send(Flag.EMERGENCY_STOP if emergency else Flag(0))
        still = [STOP] * len(self.robots)
        return self._transmission(sent_ns, Stop(), still, (False,) * len(still))

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Ask every robot for its battery voltage and state."""
        replies, warn_v = self._radio.poll(timeout_s), self.section.battery_warn
        return [
            robot_status(name, one.status, one.battery_mv, warn_v)
            if one
            else robot_status(name, None)
            for name, one in zip(self.names, replies, strict=True)
        ]

    def counts(
        self, action: Steer | Turn, poses: Sequence[Pose | None], exposed_ns: int
    ) -> list[Counts]:
        """Return the wheel counts for the speeds of `WheelCommands.wished`."""
        wished = self._commands.wished(action, poses, exposed_ns)
        return [(one, two) for one, two in self._commands.host.counts(wished).T.tolist()]

    def _transmission(
        self, sent_ns: int, action: Action, counts: Sequence[Counts], moving: tuple[bool, ...]
    ) -> Transmission:
        speeds = self.drivetrains.speeds(np.array(counts).T)
        speed, turning = self._commands.sent(sent_ns, speeds)
        left, right = speeds / self._commands.mm
        return Transmission(action, sent_ns, moving, speed, turning, left, right)


def drivetrains(robots: Sequence[M3piRobot]) -> Drivetrains:
    """Return robots' wheels."""
    sides = [[robot.left for robot in robots], [robot.right for robot in robots]]
    return Drivetrains(
        np.array([[-w.gain_mm if w.invert else w.gain_mm for w in side] for side in sides]),
        np.array([[wheel.dead_zone for wheel in side] for side in sides]),
        np.array([robot.limit for robot in robots]),
        np.array([robot.swap for robot in robots]),
    )
