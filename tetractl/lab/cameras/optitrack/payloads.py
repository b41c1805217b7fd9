"""Reads rigid bodies from the payloads of FRAMEOFDATA and MODELDEF, and skips the rest.

A frame is: its number, then sections of counted elements, then a suffix of fixed size. From 4.1 on,
every section also states its size in bytes; in older versions, elements are measured one by one.
The suffix is read from the end, and a frame is refused if its sections do not end exactly where the
suffix begins.

MODELDEF gives each rigid body's id. From 4.1 on, a data set states its size: only name and id of a
rigid body are read, and the rest is skipped by that size, since Motive 3.4 sends longer
descriptions than protocol 4.3 defines. Before 4.1 a data set has to be measured; reading ends at a
data set of unknown layout, and `ModelDef.complete` is then False.
"""

from functools import cache
from struct import Struct
from typing import Any, NamedTuple

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet

NAME_MAX = 255  # bytes, without the closing NUL
I32 = Struct("<i")
POSE = Struct("<i7f")  # id, position, quaternion
ERROR_AND_PARAMS = Struct("<fH")
BODY = POSE.size + ERROR_AND_PARAMS.size  # bytes of a rigid body without markers


class Layout(NamedTuple):
    """What differs between the protocol versions: the suffix of a frame, which ends with params and
    an i32; the number of its sections of channels (force plates, devices); and two changes.

    From 3.0 on (`timed`) the suffix has the time of exposure as its fourth field, rigid bodies no
    longer contain their markers, and labelled markers end with an error. From 4.1 on (`sized`)
    frames have a section of assets, and sections and data sets state their size.
    """

    suffix: Struct
    channels: int = 2
    timed: bool = False
    sized: bool = False


LAYOUTS = {  # by the first version of each
    natnet.OLDEST: Layout(Struct("<fIIfHi"), channels=0),
    natnet.Version(2, 7): Layout(Struct("<fIIdHi"), channels=0),
    natnet.Version(2, 9): Layout(Struct("<fIIdHi"), channels=1),
    natnet.Version(2, 11): Layout(Struct("<fIIdHi")),
    natnet.Version(3, 0): Layout(Struct("<IIdQQQHi"), timed=True),
    natnet.Version(4, 1): Layout(Struct("<IIdQQQIIHi"), timed=True, sized=True),
}


@cache  # for each frame and body
def layout_of(version: natnet.Version) -> Layout:
    """Return the layout of a version; WireError for versions that are too old."""
    if version < natnet.OLDEST:
        raise WireError(f"protocol {version} is older than {natnet.OLDEST}")
    return LAYOUTS[max(since for since in LAYOUTS if since <= version)]


class Cursor:
    """A read position in a payload of little-endian fields; it only moves forward, up to `end`."""

    __slots__ = ("at", "data", "end")

    def __init__(self, data: bytes, end: int | None = None, begin: int = 0) -> None:
        self.data = data
        self.at = begin
        self.end = len(data) if end is None else end

    @property
    def left(self) -> int:
        """Number of bytes up to the end."""
        return self.end - self.at

    def skip(self, size: int) -> None:
        """Skip `size` bytes."""
        if not 0 <= size <= self.left:
            raise WireError(f"{size} bytes expected, but only {self.left} remain")
        self.at += size

    def take(self, layout: Struct) -> tuple[Any, ...]:
        """Read one structure; return its fields."""
        start = self.at
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def i32(self) -> int:
        """Read a signed 32-bit integer."""
        return self.take(I32)[0]

    def count(self, smallest: int) -> int:
        """Read a number of elements, which have at least `smallest` bytes each; WireError if
        the elements do not fit into the rest of the payload.

        This limits loops and memory by the datagram's size.
        """
        count = self.i32()
        self._require(count, smallest, self.left)
        return count

    def size(self, count: int, smallest: int) -> int:
        """Read the size [bytes] of a section with `count` elements of at least `smallest` bytes."""
        size = self.i32()
        self._require(count, smallest, size)
        return size

    def _require(self, count: int, smallest: int, size: int) -> None:
        if not 0 <= count * smallest <= size <= self.left:
            raise WireError(
                f"{count} elements of {smallest} bytes or more in {size} bytes; "
                f"{self.left} bytes remain in the packet"
            )

    def skip_elements(self, size: int) -> None:
        """Skip a count and that number of elements of `size` bytes."""
        self.skip(self.count(size) * size)

    def skip_sized(self, smallest: int) -> None:
        """Skip a section that states how many elements it has, of at least `smallest` bytes each,
        and then its size."""
        count = self.count(smallest)
        self.skip(self.size(count, smallest))

    def name(self) -> str:
        """Read a NUL-terminated name of at most 255 bytes."""
        start = self.at
        stop = self.data.find(b"\0", start, min(self.end, start + NAME_MAX + 1))
        if stop < 0:
            raise WireError(f"a name of more than {NAME_MAX} bytes, or without its closing NUL")
        self.at = stop + 1
        return self.data[start:stop].decode("utf-8", "replace")


def parse_frame(payload: bytes, version: natnet.Version) -> natnet.NatNetFrame:
    """Read a frame; versions above 4.3 are read as 4.3, WireError if the layout does not fit."""
    layout = layout_of(version)
    cursor = Cursor(payload, len(payload) - layout.suffix.size)
    number = cursor.i32()
    read_sections = _read_sized if layout.sized else _read_measured
    bodies = read_sections(cursor, layout)
    if cursor.left:
        raise WireError(f"{cursor.left} bytes between the last section and the suffix")
    fields = layout.suffix.unpack_from(payload, cursor.end)
    return natnet.NatNetFrame(number, bodies, fields[-2], fields[3] if layout.timed else None)


def _read_sized(cursor: Cursor, layout: Layout) -> tuple[natnet.RigidBody, ...]:
    """Read the sections of a frame from 4.1 on: the rigid bodies, the others by their sizes."""
    cursor.skip_sized(5)  # marker sets
    cursor.skip_sized(12)  # other markers
    count = cursor.count(BODY)
    if cursor.size(count, BODY) != count * BODY:
        raise WireError("the stated size of the rigid bodies is wrong")
    bodies = tuple(_body(cursor, layout) for _ in range(count))
    cursor.skip_sized(8)  # skeletons
    cursor.skip_sized(12)  # assets
    cursor.skip_sized(26)  # labelled markers
    for _ in range(layout.channels):
        cursor.skip_sized(8)
    return bodies


def _read_measured(cursor: Cursor, layout: Layout) -> tuple[natnet.RigidBody, ...]:
    """Read the sections of a frame before 4.1: the rigid bodies, and the others element by
    element."""
    for _ in range(cursor.count(5)):  # marker sets
        cursor.name()
        cursor.skip_elements(12)
    cursor.skip_elements(12)  # other markers
    bodies = tuple(_body(cursor, layout) for _ in range(cursor.count(BODY)))
    for _ in range(cursor.count(8)):  # skeletons
        cursor.skip(4)
        for _ in range(cursor.count(BODY)):
            _body(cursor, layout)
    cursor.skip_elements(26 if layout.timed else 22)  # labelled markers
    for _ in range(layout.channels):
        for _ in range(cursor.count(8)):
            cursor.skip(4)
            for _ in range(cursor.count(4)):
                cursor.skip_elements(4)
    return bodies


def _body(cursor: Cursor, layout: Layout) -> natnet.RigidBody:
    number, *pose = cursor.take(POSE)
    if not layout.timed:
        cursor.skip_elements(20)  # the positions, ids and sizes of its markers
    _, params = cursor.take(ERROR_AND_PARAMS)
    return natnet.RigidBody(number, (*pose[:3],), (*pose[3:],), bool(params & 1))


MARKER_SET, RIGID_BODY, SKELETON, FORCE_PLATE, DEVICE, CAMERA = range(6)
# data sets to skip before 4.1: bytes, names, bytes, and whether a list of names follows
SKIPPED = {
    MARKER_SET: (0, 1, 0, True),
    FORCE_PLATE: (4, 1, 652, True),  # after its name: size, origin, matrix, corners, types
    DEVICE: (4, 2, 8, True),
    CAMERA: (0, 1, 28, False),
}


def parse_modeldef(payload: bytes, version: natnet.Version) -> natnet.ModelDef:
    """Read the rigid bodies' names and ids; bodies inside skeletons are left out."""
    layout = layout_of(version)
    readable = {*SKIPPED} if layout.timed else {MARKER_SET, CAMERA}  # of which the layout is known
    cursor = Cursor(payload)
    bodies: list[tuple[str, int]] = []
    for _ in range(cursor.count(5)):
        kind = cursor.i32()
        if layout.sized:
            stop = cursor.size(0, 0) + cursor.at
            if kind == RIGID_BODY:
                bodies.append(_named(Cursor(payload, stop, cursor.at)))
            cursor.at = stop
        elif kind == RIGID_BODY:
            bodies.append(_described(cursor, version))
        elif kind == SKELETON:
            cursor.name()
            cursor.skip(4)
            for _ in range(cursor.count(21)):
                _described(cursor, version)
        elif kind in readable:
            before, names, after, listed = SKIPPED[kind]
            cursor.skip(before)
            for _ in range(names):
                cursor.name()
            cursor.skip(after)
            for _ in range(cursor.count(1) if listed else 0):
                cursor.name()
        else:
            return natnet.ModelDef(tuple(bodies), complete=False)
    return natnet.ModelDef(tuple(bodies))


def _named(cursor: Cursor) -> tuple[str, int]:
    """Read name and id, and skip the parent's id."""
    named = cursor.name(), cursor.i32()
    cursor.skip(4)
    return named


def _described(cursor: Cursor, version: natnet.Version) -> tuple[str, int]:
    """Read a body's complete description, in a version that does not state its size."""
    named = _named(cursor)
    cursor.skip(12)
    count = cursor.count(16) if version >= (3, 0) else 0
    cursor.skip(count * 16)
    for _ in range(count if version >= (4, 0) else 0):
        cursor.name()
    return named
