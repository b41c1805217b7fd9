"""API framing: delimiter, length, content, checksum; plain (AP=1) or escaped (AP=2).

Escaped, a 0x7E is always the start of a frame, so a lost byte costs one frame. Plain, a 0x7E may
be data: after a frame with a wrong checksum, the search goes on behind its delimiter.
"""

from tetractl.core.errors import WireError
from tetractl.lab.actuators.xbee.frames import Other, XbeeFrame, pack_content, parse_content

START, ESCAPE = 0x7E, 0x7D
_ESCAPED = frozenset((START, ESCAPE, 0x11, 0x13))  # 0x11 and 0x13: XON, XOFF
CONTENT_MAX = 128  # 100 bytes of 802.15.4 payload and the longest header, rounded up


def encode(frame: XbeeFrame | Other, escaped: bool = True) -> bytes:
    """Pack one API frame, for AP=2 or, not `escaped`, for AP=1."""
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
    """Finds frames in a stream of bytes cut anywhere, with garbage anywhere.

    Never raises and keeps at most one frame's bytes. `bad_checksums`, `malformed` (checksum good,
    too short for its type) and `dropped_bytes` (part of no good frame) only grow.
    """

    def __init__(self, escaped: bool = True) -> None:
        self.bad_checksums = 0
        self.malformed = 0
        self.dropped_bytes = 0
        self._escaped = escaped
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[XbeeFrame | Other]:
        """Take bytes as they came; return the frames they complete."""
        frames: list[XbeeFrame | Other] = []
        for start in range(0, len(data), CONTENT_MAX):  # so that the buffer stays small
            self._buffer += data[start : start + CONTENT_MAX]
            while self._step(frames):
                pass
        return frames

    def _step(self, frames: list[XbeeFrame | Other]) -> bool:
        """Take one frame or drop some bytes; False if more bytes are needed."""
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
        """Return the frame's bytes behind the delimiter, how many raw bytes they took, cut.

        Reads no further than the length says. `cut` says that another frame starts inside.
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
