"""The actuator of m3pi robots: turns the common direction into wheel counts, sent over an XBee."""

from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import Clock
from tetractl.core.commands import Action, Health, Steer, Stop, Transmission, Turn
from tetractl.core.poses import Pose
from tetractl.core.setup import Setup
from tetractl.lab.actuators.m3pi.broadcast import Broadcaster
from tetractl.lab.actuators.m3pi.section import M3piRobot, M3piSection
from tetractl.lab.actuators.wheel_commands import WheelCommands, WheeledActuator
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import Ports
from tetractl.model.wheels import STOP, Counts, Drivetrains

RADIO_NS = 7_000_000  # from writing a broadcast at 57600 baud until it reaches the wheels


class M3piActuator(WheeledActuator):
    """Drives the setup's robots; see `tetractl.core.protocols.Actuator`. `ports` is for `Link`."""

    def __init__(
        self, section: M3piSection, setup: Setup, clock: Clock, ports: Ports | None = None
    ) -> None:
        self.robots = [section.robot(name) for name in setup.names]
        self.link = Link(section, clock, ports)
        self._radio = Broadcaster(self.link, clock, [section.index(name) for name in setup.names])
        self.drivetrains = drivetrains(self.robots)
        radii = [robot.radius_mm for robot in self.robots]
        commands = WheelCommands(setup, clock, radii, self.drivetrains, RADIO_NS)
        rest = section.rate, section.battery_warn
        super().__init__(setup, self.link, self._radio.poll, commands, *rest)

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
        return self._sent(self._radio.drive(counts), action, counts, tuple(moving))

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop every robot; it latches an emergency stop until it is switched off."""
        sent_ns = self._radio.send(Flag.EMERGENCY_STOP if emergency else Flag(0))
        still = [STOP] * len(self.robots)
        return self._sent(sent_ns, Stop(), still, (False,) * len(still))

    def counts(
        self, action: Steer | Turn, poses: Sequence[Pose | None], exposed_ns: int
    ) -> list[Counts]:
        """Return the wheel counts for the speeds of `WheelCommands.wished`."""
        wished = self._commands.wished(action, poses, exposed_ns)
        return [(one, two) for one, two in self._commands.host.counts(wished).T.tolist()]

    def _sent(
        self, sent_ns: int, action: Action, counts: Sequence[Counts], moving: tuple[bool, ...]
    ) -> Transmission:
        speeds = self.drivetrains.speeds(np.array(counts).T)
        return self._transmission(sent_ns, action, speeds, moving)


def drivetrains(robots: Sequence[M3piRobot]) -> Drivetrains:
    """Return robots' wheels."""
    sides = [[robot.left for robot in robots], [robot.right for robot in robots]]
    return Drivetrains(
        np.array([[-w.gain_mm if w.invert else w.gain_mm for w in side] for side in sides]),
        np.array([[wheel.dead_zone for wheel in side] for side in sides]),
        np.array([robot.limit for robot in robots]),
        np.array([robot.swap for robot in robots]),
    )
