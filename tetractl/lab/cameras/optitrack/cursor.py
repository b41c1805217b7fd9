"""Reading and writing little-endian fields, never past an end."""

import struct
from struct import Struct
from typing import Any

from tetractl.lab.lab_errors import WireError

I32 = Struct("<i")
NAME_MAX = 255  # bytes, without the closing NUL


class Cursor:
    """A place in a payload that only moves forward and stays inside."""

    __slots__ = ("at", "data", "end")

    def __init__(self, data: bytes, end: int | None = None, at: int = 0) -> None:
        self.data = data
        self.at = at
        self.end = len(data) if end is None else end

    @property
    def left(self) -> int:
        """Bytes up to the end."""
        return self.end - self.at

    def skip(self, size: int) -> None:
        """Move on by `size` bytes."""
        if not 0 <= size <= self.left:
            raise WireError(f"{size} bytes wanted, {self.left} left")
        self.at += size

    def take(self, layout: Struct) -> tuple[Any, ...]:
        """Read one structure."""
        start = self.at
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def i32(self) -> int:
        """Read a signed 32-bit integer."""
        return self.take(I32)[0]

    def count(self, smallest: int) -> int:
        """Read the count of elements of at least `smallest` bytes each; it must fit what is left.

        So neither loops nor memory ever exceed what the datagram's own size allows.
        """
        count = self.i32()
        if not 0 <= count * smallest <= self.left:
            raise WireError(f"{count} elements cannot be in {self.left} bytes")
        return count

    def size(self, count: int, smallest: int) -> int:
        """Read the byte size of a section that holds `count` elements."""
        size = self.i32()
        if not 0 <= count * smallest <= size <= self.left:
            raise WireError(f"{count} elements in {size} bytes, {self.left} left")
        return size

    def name(self) -> str:
        """Read a NUL-terminated name of at most 255 bytes."""
        start = self.at
        stop = self.data.find(b"\0", start, min(self.end, start + NAME_MAX + 1))
        if stop < 0:
            raise WireError("a name without an end")
        self.at = stop + 1
        return self.data[start:stop].decode("utf-8", "replace")


def packed(layout: str, *values: Any) -> bytes:
    """Pack little-endian values; WireError where one does not fit."""
    try:
        return struct.pack("<" + layout, *values)
    except (struct.error, OverflowError) as error:
        raise WireError(f"cannot pack {layout}: {error}") from None


def packed_name(name: str) -> bytes:
    """Pack a NUL-terminated name."""
    raw = name.encode("utf-8", "replace")
    if len(raw) > NAME_MAX or b"\0" in raw:
        raise WireError(f"not a name for the wire: {name[:40]!r}")
    return raw + b"\0"
