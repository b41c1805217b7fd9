"""Splits a multipart/x-mixed-replace stream into parts, and never raises for invalid bytes.

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
        self._boundary = b"--" + boundary.lstrip("-").encode("latin-1", "replace")
        self._buffer = bytearray()
        self._is_in_part = False  # whether the buffer begins after a boundary
        self._scanned_count = 0  # number of buffered bytes already searched for the end of the part
        self._bodies: list[bytes] = []

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes, and return the bodies that they complete, oldest first.

        Bytes of an incomplete body are kept for the next call. Damaged parts are dropped
        and counted.
        """
        self._buffer += data
        while self._read_part() if self._is_in_part else self._skip_to_boundary():
            pass
        bodies = self._bodies
        self._bodies = []
        return bodies

    def _skip_to_boundary(self) -> bool:
        """Drop the bytes up to the next boundary, and the boundary itself.

        If the buffer contains no boundary, bytes that may be the beginning of one are kept.

        Returns:
            Whether the buffer contained a boundary.
        """
        found_at = self._buffer.find(self._boundary)
        if found_at < 0:
            del self._buffer[: max(0, len(self._buffer) - len(self._boundary) + 1)]
            return False
        self._remove_bytes(found_at + len(self._boundary), inside=True)
        return True

    def _read_part(self) -> bool:
        """Try to complete the part at the start of the buffer. An invalid part is dropped.

        Returns:
            Whether to continue with the buffer. False if more bytes are needed. The buffer then
            stays as it is.
        """
        head_end = self._buffer.find(_BLANK, 0, HEAD_MAX)
        boundary_in_head = self._buffer.find(
            self._boundary, 0, head_end if head_end >= 0 else HEAD_MAX
        )
        if boundary_in_head >= 0 or (head_end < 0 and len(self._buffer) >= HEAD_MAX):
            return self._drop_part()
        if head_end < 0:
            return False
        body_start = head_end + len(_BLANK)
        length = _read_content_length(bytes(self._buffer[:head_end]))
        if length is not None and not 0 <= length <= BODY_MAX:
            return self._drop_part()
        body_end = self._buffer.find(self._boundary, max(body_start, self._scanned_count))
        self._scanned_count = max(body_start, len(self._buffer) - len(self._boundary) + 1)
        if length is None:
            return self._read_part_without_length(body_start, body_end)
        if (
            0 <= body_end < body_start + length
        ):  # a boundary comes before the stated length of the body
            return self._drop_part()
        if len(self._buffer) < body_start + length:
            return False
        self._bodies.append(bytes(self._buffer[body_start : body_start + length]))
        self._remove_bytes(body_start + length, inside=False)
        return True

    def _read_part_without_length(self, body_start: int, body_end: int) -> bool:
        """Complete a part without a Content-Length header if its end has arrived.

        A part that is longer than BODY_MAX is dropped.

        Args:
            body_start: Index of the body's first byte in the buffer.
            body_end: Index after the body's last byte. Negative if that byte has not arrived.

        Returns:
            Whether to continue with the buffer. False if more bytes are needed.
        """
        if body_end < 0:
            return self._drop_part() if len(self._buffer) - body_start > BODY_MAX else False
        self._bodies.append(bytes(self._buffer[body_start:body_end]).removesuffix(b"\r\n"))
        self._remove_bytes(body_end, inside=False)
        return True

    def _drop_part(self) -> bool:
        """Give up the present part as damaged, and count it.

        The result is always True, to continue with the next boundary.
        """
        self.damaged += 1
        self._remove_bytes(0, inside=False)
        return True

    def _remove_bytes(self, n_bytes: int, inside: bool) -> None:
        """Remove bytes from the start of the buffer.

        Args:
            n_bytes: Number of bytes to remove.
            inside: Whether the buffer then starts with a part.
        """
        del self._buffer[:n_bytes]
        self._is_in_part = inside
        self._scanned_count = 0


def _read_content_length(header: bytes) -> int | None:
    """Return the Content-Length of a part.

    The result is None if it is missing, and -1 if it is not a number or has more than 11
    digits.
    """
    for line in header.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            digits = value.strip()
            return int(digits) if digits.isdigit() and len(digits) < 12 else -1
    return None
