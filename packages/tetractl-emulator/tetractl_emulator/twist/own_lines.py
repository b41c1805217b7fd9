"""Base class for emulating your own robots: two wheels, a port for each robot, no answers.

Derive from `OwnLines`, and implement `read`. A message is a datagram, or a line of a serial port
without its end.
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

RUN_FLAG = 1
"""Flag of a recorded command: the robot may drive."""
STOP_FLAG = 2
"""Flag of a recorded command: the robot stops."""
NEEDS_OWN_SECTION = "the section of robots that are emulated by OwnLines is an OwnSection"
DecodeMessage = Callable[[bytes], Counts]
"""Decodes a message to the speeds of the left and the right wheel [unit_mm mm/s]."""


class OwnProgram:
    """A robot's program, which applies the newest message's speeds until its watchdog expires.

    Args:
        decode: Decodes a message to the speeds of the left and the right wheel [unit_mm mm/s].
        watchdog_s: Time without a message after which the robot stops [s].
    """

    def __init__(self, read: DecodeMessage, watchdog_s: float) -> None:
        self._decode = read
        self._watchdog_ms = round(watchdog_s * 1000)
        self._speeds: Counts = (0, 0)
        self._received_ms = 0

    def push(self, data: bytes, now_ms: int) -> None:
        """Process a message at a time [ms].

        A message that cannot be decoded is ignored, and does not reset the watchdog.
        """
        with suppress(*UNREADABLE):
            self._speeds = self._decode(data)
            self._received_ms = now_ms

    def wheels(self, now_ms: int) -> Counts:
        """Return the present speeds of the left and the right wheel [unit_mm mm/s].

        They are 0 after the watchdog has expired.
        """
        return self._speeds if now_ms - self._received_ms < self._watchdog_ms else (0, 0)

    def status(self, now_ms: int) -> Status:
        """Return the status: RUNNING, SILENT after the watchdog has expired, or 0 at standstill."""
        if now_ms - self._received_ms >= self._watchdog_ms:
            return Status.SILENT
        return Status.RUNNING if any(self._speeds) else Status(0)

    def take_reply(self, now_ms: int) -> bytes:
        """Return b"", because the robot does not answer."""
        return b""

    def set_battery(self, battery_mv: int) -> None:
        """Do nothing, because the robot does not measure its battery."""


class MessageDecoder(Protocol):
    """Decodes the messages of robots that each receive messages at their own port."""

    @property
    def robots(self) -> Sequence[EmulatedRobot]:
        """The robots, in the setup's order."""
        ...

    def read(self, message: bytes, row: int) -> Counts:
        """Decode a message to wheel speeds.

        Args:
            message: The message.
            row: Index of the robot in the setup.

        Returns:
            The speeds of the left and the right wheel [unit_mm mm/s].

        Raises:
            Exception: One of UNREADABLE, such as ValueError, if the message cannot be decoded.
        """
        ...


class OwnRadio(LineRadio):
    """The connection to one robot that has its own port.

    Args:
        stage: The data and functions that the emulated devices share.
        port: Name of the port.
        decoder: Decodes the robot's messages, for example an `OwnLines`.
        row: Index of the robot in the setup.
        loss: Probability that a message is lost.
        baud: Speed of the port [bits/s].
    """

    end = b""

    def __init__(
        self,
        stage: Stage,
        port: str,
        decoder: MessageDecoder,
        row: int,
        loss: float,
        baud: int = ROBOT_BAUD,
    ) -> None:
        robots = decoder.robots[row : row + 1]
        seed = stage.options.seed + row
        super().__init__(stage, stage.wires.port(port), baud, robots, [row], loss, seed)
        self._decoder = decoder
        self._row = row
        self._is_datagram = is_network(port)

    def stop_from_other_program(self, sequence: int) -> None:
        """Do nothing: such a robot has no emergency stop that another program could send."""

    def _split(self, data: bytes) -> list[bytes]:
        """Split received data into the complete messages, followed by the incomplete last one.

        Each datagram of a network is a complete message. At another port, a message is a line.
        """
        return (
            [data, b""] if self._is_datagram else [line.rstrip() for line in super()._split(data)]
        )

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Decode a message for the record: flags, motor speeds, and which robots it drives.

        WireError is raised if it cannot be decoded.
        """
        try:
            speeds = self._decoder.read(frame, self._row)
        except UNREADABLE as error:
            raise WireError(str(error)) from None
        drives = [row == self._row and any(speeds) for row in range(len(self._decoder.robots))]
        return {
            "flags": RUN_FLAG if any(speeds) else STOP_FLAG,
            "motors": [*speeds],
            "drives": drives,
        }


class OwnLines(PortedSide):
    """Base class of an emulated actuator for robots at the addresses of an `OwnSection`."""

    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        kind for kind in WHEELED_FAULTS if kind.__name__ not in ("stopped_elsewhere", "low_battery")
    )

    def __init__(self, stage: Stage, settings: WheelsSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, OwnSection), NEEDS_OWN_SECTION
        self._watchdog_s = section.watchdog_s
        limit = section.speed_max_mm_s / section.unit_mm, section.unit_mm
        super().__init__(stage, settings, limit)
        self.radios = [
            OwnRadio(stage, spec_entry.address, self, row, settings.loss)
            for row, spec_entry in enumerate(self.spec_entries)
        ]

    @abstractmethod
    def read(self, message: bytes, row: int) -> Counts:
        """Decode a message to wheel speeds; see `MessageDecoder.read`."""

    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create a robot whose program uses `read`; see `PortedSide.make_robot`."""

        def program(index: int) -> OwnProgram:
            return OwnProgram(lambda message: self.read(message, index), self._watchdog_s)

        return EmulatedRobot(name, row, battery_mv, program, acting)
