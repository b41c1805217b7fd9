"""What `pylibCZIrw` does not read of a CZI file: the times of the pictures, in its attachment
"TimeStamps", and which planes there are, with the type of their pixels.

Format: "CZI File Format Specification" of Carl Zeiss, 1.2. A segment begins with its identifier (16
bytes), its allocated and its used length (8 bytes each). The header of the file states where the
directories of subblocks and of attachments are. An entry of that of attachments has 128 bytes, and
states where its attachment is. The content of "TimeStamps" is its length, the number of times (4
bytes each), and the times in seconds (8 bytes each). An entry of that of subblocks, the pictures
and their parts, has 32 bytes, with its type of pixels after the first two, its number of axes at
the end, and 20 bytes of each axis. All numbers are little-endian.
"""

import struct
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
ATTACHMENTS_MAX = 10_000  # most attachments that are read
TIMES_MAX = 10_000_000  # most times
SUBBLOCKS_MAX = 10_000_000  # most subblocks
AXES_MAX = 20  # most axes of a subblock
PIXEL_TYPES = {
    0: "Gray8", 1: "Gray16", 2: "Gray32Float", 3: "Bgr24", 4: "Bgr48", 8: "Bgr96Float",
}  # fmt: skip
"""Names that the library has for types of pixels."""


PLANE_AXES = "TZC"


@dataclass(frozen=True, slots=True)
class PlaneDirectory:
    """The planes of a file: their indices along PLANE_AXES, and the type of pixels of the first
    channel, None if it is unknown."""

    planes: frozenset[tuple[int, ...]]
    pixels: str | None = None

    def begin(self, axis: str) -> int:
        """Return the first index of an axis, 0 without planes."""
        along = PLANE_AXES.index(axis)
        return min((plane[along] for plane in self.planes), default=0)


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


def czi_planes(path: Path) -> PlaneDirectory:
    """Return the planes of a file; none if they cannot be read."""
    with path.open("rb") as file:
        try:
            return _planes(file)
        except (struct.error, OSError, ValueError):  # the file is damaged
            return PlaneDirectory(frozenset())


def _planes(file: BinaryIO) -> PlaneDirectory:
    (directory,) = _unpacked(file, SUBBLOCKS_AT, "<q")
    (count,) = _unpacked(file, directory + SEGMENT_B, "<i")
    types: dict[tuple[int, ...], int] = {}  # of pixels, by plane
    place = directory + FIRST_SUBBLOCK_AT
    for _ in range(min(count, SUBBLOCKS_MAX)):
        _, pixels, axes = _unpacked(file, place, SUBBLOCK.format)
        place += SUBBLOCK.size
        indices: dict[str, int] = {}  # of the plane, by axis
        for _ in range(min(axes, AXES_MAX)):
            name, index = _unpacked(file, place, AXIS.format)
            place += AXIS.size
            indices[name.rstrip(b"\0").decode("ascii")] = index
        types.setdefault(tuple(indices.get(axis, 0) for axis in PLANE_AXES), pixels)
    if not types:
        return PlaneDirectory(frozenset())
    first = min(types, key=lambda plane: plane[PLANE_AXES.index("C")])
    return PlaneDirectory(frozenset(types), PIXEL_TYPES.get(types[first]))


def _unpacked(file: BinaryIO, place: int, form: str) -> tuple:
    file.seek(place)
    return struct.unpack(form, file.read(struct.calcsize(form)))
