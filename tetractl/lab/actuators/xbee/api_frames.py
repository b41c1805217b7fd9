"""Encode and decode XBee API frames in escaped mode (AP=2), the only mode that is used here.

A frame consists of 7E, the length as u16, the content, and FF minus the sum of the content, all
big-endian. After the 7E, each of the bytes 7E 7D 11 13 is replaced by 7D and the byte xor 20. A 7E
is therefore always the start of a frame, and a lost byte costs one frame. The first byte of the
content is the frame's type.
"""

import struct

from tetractl.core.errors import WireError

# from Digi's manuals of XBee modules, with whose printed frames test_api_frames.py compares them
START = 0x7E  # first byte of a frame
ESCAPE = 0x7D  # byte before an escaped byte
_ESCAPED = frozenset((START, ESCAPE, 0x11, 0x13))  # 0x11 and 0x13: XON, XOFF
CONTENT_BYTES_MAX = 128  # 100 bytes of 802.15.4 payload and the longest header, rounded up
TRANSMIT = 0x01  # type of a frame with data to send
AT_COMMAND = 0x08  # type of a frame with a command to the module
AT_RESPONSE = 0x88  # type of the answer to a command
STATUS_OK = 0  # status in the answer: the command succeeded
BROADCAST = bytes((TRANSMIT, 0, 0xFF, 0xFF, 0))  # to all modules, without a report of the result
# bytes of content before the data of another module, by the frame's type: from a 64-bit address, a
# 16-bit one, both (newer firmware), or both with endpoints (AO=1)
_DATA_OFFSET_BY_TYPE = {0x80: 11, 0x81: 5, 0x90: 12, 0x91: 18}
RESPONSE = struct.Struct(">BB2sB")


def received(content: bytes) -> bytes:
    """Extract the data that another module has sent from a frame's content.

    The result is empty if the frame contains no such data.
    """
    return (
        content[_DATA_OFFSET_BY_TYPE[content[0]] :] if content[0] in _DATA_OFFSET_BY_TYPE else b""
    )


def answered(content: bytes) -> tuple[int, bytes, bytes | None] | None:
    """Extract (frame id, command, value) from a module's answer to a request.

    The value is None if the module reports an error. The result is None for any other frame.
    """
    if content[0] != AT_RESPONSE or len(content) < RESPONSE.size:
        return None
    _, frame_id, command, status = RESPONSE.unpack_from(content)
    return frame_id, command, None if status else content[RESPONSE.size :]


def encode(content: bytes) -> bytes:
    """Pack a message for an XBee module into an API frame.

    Raises:
        WireError: If the content is empty or too long.
    """
    if not 0 < len(content) <= CONTENT_BYTES_MAX:
        raise WireError(f"an API frame has no space for {len(content)} bytes")
    frame = bytearray((START,))
    size = len(content).to_bytes(2, "big")
    checksum = bytes((0xFF - sum(content) % 256,))
    for byte in size + content + checksum:
        frame += bytes((ESCAPE, byte ^ 0x20)) if byte in _ESCAPED else bytes((byte,))
    return bytes(frame)


class Decoder:
    """Finds frames in a byte stream, which may contain garbage and arrive in chunks of any size.

    The decoder never raises, and stores at most the bytes of one frame.

    Attributes:
        dropped_bytes: Number of bytes so far that belong to no valid frame.
    """

    def __init__(self) -> None:
        self.dropped_bytes = 0
        self._raw_bytes = bytearray()  # the received bytes of the present frame
        self._unescaped = bytearray()  # the same bytes, without start byte and escapes
        self._is_escaped = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes, and return the contents of the valid frames that they complete."""
        return [content for byte in data if (content := self._add_byte(byte)) is not None]

    def _add_byte(self, byte: int) -> bytes | None:
        """Add one received byte. If it completes a valid frame, return the frame's content."""
        if byte == START:
            self._start_new_frame()
        elif not self._raw_bytes:  # between frames
            self.dropped_bytes += 1
            return None
        self._raw_bytes.append(byte)
        if byte == ESCAPE and not self._is_escaped:
            self._is_escaped = True
        elif byte != START:
            self._unescaped.append(byte ^ 0x20 if self._is_escaped else byte)
            self._is_escaped = False
        if len(self._unescaped) < 2:
            return None
        size = int.from_bytes(self._unescaped[:2], "big")
        if not 0 < size <= CONTENT_BYTES_MAX:
            self._start_new_frame()
        elif len(self._unescaped) == size + 3:
            content = bytes(self._unescaped[2:-1])
            total = sum(self._unescaped[2:]) % 256
            if total == 0xFF:
                self._raw_bytes.clear()
            self._start_new_frame()
            return content if total == 0xFF else None
        return None

    def _start_new_frame(self) -> None:
        """Begin a new frame. The bytes of an incomplete frame are counted as dropped."""
        self.dropped_bytes += len(self._raw_bytes)
        self._raw_bytes.clear()
        self._unescaped.clear()
        self._is_escaped = False
