"""Frames to and from the current driver of two coil pairs, as bytes.

Command: 53 sequence flags, i16 x, i16 y [mA], CRC. Reply, only when polled: 54 sequence status
version, i16 measured x, y [mA], u16 supply [mV], i16 temperature [0.1 degrees Celsius], u16 frames
received, u16 frames rejected, u16 greatest current [mA], u32 slew [mA/s], u16 watchdog [ms], CRC.
All little-endian, sealed by `cobs.frame_with_crc`. `firmware/field_core.c` is the driver's side.
"""

import struct
from dataclasses import dataclass
from enum import IntFlag

from tetractl.core.errors import WireError
from tetractl.lab.cobs import checked_payload, frame_with_crc

COMMAND, REPLY = 0x53, 0x54
VERSION = 1
UNKNOWN_TEMPERATURE = -32768
_COMMAND = struct.Struct("<BBBhh")
_REPLY = struct.Struct("<BBBBhhHhHHHIH")


class FieldFlag(IntFlag):
    """Flags of a command."""

    RUN = 1  # without it both currents go to 0
    EMERGENCY_STOP = 2  # both currents go to 0, and stay so until the driver is switched off
    POLL = 4  # the driver answers


class DriverStatus(IntFlag):
    """Status flags of the driver."""

    RUNNING = 1  # the last frame let it run
    EMERGENCY_STOPPED = 2
    SILENT = 4  # the watchdog has stopped it
    LIMITED = 8  # the last frame asked for more than the greatest current
    HOT = 16  # its temperature has stopped it; latched like an emergency stop


@dataclass(frozen=True, slots=True)
class FieldCommand:
    """The currents of both coil pairs [mA]; ignored without `FieldFlag.RUN`."""

    sequence: int
    flags: FieldFlag
    x_ma: int = 0
    y_ma: int = 0


@dataclass(frozen=True, slots=True)
class FieldReply:
    """What a polled driver answers; `sequence` is that of the poll.

    The currents [mA] are measured. `supply_mv` 0 and `temperature_dc` `UNKNOWN_TEMPERATURE` (in
    tenths of a degree Celsius) mean not known. `received` and `rejected` count frames with a right
    and a wrong CRC, modulo 65536. The last three are the driver's own limits: of each current [mA],
    of its change [mA/s], and of the silence after which it stops [ms].
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
    """Pack a command, with its closing 00."""
    if command.flags & ~7:
        raise WireError(f"unknown flags 0x{int(command.flags):02X}")
    fields = command.sequence, command.flags, command.x_ma, command.y_ma
    return frame_with_crc(_pack(_COMMAND, COMMAND, *fields))


def decode_command(frame: bytes) -> FieldCommand:
    """Read a command, given without its closing 00."""
    sequence, flags, x_ma, y_ma = _unpack(_COMMAND, COMMAND, frame)
    if flags & ~7:
        raise WireError(f"unknown flags 0x{flags:02X}")
    return FieldCommand(sequence, FieldFlag(flags), x_ma, y_ma)


def encode_reply(reply: FieldReply) -> bytes:
    """Pack a reply, with its closing 00."""
    r = reply
    measured = r.x_ma, r.y_ma, r.supply_mv, r.temperature_dc, r.received, r.rejected
    limits = r.current_max_ma, r.slew_ma_s, r.watchdog_ms
    return frame_with_crc(_pack(_REPLY, REPLY, r.sequence, r.status, r.version, *measured, *limits))


def decode_reply(frame: bytes) -> FieldReply:
    """Read a reply, given without its closing 00; unknown status bits are dropped."""
    sequence, status, *rest = _unpack(_REPLY, REPLY, frame)
    return FieldReply(sequence, DriverStatus(status & 31), *rest)


def _pack(layout: struct.Struct, *fields: int) -> bytes:
    try:
        return layout.pack(*fields)
    except struct.error as error:
        raise WireError(f"cannot pack {fields}: {error}") from None


def _unpack(layout: struct.Struct, kind: int, frame: bytes) -> tuple[int, ...]:
    payload = checked_payload(frame)
    if len(payload) != layout.size or payload[0] != kind:
        raise WireError(f"no frame of type 0x{kind:02X}")
    return layout.unpack(payload)[1:]
