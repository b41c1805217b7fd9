"""Encode and decode the binary messages between PC and robots: COBS frames with a checksum.

Consistent overhead byte stuffing (COBS) removes every byte 00 from a message. A 00 therefore always
marks the end of a frame, and a reader that has lost bytes resynchronises at the next 00. The
checksum is CRC-16/CCITT-FALSE. This module also defines the flags of commands.
"""

import binascii
import struct
from enum import IntFlag

from tetractl.core.errors import WireError

PAYLOAD_BYTES_MAX = 80
"""Maximum number of payload bytes in a frame, including the closing CRC."""


class Flag(IntFlag):
    """Flags of a command to a robot or a coil driver. The firmware of the devices defines the same.

    RUN: Without this flag, every robot stops, and both currents of a coil driver go to 0.
    EMERGENCY_STOP: The device latches its stop until it is switched off.
    POLL: The device replies.
    """

    RUN = 1
    EMERGENCY_STOP = 2
    POLL = 4


def parse_flags(flags: int) -> Flag:
    """Convert the flag byte of a command to flags. Unknown flags are refused.

    Raises:
        WireError: If there are unknown flags.
    """
    if flags & ~7:
        raise WireError(f"unknown flags 0x{flags:02X}")
    return Flag(flags)


def crc16(data: bytes) -> int:
    """Compute the checksum CRC-16/CCITT-FALSE.

    The polynomial is 0x1021, and the start value 0xFFFF. The checksum of b"123456789" is 0x29B1.
    """
    return binascii.crc_hqx(data, 0xFFFF)


def encode(payload: bytes) -> bytes:
    """Encode a payload with COBS, and append the closing byte 00.

    The payload has at most PAYLOAD_BYTES_MAX bytes.

    Such a short payload never needs the full blocks of 254 bytes that COBS also defines.
    """
    blocks = payload.split(b"\0")
    return b"".join(bytes([len(block) + 1]) + block for block in blocks) + b"\0"


def decode(frame: bytes) -> bytes:
    """Decode a COBS frame, which is given without the closing byte 00.

    Raises:
        WireError: If it is not a complete COBS frame.
    """
    if not frame or 0 in frame:
        raise WireError("not a COBS frame")
    blocks: list[bytes] = []
    while frame:
        size = frame[0]
        frame = frame[1:]
        if len(frame) < size - 1:
            raise WireError("the COBS frame ends too early")
        blocks.append(frame[: size - 1])
        frame = frame[size - 1 :]
    return b"\0".join(blocks)


def encode_with_crc(payload: bytes) -> bytes:
    """Append the checksum (little-endian) to a payload, and encode both as a COBS frame.

    Raises:
        WireError: If the payload is too long for a frame.
    """
    if len(payload) + 2 > PAYLOAD_BYTES_MAX:
        raise WireError(f"{len(payload)} bytes do not fit into a frame")
    return encode(payload + crc16(payload).to_bytes(2, "little"))


def decode_with_crc(frame: bytes) -> bytes:
    """Decode a COBS frame, check its checksum, and return the payload.

    Args:
        frame: The frame, without the closing byte 00.

    Raises:
        WireError: If the CRC or the size is wrong.
    """
    payload = decode(frame)
    if not 2 < len(payload) <= PAYLOAD_BYTES_MAX:
        raise WireError(f"a frame cannot have {len(payload)} bytes")
    if crc16(payload[:-2]) != int.from_bytes(payload[-2:], "little"):
        raise WireError("wrong CRC")
    return payload[:-2]


def pack_fields(layout: struct.Struct, *fields: int) -> bytes:
    """Pack numbers into a binary message for a robot: payload, checksum, COBS encoding.

    Args:
        layout: The layout of the payload.
        *fields: The values of its fields, in order.

    Raises:
        WireError: If a value is outside the range of its field.
    """
    try:
        return encode_with_crc(layout.pack(*fields))
    except struct.error as error:
        raise WireError(f"cannot pack {fields[1:]}: {error}") from None


def unpack_fields(layout: struct.Struct, message_type: int, frame: bytes) -> tuple[int, ...]:
    """Decode a binary message of a known type, and return the fields after its type byte.

    Args:
        layout: Layout of the payload.
        message_type: The expected type.
        frame: The frame, without the closing byte 00.

    Raises:
        WireError: If the type or the size is different.
    """
    payload = decode_with_crc(frame)
    if len(payload) != layout.size or payload[0] != message_type:
        raise WireError(
            f"expected a frame of type 0x{message_type:02X} with {layout.size} bytes, but received "
            f"type 0x{payload[0]:02X} with {len(payload)} bytes"
        )
    return layout.unpack(payload)[1:]


class FrameSplitter:
    """Splits a byte stream into frames, which end with 00.

    The splitter stores at most one unfinished frame, and drops frames that are too long.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._is_skipping = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes, and return the frames that they complete, without the closing 00."""
        frames: list[bytes] = []
        *finished, unfinished = bytes(data).split(b"\0")
        for chunk in finished:
            self._add(chunk)
            if self._buffer and not self._is_skipping:
                frames.append(bytes(self._buffer))
            self._buffer.clear()
            self._is_skipping = False
        self._add(unfinished)
        return frames

    def _add(self, chunk: bytes) -> None:
        """Append bytes to the unfinished frame. If the frame gets too long, skip the rest of it."""
        if self._is_skipping:
            return
        if len(self._buffer) + len(chunk) > PAYLOAD_BYTES_MAX + 1:
            self._is_skipping = True
            self._buffer.clear()
        else:
            self._buffer += chunk
