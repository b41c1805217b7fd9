"""Splits the bytes of a multipart/x-mixed-replace stream into parts; never raises for bad bytes.

    --boundary CRLF  header lines CRLF  CRLF  body CRLF   --boundary CRLF ...

A body ends after its Content-Length or, without one, at the next boundary. Unreadable bytes are
dropped up to the next boundary and counted.
"""

HEAD_MAX = 4096  # most bytes of a part's header lines
BODY_MAX = 1 << 23
_BLANK = b"\r\n\r\n"


class Multipart:
    """Splits a stream of bytes into the bodies of its parts, and buffers at most one part.

    Attributes:
        damaged: Number of parts that could not be decoded.
    """

    def __init__(self, boundary: str) -> None:
        self.damaged = 0
        self._mark = b"--" + boundary.lstrip("-").encode("latin-1", "replace")
        self._held = bytearray()
        self._inside = False  # whether the buffer begins after a boundary
        self._scanned = 0  # number of buffered bytes already searched for the end of the part
        self._bodies: list[bytes] = []

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes, and return the bodies that they complete, oldest first.

        Bytes of an incomplete body are kept for the next call. Damaged parts are dropped
        and counted.
        """
        self._held += data
        while self._part() if self._inside else self._find():
            pass
        bodies = self._bodies
        self._bodies = []
        return bodies

    def _find(self) -> bool:
        """Drop the bytes up to the next boundary, and the boundary. Return whether there is one.

        Without one, bytes that may be its beginning are kept.
        """
        found_at = self._held.find(self._mark)
        if found_at < 0:
            del self._held[: max(0, len(self._held) - len(self._mark) + 1)]
            return False
        self._cut(found_at + len(self._mark), inside=True)
        return True

    def _part(self) -> bool:
        """Try to complete the part at the start of the buffer. Return whether to continue.

        An invalid part is dropped. If more bytes are needed, the buffer stays as it is and
        the result is False.
        """
        head = self._held.find(_BLANK, 0, HEAD_MAX)
        cut = self._held.find(self._mark, 0, head if head >= 0 else HEAD_MAX)
        if cut >= 0 or (head < 0 and len(self._held) >= HEAD_MAX):
            return self._drop()
        if head < 0:
            return False
        start = head + len(_BLANK)
        length = _content_length(bytes(self._held[:head]))
        if length is not None and not 0 <= length <= BODY_MAX:
            return self._drop()
        end = self._held.find(self._mark, max(start, self._scanned))
        self._scanned = max(start, len(self._held) - len(self._mark) + 1)
        if length is None:
            return self._unmeasured(start, end)
        if 0 <= end < start + length:  # a boundary comes before the stated length of the body
            return self._drop()
        if len(self._held) < start + length:
            return False
        self._bodies.append(bytes(self._held[start : start + length]))
        self._cut(start + length, inside=False)
        return True

    def _unmeasured(self, start: int, end: int) -> bool:
        """Complete a part without a Content-Length if its end has arrived.

        Returns whether to continue.

        `end` is negative if it has not arrived. A part that is longer than BODY_MAX is dropped.
        """
        if end < 0:
            return self._drop() if len(self._held) - start > BODY_MAX else False
        self._bodies.append(bytes(self._held[start:end]).removesuffix(b"\r\n"))
        self._cut(end, inside=False)
        return True

    def _drop(self) -> bool:
        """Give up the present part as damaged, and count it.

        The result is always True, to continue with the next boundary.
        """
        self.damaged += 1
        self._cut(0, inside=False)
        return True

    def _cut(self, end: int, inside: bool) -> None:
        """Remove `end` bytes from the start of the buffer.

        `inside` says whether the buffer then starts with a part.
        """
        del self._held[:end]
        self._inside = inside
        self._scanned = 0


def _content_length(head: bytes) -> int | None:
    """Return the Content-Length of a part.

    The result is None if it is missing, and -1 if it is not a number or has more than 11
    digits.
    """
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            digits = value.strip()
            return int(digits) if digits.isdigit() and len(digits) < 12 else -1
    return None
