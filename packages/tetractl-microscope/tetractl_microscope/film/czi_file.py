"""What `pylibCZIrw` does not read of a CZI file: the times of the pictures, in its attachment
"TimeStamps", and the first index of each axis with the type of its pixels.

Format: "CZI File Format Specification" of Carl Zeiss, 1.2. A segment begins with its identifier (16
bytes), its allocated and its used length (8 bytes each). The header of the file states where the
directories of subblocks and of attachments are. An entry of that of attachments has 128 bytes, and
states where its attachment is. The content of "TimeStamps" is its length, the number of times (4
bytes each), and the times in seconds (8 bytes each). An entry of that of subblocks, the pictures
and their parts, has 32 bytes, with its type of pixels after the first two, its number of axes at
the end, and 20 bytes of each axis. All numbers are little-endian.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

SEGMENT_B = 32  # length of the head of a segment
DIRECTORY_AT = SEGMENT_B + 72  # place in the file of the place of the directory of attachments
SUBBLOCKS_AT = SEGMENT_B + 52  # the same of the directory of subblocks
FIRST_SUBBLOCK_AT = SEGMENT_B + 128  # place of the first entry in the directory of subblocks
SUBBLOCK = struct.Struct("<2si22xi")  # schema, type of pixels and number of axes of a subblock
AXIS = struct.Struct("<4si12x")  # name and first index of a subblock along an axis
ENTRIES_AT = SEGMENT_B + 256  # place of the first entry in the directory
ENTRY = struct.Struct("<2s10xq4x16x8s80s")  # schema, place, type and name of an attachment
CONTENT_AT = SEGMENT_B + 256  # place of the content in an attachment
ATTACHMENTS_MAX, TIMES_MAX, SUBBLOCKS_MAX = 10_000, 10_000_000, 10_000_000
"""Most that are read."""
AXES_MAX = 20  # most axes of a subblock
PIXEL_TYPES = {
    0: "Gray8", 1: "Gray16", 2: "Gray32Float", 3: "Bgr24", 4: "Bgr48", 8: "Bgr96Float",
}  # fmt: skip
"""Names that the library has for types of pixels."""


@dataclass(frozen=True, slots=True)
class FirstPlane:
    """The first index of each axis, such as "T", and the type of pixels of the first channel; None
    if it is unknown."""

    begins: Mapping[str, int]
    pixels: str | None = None


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


def czi_first(path: Path) -> FirstPlane:
    """Return where the axes of a film begin; no axes if they cannot be read."""
    with path.open("rb") as file:
        try:
            return _first(file)
        except (struct.error, OSError, ValueError):  # the file is damaged
            return FirstPlane({})


def _first(file: BinaryIO) -> FirstPlane:
    (directory,) = _unpacked(file, SUBBLOCKS_AT, "<q")
    (count,) = _unpacked(file, directory + SEGMENT_B, "<i")
    begins: dict[str, int] = {}
    types: dict[int, int] = {}  # by channel
    place = directory + FIRST_SUBBLOCK_AT
    for _ in range(min(count, SUBBLOCKS_MAX)):
        _, pixels, axes = _unpacked(file, place, SUBBLOCK.format)
        place += SUBBLOCK.size
        channel = 0
        for _ in range(min(axes, AXES_MAX)):
            name, begin = _unpacked(file, place, AXIS.format)
            place += AXIS.size
            axis = name.rstrip(b"\0").decode("ascii")
            if axis not in begins or begin < begins[axis]:
                begins[axis] = begin
            if axis == "C":
                channel = begin
        types.setdefault(channel, pixels)
    return FirstPlane(begins, PIXEL_TYPES.get(types[min(types)]) if types else None)


def _unpacked(file: BinaryIO, place: int, form: str) -> tuple:
    file.seek(place)
    return struct.unpack(form, file.read(struct.calcsize(form)))
