"""The times of the pictures of a CZI file, in its attachment "TimeStamps", which `pylibCZIrw` does
not read.

Format: "CZI File Format Specification" of Carl Zeiss, 1.2. A segment begins with its identifier (16
bytes), its allocated and its used length (8 bytes each). The header of the file states where the
directory of attachments is, of whose entries each has 128 bytes, and states where its attachment
is. The content of "TimeStamps" is its length, the number of times (4 bytes each), and the times in
seconds (8 bytes each). All numbers are little-endian.
"""

import struct
from pathlib import Path
from typing import BinaryIO

SEGMENT_B = 32  # length of the head of a segment
DIRECTORY_AT = SEGMENT_B + 72  # place in the file of the place of the directory of attachments
ENTRIES_AT = SEGMENT_B + 256  # place of the first entry in the directory
ENTRY = struct.Struct("<2s10xq4x16x8s80s")  # schema, place, type and name of an attachment
CONTENT_AT = SEGMENT_B + 256  # place of the content in an attachment
ATTACHMENTS_MAX = 10_000  # most attachments that are read
TIMES_MAX = 10_000_000  # most times


def czi_times(path: Path) -> list[float] | None:
    """Return the times of the pictures [s]; None if the file has none, or they cannot be read."""
    with path.open("rb") as file:
        try:
            return _times(file)
        except (struct.error, OSError, ValueError):  # the file is damaged
            return None


def _times(file: BinaryIO) -> list[float] | None:
    (directory,) = _unpacked(file, DIRECTORY_AT, "<q")
    if directory <= 0:
        return None
    (count,) = _unpacked(file, directory + SEGMENT_B, "<i")
    for k in range(min(count, ATTACHMENTS_MAX)):
        place = directory + ENTRIES_AT + k * ENTRY.size
        _, attachment, kind, name = _unpacked(file, place, ENTRY.format)
        if name.rstrip(b"\0") == b"TimeStamps" and kind.startswith(b"CZTIMS"):
            _, number = _unpacked(file, attachment + CONTENT_AT, "<ii")
            if not 0 < number <= TIMES_MAX:
                return None
            return list(_unpacked(file, attachment + CONTENT_AT + 8, f"<{number}d"))
    return None


def _unpacked(file: BinaryIO, place: int, form: str) -> tuple:
    file.seek(place)
    return struct.unpack(form, file.read(struct.calcsize(form)))
