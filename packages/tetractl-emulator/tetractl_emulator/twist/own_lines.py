"""The base of emulated robots of another make: two wheels, a port each, a message for each command.

A side of your own derives from `OwnLines` and reads a message: a datagram, or a line of a serial
port without its end.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, ClassVar, Protocol

from tetractl.core.errors import WireError
from tetractl.lab.actuators.own_robots import ROBOT_BAUD
from tetractl.lab.actuators.own_section import OwnSection
from tetractl.lab.actuators.wheel_commands import Status
from tetractl.lab.serial_port import UNREADABLE, is_network
from tetractl.model.wheels import Counts
from tetractl_emulator.faults import ActingFaults, Fault
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import WHEELED_FAULTS, PortedSide, WheelsSettings
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio

# flags of a command in the record
RUN = 1
STOP = 2
NEEDS = "the section of robots that are emulated by OwnLines is an OwnSection"
Read = Callable[[bytes], Counts]


class OwnProgram:
    """A robot's program: the speeds of the newest message, until its watchdog ends them."""

    def __init__(self, read: Read, watchdog_s: float) -> None:
        self._read = read
        self._watchdog_ms = round(watchdog_s * 1000)
        self._speeds: Counts = (0, 0)
        self._heard_ms = 0

    def push(self, data: bytes, now_ms: int) -> None:
        """Take a message; one that cannot be read changes nothing."""
        with suppress(*UNREADABLE):
            self._speeds = self._read(data)
            self._heard_ms = now_ms

    def wheels(self, now_ms: int) -> Counts:
        """Return the speeds that act now [mm/s]."""
        return self._speeds if now_ms - self._heard_ms < self._watchdog_ms else (0, 0)

    def status(self, now_ms: int) -> Status:
        """Return whether the robot drives, or stands because no message arrived."""
        if now_ms - self._heard_ms >= self._watchdog_ms:
            return Status.SILENT
        return Status.RUNNING if any(self._speeds) else Status(0)

    def take_reply(self, now_ms: int) -> bytes:
        """Return nothing: the robot does not answer."""
        return b""

    def set_battery(self, battery_mv: int) -> None:
        """Do nothing: the robot does not measure its battery."""


class ReadsMessages(Protocol):
    """A side whose robots each take messages at a port of their own."""

    @property
    def robots(self) -> Sequence[EmulatedRobot]:
        """The robots, in the setup's order."""
        ...

    def read(self, message: bytes, row: int) -> Counts:
        """Return the wheel speeds that a message asks of a robot.

        Args:
            message: The message.
            row: The robot's place in the setup.

        Returns:
            The speeds of the left and the right wheel [unit_mm mm/s].

        Raises:
            Exception: One of UNREADABLE, such as ValueError, if the message cannot be read.
        """
        ...


class OwnRadio(LineRadio):
    """The connection to one robot that has a port of its own.

    Args:
        stage: What the emulated devices share.
        port: Name of the port.
        side: Reads the robot's messages.
        row: Index of the robot in the setup.
        loss: Probability that a message is lost.
        baud: Speed of the port [bits/s].
    """

    end = b""

    def __init__(
        self,
        stage: Stage,
        port: str,
        side: ReadsMessages,
        row: int,
        loss: float,
        baud: int = ROBOT_BAUD,
    ) -> None:
        robots = side.robots[row : row + 1]
        seed = stage.options.seed + row
        super().__init__(stage, stage.wires.port(port), baud, robots, [row], loss, seed)
        self._side = side
        self._row = row
        self._whole = is_network(port)

    def stop_elsewhere(self, sequence: int) -> None:
        """Do nothing: a robot has no emergency stop that another sender could press."""

    def _split(self, data: bytes) -> list[bytes]:
        return [data, b""] if self._whole else [line.rstrip() for line in super()._split(data)]

    def _command(self, sealed: bytes) -> dict[str, Any]:
        try:
            speeds = self._side.read(sealed, self._row)
        except UNREADABLE as error:
            raise WireError(str(error)) from None
        drives = [row == self._row and any(speeds) for row in range(len(self._side.robots))]
        return {"flags": RUN if any(speeds) else STOP, "motors": [*speeds], "drives": drives}


class OwnLines(PortedSide):
    """Robots at the addresses of an `OwnSection`."""

    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        kind for kind in WHEELED_FAULTS if kind.__name__ not in ("stopped_elsewhere", "low_battery")
    )

    def __init__(self, stage: Stage, settings: WheelsSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, OwnSection), NEEDS
        self._watchdog_s = section.watchdog_s
        limit = section.speed_max_mm_s / section.unit_mm, section.unit_mm
        super().__init__(stage, settings, limit)
        self.radios = [
            OwnRadio(stage, stated.address, self, row, settings.loss)
            for row, stated in enumerate(self.stated)
        ]

    @abstractmethod
    def read(self, message: bytes, row: int) -> Counts:
        """Return the wheel speeds left and right that a message requests of a robot [unit_mm mm/s].

        It may raise any of UNREADABLE, such as ValueError, if the message cannot be read. `row` is
        the robot's index.
        """

    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create a robot with a program that reads messages; see `PortedSide.make_robot`."""

        def program(index: int) -> OwnProgram:
            return OwnProgram(lambda message: self.read(message, index), self._watchdog_s)

        return EmulatedRobot(name, row, battery_mv, program, acting)
