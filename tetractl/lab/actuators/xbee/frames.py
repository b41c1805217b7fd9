"""XBee API frames: one dataclass per frame type, big-endian fields in wire order.

Both directions are packed and parsed: the PC sends what an emulated module receives. In
transparent mode, which the robots' modules use, there are no frames: bytes go as they are.
"""

import struct
from dataclasses import astuple, dataclass
from typing import Any, ClassVar

from tetractl.core.errors import WireError

EXPLICIT_RECEIVE = 0x91  # type of the frames that replace others with AO=1
BROADCAST_16 = 0xFFFF


@dataclass(frozen=True, slots=True)
class XbeeFrame:
    """A frame type: `API` is its id, `LAYOUT` its fields; a last field `data` takes the rest."""

    API: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]
    HAS_DATA: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class Transmit16(XbeeFrame):
    """0x01: send to a 16-bit address, 0xFFFF to all, which is never acknowledged."""

    API = 0x01
    LAYOUT = struct.Struct(">BHB")
    frame_id: int
    destination: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AtCommand(XbeeFrame):
    """0x08: set or, without data, ask for a parameter of the local module."""

    API = 0x08
    LAYOUT = struct.Struct(">B2s")
    frame_id: int
    command: bytes  # two letters
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Receive64(XbeeFrame):
    """0x80: data from a 64-bit address; `rssi` in -dBm."""

    API = 0x80
    LAYOUT = struct.Struct(">QBB")
    source: int
    rssi: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Receive16(XbeeFrame):
    """0x81: data from a 16-bit address; `rssi` in -dBm."""

    API = 0x81
    LAYOUT = struct.Struct(">HBB")
    source: int
    rssi: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AtResponse(XbeeFrame):
    """0x88: the result of an AT command; status 0 is good."""

    API = 0x88
    LAYOUT = struct.Struct(">B2sB")
    frame_id: int
    command: bytes
    status: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class TransmitStatus(XbeeFrame):
    """0x89: the result of a 0x01; of a broadcast it proves nothing."""

    API = 0x89
    LAYOUT = struct.Struct(">BB")
    HAS_DATA = False
    frame_id: int
    status: int


@dataclass(frozen=True, slots=True)
class Receive(XbeeFrame):
    """0x90: data, from newer firmware."""

    API = 0x90
    LAYOUT = struct.Struct(">QHB")
    source: int
    short: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Other:
    """A frame of a type not named here, such as a modem status."""

    api: int
    data: bytes


FRAME_TYPES: dict[int, type[XbeeFrame]] = {
    kind.API: kind
    for kind in (Transmit16, AtCommand, Receive64, Receive16, AtResponse, TransmitStatus, Receive)
}


def pack_content(frame: XbeeFrame | Other) -> bytes:
    """Pack a frame's content: what stands between its length and its checksum."""
    if isinstance(frame, Other):
        if not 0 <= frame.api <= 0xFF:
            raise WireError(f"not an API id: {frame.api}")
        return bytes([frame.api]) + frame.data
    values = astuple(frame)
    fields, data = (values[:-1], values[-1]) if frame.HAS_DATA else (values, b"")
    if isinstance(frame, AtCommand | AtResponse) and (len(frame.command) != 2):
        raise WireError(f"an AT command has two letters: {frame.command!r}")
    try:
        return bytes([frame.API]) + frame.LAYOUT.pack(*fields) + data
    except struct.error as error:
        raise WireError(f"cannot pack a {type(frame).__name__}: {error}") from None


def parse_content(content: bytes) -> XbeeFrame | Other:
    """Read a frame's content; WireError if it is too short or too long for its type."""
    if not content:
        raise WireError("an empty frame")
    kind: Any = FRAME_TYPES.get(content[0])
    if kind is None:
        return Other(content[0], content[1:])
    size = 1 + kind.LAYOUT.size
    if len(content) < size or (len(content) > size and not kind.HAS_DATA):
        raise WireError(f"a {kind.__name__} of {len(content)} bytes")
    fields = kind.LAYOUT.unpack_from(content, 1)
    return kind(*fields, content[size:]) if kind.HAS_DATA else kind(*fields)
