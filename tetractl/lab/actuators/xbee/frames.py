"""XBee API frames: one dataclass per frame type, big-endian fields in wire order.

Frames of either direction can be packed and parsed, since an emulated module reads the PC's frames.
In transparent mode, used by the robots' modules, there are no frames: bytes are sent unchanged.

An API frame is a delimiter 0x7E, the length, the content and a checksum; it is plain (AP=1) or
escaped (AP=2). In escaped frames a 0x7E is always the start of a frame, so a lost byte costs one
frame. In plain frames a 0x7E may be data: after a wrong checksum, the search for a start continues
behind the delimiter of the wrong frame.
"""

import struct
from dataclasses import astuple, dataclass
from typing import Any, ClassVar

from tetractl.core.errors import WireError

EXPLICIT_RECEIVE = 0x91  # type of the frames in which data is received with AO=1
BROADCAST_16 = 0xFFFF


@dataclass(frozen=True, slots=True)
class XbeeFrame:
    """A frame type: `API` is its id, `LAYOUT` the format of its fields; with `HAS_DATA`, a last
    field `data` takes the remaining bytes.
    """

    API: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]
    HAS_DATA: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class Transmit16(XbeeFrame):
    """0x01: send data to a 16-bit address, or, with 0xFFFF, to all modules without
    acknowledgement.
    """

    API = 0x01
    LAYOUT = struct.Struct(">BHB")
    frame_id: int
    destination: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AtCommand(XbeeFrame):
    """0x08: set a parameter of the local module or, without data, request its value."""

    API = 0x08
    LAYOUT = struct.Struct(">B2s")
    frame_id: int
    command: bytes  # two letters
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Receive64(XbeeFrame):
    """0x80: data from a 64-bit address; an `rssi` of 40 means -40 dBm."""

    API = 0x80
    LAYOUT = struct.Struct(">QBB")
    source: int
    rssi: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Receive16(XbeeFrame):
    """0x81: data from a 16-bit address; an `rssi` of 40 means -40 dBm."""

    API = 0x81
    LAYOUT = struct.Struct(">HBB")
    source: int
    rssi: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class AtResponse(XbeeFrame):
    """0x88: the result of an AT command; status 0 means success."""

    API = 0x88
    LAYOUT = struct.Struct(">B2sB")
    frame_id: int
    command: bytes
    status: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class TransmitStatus(XbeeFrame):
    """0x89: the result of a frame 0x01, 0 for success; a broadcast's success does not mean that it
    was received.
    """

    API = 0x89
    LAYOUT = struct.Struct(">BB")
    HAS_DATA = False
    frame_id: int
    status: int


@dataclass(frozen=True, slots=True)
class Receive(XbeeFrame):
    """0x90: received data, as a local module with newer firmware reports it; `source` is the
    sender's 64-bit address, `short` its 16-bit address.
    """

    API = 0x90
    LAYOUT = struct.Struct(">QHB")
    source: int
    short: int
    options: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Other:
    """A frame of a type without a class of its own, such as a modem status; `api` is the type."""

    api: int
    data: bytes


FRAME_TYPES: dict[int, type[XbeeFrame]] = {
    kind.API: kind
    for kind in (Transmit16, AtCommand, Receive64, Receive16, AtResponse, TransmitStatus, Receive)
}


def pack_content(frame: XbeeFrame | Other) -> bytes:
    """Pack a frame's content, the bytes between length and checksum."""
    if isinstance(frame, Other):
        if not 0 <= frame.api <= 0xFF:
            raise WireError(f"an API id is one byte, not {frame.api}")
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
        raise WireError(f"a {kind.__name__} frame cannot have {len(content)} bytes")
    fields = kind.LAYOUT.unpack_from(content, 1)
    return kind(*fields, content[size:]) if kind.HAS_DATA else kind(*fields)


START, ESCAPE = 0x7E, 0x7D
_ESCAPED = frozenset((START, ESCAPE, 0x11, 0x13))  # 0x11 and 0x13: XON, XOFF
CONTENT_MAX = 128  # 100 bytes of 802.15.4 payload and the longest header, rounded up


def encode(frame: XbeeFrame | Other, escaped: bool = True) -> bytes:
    """Pack one API frame, for AP=2 if `escaped`, otherwise for AP=1."""
    content = pack_content(frame)
    if len(content) > CONTENT_MAX:
        raise WireError(f"{len(content)} bytes do not fit in an API frame")
    raw = len(content).to_bytes(2, "big") + content + bytes([0xFF - sum(content) % 256])
    if not escaped:
        return bytes([START]) + raw
    out = bytearray([START])
    for byte in raw:
        out += bytes((ESCAPE, byte ^ 0x20)) if byte in _ESCAPED else bytes((byte,))
    return bytes(out)


class Decoder:
    """Finds frames in a byte stream, which may contain garbage and arrive in chunks of any size.

    Never raises and keeps at most one frame's bytes. It counts frames with a wrong checksum in
    `bad_checksums`, frames with a right checksum but a wrong length for their type in `malformed`,
    and bytes that belong to no good frame in `dropped_bytes`.
    """

    def __init__(self, escaped: bool = True) -> None:
        self.bad_checksums = 0
        self.malformed = 0
        self.dropped_bytes = 0
        self._escaped = escaped
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[XbeeFrame | Other]:
        """Take a chunk of bytes; return the frames that it completes."""
        frames: list[XbeeFrame | Other] = []
        for start in range(0, len(data), CONTENT_MAX):  # so that the buffer stays small
            self._buffer += data[start : start + CONTENT_MAX]
            while self._step(frames):
                pass
        return frames

    def _step(self, frames: list[XbeeFrame | Other]) -> bool:
        """Decode one frame or drop some bytes; return False if more bytes are needed."""
        start = self._buffer.find(START)
        if start != 0:
            self._drop(len(self._buffer) if start < 0 else start)
            return start > 0
        raw, used, cut = self._unescaped()
        if cut:
            self._drop(used)
            return True
        if len(raw) < 2:
            return False
        length = raw[0] << 8 | raw[1]
        if not 0 < length <= CONTENT_MAX:
            self._drop(1)
            return True
        if len(raw) < length + 3:
            return False
        if sum(raw[2:]) % 256 != 0xFF:
            self.bad_checksums += 1
            self._drop(1)
            return True
        try:
            frames.append(parse_content(bytes(raw[2:-1])))
        except WireError:
            self.malformed += 1
            self._drop(used)
        else:
            del self._buffer[:used]
        return True

    def _unescaped(self) -> tuple[bytearray, int, bool]:
        """Return the unescaped bytes after the delimiter, the number of raw bytes read (the
        delimiter included), and whether the frame is cut off by the start of another.

        Reads no further than the end of the frame, as given by its length field.
        """
        raw = bytearray()
        wanted = 2
        at = 1
        while at < len(self._buffer) and len(raw) < wanted:
            byte = self._buffer[at]
            if self._escaped and byte == START:
                return raw, at, True
            if self._escaped and byte == ESCAPE:
                if at + 1 == len(self._buffer):
                    break
                at += 1
                byte = self._buffer[at]
                if byte == START:
                    return raw, at, True
                byte ^= 0x20
            raw.append(byte)
            at += 1
            if len(raw) == 2:
                wanted = min(raw[0] << 8 | raw[1], CONTENT_MAX) + 3
        return raw, at, False

    def _drop(self, count: int) -> None:
        self.dropped_bytes += count
        del self._buffer[:count]
