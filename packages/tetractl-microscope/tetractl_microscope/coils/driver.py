"""The current driver on a serial port: encodes numbered commands, and decodes the replies.

The bytes of a command: 0x53, sequence, flags, i16 x, i16 y [mA], CRC. The bytes of a reply, which
is sent only if it is polled: 0x54, sequence, status, version, i16 measured x, i16 measured y [mA],
u16 supply [mV], i16 temperature [0.1 degrees Celsius], u16 frames received, u16 frames rejected,
u16 maximum current [mA], u32 maximum slew rate [mA/s], u16 watchdog [ms], CRC. All numbers are
little-endian. `cobs.encode_with_crc` creates the frames. `firmware/field_core.c` is the driver's
side.
"""

import struct
import threading
from contextlib import suppress
from dataclasses import astuple, dataclass
from enum import IntFlag

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import WireError
from tetractl.lab.cobs import Flag, FrameSplitter, pack_fields, parse_flags, unpack_fields
from tetractl.lab.serial_port import PortFactory, SerialPort

COMMAND = 0x53
REPLY = 0x54
VERSION = 1
UNKNOWN_TEMPERATURE = -32768
_COMMAND = struct.Struct("<BBBhh")
_REPLY = struct.Struct("<BBBBhhHhHHHIH")


class DriverStatus(IntFlag):
    """Status flags in a reply of the current driver."""

    RUNNING = 1  # the last frame set the run flag
    EMERGENCY_STOPPED = 2
    SILENT = 4  # stopped by the watchdog
    LIMITED = 8  # the last frame requested more than the maximum current
    HOT = 16  # stopped because it was too hot; latched like an emergency stop


@dataclass(frozen=True, slots=True)
class FieldCommand:
    """A command to the current driver. The driver ignores the currents without `Flag.RUN`.

    Attributes:
        sequence: Number of the command, modulo 256.
        flags: Flags of the command.
        x_ma: Current of the x coils [mA].
        y_ma: Current of the y coils [mA].
    """

    sequence: int
    flags: Flag
    x_ma: int = 0
    y_ma: int = 0


@dataclass(frozen=True, slots=True)
class FieldReply:
    """A reply of the current driver to a poll.

    Attributes:
        sequence: Number of the command that polled it.
        status: Status flags.
        version: Version of the protocol.
        x_ma: Measured current of the x coils [mA].
        y_ma: Measured current of the y coils [mA].
        supply_mv: Supply voltage [mV]. 0 if unknown.
        temperature_dc: Temperature [0.1 degrees Celsius]. UNKNOWN_TEMPERATURE if unknown.
        received: Number of frames with a correct CRC, modulo 65536.
        rejected: Number of frames with a wrong CRC, modulo 65536.
        current_max_ma: The driver's limit of each current [mA].
        slew_ma_s: The driver's limit of a current's rate of change [mA/s].
        watchdog_ms: Time without a frame after which the driver switches the field off [ms].
    """

    sequence: int
    status: DriverStatus
    version: int
    x_ma: int
    y_ma: int
    supply_mv: int
    temperature_dc: int
    received: int
    rejected: int
    current_max_ma: int
    slew_ma_s: int
    watchdog_ms: int


def encode_command(command: FieldCommand) -> bytes:
    """Encode a command to the current driver, including the closing byte 00."""
    parse_flags(command.flags)
    return pack_fields(_COMMAND, COMMAND, *astuple(command))


def decode_command(frame: bytes) -> FieldCommand:
    """Decode a command to the current driver, given without the closing byte 00.

    Raises:
        WireError: If the frame is not a valid command.
    """
    sequence, flags, x_ma, y_ma = unpack_fields(_COMMAND, COMMAND, frame)
    return FieldCommand(sequence, parse_flags(flags), x_ma, y_ma)


def decode_reply(frame: bytes) -> FieldReply:
    """Decode a reply of the current driver, given without the closing byte 00.

    Unknown status bits are ignored.

    Raises:
        WireError: If the frame is not a valid reply.
    """
    sequence, status, *values = unpack_fields(_REPLY, REPLY, frame)
    return FieldReply(sequence, DriverStatus(status & 31), *values)


SILENCE_MAX_NS = SECOND // 2
REPLY_MAX_S = 0.1
"""Maximum wait for a reply [s]: a driver needs 4 ms at 115200 baud, 50 ms at 9600."""
HINT = "the watchdog of the current driver switches the field off; the cells swim on"


class Driver:
    """A current driver on a serial port.

    Every frame polls the driver, so that `failure` can tell whether the driver has become silent,
    too hot or emergency-stopped.

    Args:
        port: Name of the port.
        baud: Its speed [bits per second].
        clock: The clock for times [ns].
        ports: Creates the serial port. None for `SerialPort`.
    """

    def __init__(
        self, port: str, baud: int, clock: Clock, ports: PortFactory | None = None
    ) -> None:
        self.newest: FieldReply | None = None
        self._clock = clock
        create_port = ports or SerialPort
        self._port = create_port(port, baud, "the current driver", clock, self._receive, HINT)
        self._splitter = FrameSplitter()
        self._lock = threading.Lock()
        self._sequence = clock.now() % 256  # a first number that no one can foretell
        self._latched_flags = Flag(0)
        # number of frames since the last reply, and when the first of them was sent
        self._unanswered_count = 0
        self._unanswered_since_ns = 0

    @property
    def failure(self) -> str | None:
        """The reason why the driver no longer makes a field. None if it does.

        Reasons are a failed port, silence, heat and an emergency stop.
        """
        newest = self.newest
        now_ns = self._clock.now()
        if self._port.failure is not None:
            return self._port.failure
        # some replies may be lost, or late
        if self._unanswered_count > 5 and now_ns - self._unanswered_since_ns > SILENCE_MAX_NS:
            return "the current driver does not answer any more"
        if newest is not None and DriverStatus.HOT in newest.status:
            return (
                "the current driver has stopped because it is "
                f"{newest.temperature_dc / 10:.0f} °C hot"
            )
        if self.is_emergency_stopped:
            return "the current driver is emergency-stopped"
        return None

    @property
    def is_emergency_stopped(self) -> bool:
        """Whether the newest reply reports an emergency stop, which lasts until a power cycle.

        It is False before the first reply.
        """
        newest = self.newest
        return newest is not None and DriverStatus.EMERGENCY_STOPPED in newest.status

    def open(self, exclusive: bool = True) -> None:
        """Open the port.

        Args:
            exclusive: Whether to lock the port, so that no other process can open it.

        Raises:
            AbortError: If the port cannot be opened.
        """
        self._port.open(exclusive)

    def send(self, flags: Flag, x_ma: int = 0, y_ma: int = 0) -> int:
        """Send a command, which also polls the driver.

        After an emergency stop, all commands are emergency stops.

        Args:
            flags: Flags of the command.
            x_ma: Current of the x coils [mA].
            y_ma: Current of the y coils [mA].

        Returns:
            When it was sent [ns].

        Raises:
            AbortError: If sending fails.
        """
        with self._lock:
            self._latched_flags |= flags & Flag.EMERGENCY_STOP
            self._sequence = (self._sequence + 1) % 256
            command = FieldCommand(
                self._sequence, flags | self._latched_flags | Flag.POLL, x_ma, y_ma
            )
            sent_ns = self._port.write(encode_command(command))
            if self._unanswered_count == 0:
                self._unanswered_since_ns = sent_ns
            self._unanswered_count += 1
        return sent_ns

    def ask(self) -> FieldReply | None:
        """Switch the field off, and poll the driver up to five times.

        It waits 0.1 s for each reply.

        Returns:
            The first reply. None if there is none.

        Raises:
            AbortError: If the port has failed.
        """
        self.newest = None
        for _ in range(5):
            self.send(Flag(0))
            sequence = self._sequence
            wait_for(
                self._clock,
                lambda number=sequence: self._port.failure is not None or self._answered(number),
                REPLY_MAX_S,
            )
            if self._answered(sequence):
                return self.newest
        return None

    def close(self) -> None:
        """Close the port. This method can be called repeatedly and never raises."""
        self._port.close()

    def _answered(self, sequence: int) -> bool:
        """Check whether the newest reply answers the command with this number.

        It does not if there is no reply yet, or if a later command was answered since.
        """
        return self.newest is not None and self.newest.sequence == sequence

    def _receive(self, data: bytes, now_ns: int) -> None:
        with self._lock:
            for frame in self._splitter.feed(data):
                with suppress(WireError):  # a damaged reply counts as missing
                    self.newest = decode_reply(frame)
                    self._unanswered_count = 0
