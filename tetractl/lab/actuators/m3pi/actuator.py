"""The actuator of m3pi robots: turns the common direction into wheel counts, sent over an XBee."""

import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Action, Health, RobotStatus, Steer, Stop, Transmission, Turn
from tetractl.core.poses import Pose
from tetractl.core.setup import MM, Setup
from tetractl.lab.actuators.m3pi.broadcast import Broadcaster, Reply, Status
from tetractl.lab.actuators.m3pi.section import M3piRobot, M3piSection
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cobs import Flag
from tetractl.lab.serial_port import Ports
from tetractl.model.wheels import STOP, Counts, Drivetrains, WheelHost

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
        self._clock = clock
        self._radio = Broadcaster(self.link, clock, [section.index(name) for name in setup.names])
        self._mm = setup.metres / MM  # millimetres per length unit of the spec
        radius = np.array([radius_mm(robot, setup) for robot in self.robots])
        self.drivetrains = wheels = drivetrains(self.robots)
        self._host = WheelHost(setup.a, setup.speed * self._mm, radius, setup.lag_s, wheels)

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
        replies = self._radio.poll(timeout_s)
        return [self._status(*pair) for pair in zip(self.names, replies, strict=True)]

    def counts(
        self, action: Steer | Turn, poses: Sequence[Pose | None], exposed_ns: int
    ) -> list[Counts]:
        """Return the wheel counts by `WheelHost`.

        Headings are predicted from the time of the poses, `exposed_ns`, to the time when the
        command reaches the wheels, over at most 0.1 s. Robots without a pose get counts of 0.
        """
        arrives = self._clock.now() + RADIO_NS
        since = max(exposed_ns, arrives - SECOND // 10)
        heading = np.array([0.0 if pose is None else pose.heading for pose in poses])
        drives = isinstance(action, Steer)
        u = action.direction if drives else action.facing
        wished = self._host.wished(heading, u, since, arrives, drives)
        wished[:, [pose is None for pose in poses]] = 0.0
        return [(one, two) for one, two in self._host.counts(wished).T.tolist()]

    def _transmission(
        self, sent_ns: int, action: Action, counts: Sequence[Counts], moving: tuple[bool, ...]
    ) -> Transmission:
        speeds = self.drivetrains.speeds(np.array(counts).T)
        speed, turning = self._host.sent(sent_ns + RADIO_NS, speeds)
        left, right = speeds / self._mm
        return Transmission(action, sent_ns, moving, speed / self._mm, turning, left, right)

    def _status(self, name: str, reply: Reply | None) -> RobotStatus:
        if reply is None:
            line = f"{name} does not answer: is it on, and is its index right?"
            return RobotStatus(False, problems=(line,))
        volts = reply.battery_mv / 1000 or None
        if reply.status & Status.EMERGENCY_STOPPED:
            line = f"{name} is emergency-stopped: switch it off and on again"
            return RobotStatus(True, volts, (line,))
        # its motors would soon fail
        if volts is not None and volts < 4.0:
            line = f"{name}'s battery is at {volts:.2f} V: charge it"
            return RobotStatus(True, volts, (line,))
        if volts is not None and volts < self.section.battery_warn:
            return RobotStatus(True, volts, (), (f"{name}'s battery is at {volts:.2f} V",))
        return RobotStatus(True, volts)


def drivetrains(robots: Sequence[M3piRobot]) -> Drivetrains:
    """Return robots' wheels."""
    sides = [[robot.left for robot in robots], [robot.right for robot in robots]]
    return Drivetrains(
        np.array([[-w.gain_mm if w.invert else w.gain_mm for w in side] for side in sides]),
        np.array([[wheel.dead_zone for wheel in side] for side in sides]),
        np.array([robot.limit for robot in robots]),
        np.array([robot.swap for robot in robots]),
    )


def radius_mm(robot: M3piRobot, setup: Setup) -> float:
    """Return the distance from a robot's wheels to its centre [mm], by default the spec's."""
    radius = robot.radius_mm
    if radius is None and setup.wheel_radius is not None:
        radius = setup.wheel_radius * setup.metres / MM
    return math.nan if radius is None else radius
