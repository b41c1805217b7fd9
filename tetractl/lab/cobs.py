"""COBS framing with a closing 00, CRC-16/CCITT-FALSE, and the flags of commands.

Consistent overhead byte stuffing removes every 00 from a frame. A 00 is therefore always the end of
a frame, and a reader that lost bytes resynchronises at the next 00.
"""

import binascii
import struct
from enum import IntFlag

from tetractl.core.errors import WireError

FRAME_MAX = 80  # payload bytes, including the closing CRC


class Flag(IntFlag):
    """Flags of a command; both firmwares know the same."""

    RUN = 1  # without it every robot stops, and both currents go to 0
    EMERGENCY_STOP = 2  # a latched stop, until the device is switched off
    POLL = 4  # the device replies


def checked_flags(flags: int) -> Flag:
    """Return a command's flags.

    Raises:
        WireError: If there are unknown flags.
    """
    if flags & ~7:
        raise WireError(f"unknown flags 0x{flags:02X}")
    return Flag(flags)


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(payload: bytes) -> bytes:
    """Encode a payload of at most `FRAME_MAX` bytes, and append the closing byte 00.

    Such a short payload never needs the full blocks of 254 bytes that COBS also has.
    """
    parts = payload.split(b"\0")
    return b"".join(bytes([len(part) + 1]) + part for part in parts) + b"\0"


def decode(frame: bytes) -> bytes:
    """Undo the stuffing of a frame, given without the closing byte 00."""
    if not frame or 0 in frame:
        raise WireError("not a COBS frame")
    parts: list[bytes] = []
    while frame:
        size = frame[0]
        frame = frame[1:]
        if len(frame) < size - 1:
            raise WireError("the COBS frame ends too early")
        parts.append(frame[: size - 1])
        frame = frame[size - 1 :]
    return b"\0".join(parts)


def frame_with_crc(payload: bytes) -> bytes:
    """Return the frame of a payload: append its CRC (little-endian), stuff, and close with 00."""
    if len(payload) + 2 > FRAME_MAX:
        raise WireError(f"{len(payload)} bytes do not fit into a frame")
    return encode(payload + crc16(payload).to_bytes(2, "little"))


def checked_payload(frame: bytes) -> bytes:
    """Return the payload of a frame, given without the closing byte 00.

    Raises:
        WireError: If the CRC or the size is wrong.
    """
    payload = decode(frame)
    if not 2 < len(payload) <= FRAME_MAX:
        raise WireError(f"a frame cannot have {len(payload)} bytes")
    if crc16(payload[:-2]) != int.from_bytes(payload[-2:], "little"):
        raise WireError("wrong CRC")
    return payload[:-2]


def pack_fields(layout: struct.Struct, *fields: int) -> bytes:
    """Pack fields into a payload, and return its frame: with a checksum, encoded, and terminated.

    Args:
        layout: The layout of the payload.
        *fields: The values of its fields, in order.

    Raises:
        WireError: If a value is outside the range of its field.
    """
    try:
        return frame_with_crc(layout.pack(*fields))
    except struct.error as error:
        raise WireError(f"cannot pack {fields[1:]}: {error}") from None


def unpack_fields(layout: struct.Struct, kind: int, frame: bytes) -> tuple[int, ...]:
    """Return the fields after the type byte of a frame.

    Args:
        layout: Layout of the payload.
        kind: The expected type.
        frame: The frame, without the closing byte 00.

    Raises:
        WireError: If the type or the size is different.
    """
    payload = checked_payload(frame)
    if len(payload) != layout.size or payload[0] != kind:
        raise WireError(f"not a frame of type 0x{kind:02X} with {layout.size} bytes")
    return layout.unpack(payload)[1:]


class Splitter:
    """Splits a byte stream at every 00. It keeps one frame at most, and drops longer ones."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take a chunk of bytes; return the frames that it completes, without their 00."""
        frames: list[bytes] = []
        *closed, rest = bytes(data).split(b"\0")
        for piece in closed:
            self._add(piece)
            if self._buffer and not self._skipping:
                frames.append(bytes(self._buffer))
            self._buffer.clear()
            self._skipping = False
        self._add(rest)
        return frames

    def _add(self, piece: bytes) -> None:
        if self._skipping:
            return
        if len(self._buffer) + len(piece) > FRAME_MAX + 1:
            self._skipping = True
            self._buffer.clear()
        else:
            self._buffer += piece
