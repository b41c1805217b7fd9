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

import struct
from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack.natnet_messages import (
    OLDEST,
    BodyName,
    ModelDef,
    NatNetFrame,
    RigidBody,
    Ticks,
    Version,
)

I32 = Struct("<i")
NAME_MAX = 255  # bytes, without the closing NUL


class Cursor:
    """A read position in a payload of little-endian fields; it only moves forward, up to `end`."""

    __slots__ = ("at", "data", "end")

    def __init__(self, data: bytes, end: int | None = None, at: int = 0) -> None:
        self.data = data
        self.at = at
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
        if not 0 <= count * smallest <= self.left:
            raise WireError(
                f"{count} elements of {smallest} bytes or more; only {self.left} bytes remain"
            )
        return count

    def size(self, count: int, smallest: int) -> int:
        """Read the size [bytes] of a section with `count` elements of at least `smallest` bytes."""
        size = self.i32()
        if not 0 <= count * smallest <= size <= self.left:
            raise WireError(
                f"{count} elements of {smallest} bytes or more in a section of {size} bytes; "
                f"{self.left} bytes remain in the packet"
            )
        return size

    def name(self) -> str:
        """Read a NUL-terminated name of at most 255 bytes."""
        start = self.at
        stop = self.data.find(b"\0", start, min(self.end, start + NAME_MAX + 1))
        if stop < 0:
            raise WireError(f"a name of more than {NAME_MAX} bytes, or without its closing NUL")
        self.at = stop + 1
        return self.data[start:stop].decode("utf-8", "replace")


def packed(layout: str, *values: Any) -> bytes:
    """Pack little-endian values; WireError if one does not fit."""
    try:
        return struct.pack("<" + layout, *values)
    except (struct.error, OverflowError) as error:
        raise WireError(f"cannot pack {layout}: {error}") from None


def packed_name(name: str) -> bytes:
    """Pack a NUL-terminated name."""
    raw = name.encode("utf-8", "replace")
    if len(raw) > NAME_MAX or b"\0" in raw:
        raise WireError(f"a name has at most {NAME_MAX} bytes and no NUL, unlike {name[:40]!r}")
    return raw + b"\0"


SIZED = Version(4, 1)  # from this version on, sections state their size
POSE = Struct("<i7f")
BODY = Struct("<i7ffH")  # a whole body from 3.0 on, 38 bytes
ERROR_AND_PARAMS = Struct("<fH")
MARKER_IN_BODY = 20  # position, id, size


def suffix_layout(version: Version) -> Struct:
    """Return the layout of a frame's suffix, which follows the last section."""
    if version < (2, 7):
        return Struct("<fIIfHi")
    if version < (3, 0):
        return Struct("<fIIdHi")
    if version < SIZED:
        return Struct("<IIdQQQHi")
    return Struct("<IIdQQQIIHi")


def smallest_body(version: Version) -> int:
    """Return the size of a rigid body without markers [bytes]."""
    return BODY.size if version >= (3, 0) else POSE.size + 4 + ERROR_AND_PARAMS.size


def labelled_size(version: Version) -> int:
    """Return the size of a labelled marker [bytes]."""
    return 26 if version >= (3, 0) else 22


def parse_frame(payload: bytes, version: Version) -> NatNetFrame:
    """Read a frame; versions above 4.3 are read as 4.3, WireError if the layout does not fit."""
    if version < OLDEST:
        raise WireError(f"protocol {version} is older than {OLDEST}")
    suffix = suffix_layout(version)
    cursor = Cursor(payload, len(payload) - suffix.size)
    number = cursor.i32()
    _skip(cursor, version, _MARKER_SETS)
    _skip(cursor, version, _OTHER_MARKERS)
    bodies = _bodies(cursor, version)
    for section in _AFTER_BODIES:
        if version >= section.since:
            _skip(cursor, version, section)
    if cursor.left:
        raise WireError(f"{cursor.left} bytes between the last section and the suffix")
    fields = suffix.unpack_from(payload, cursor.end)  # params are the last field but one
    ticks = Ticks(*fields[3:6]) if version >= (3, 0) else None
    return NatNetFrame(number, bodies, fields[-2], ticks)


def _bodies(cursor: Cursor, version: Version) -> tuple[RigidBody, ...]:
    smallest = smallest_body(version)
    count = cursor.count(smallest)
    if version >= SIZED and cursor.size(count, smallest) != count * smallest:
        raise WireError("the stated size of the rigid bodies is wrong")
    return tuple(_body(cursor, version) for _ in range(count))


def _body(cursor: Cursor, version: Version) -> RigidBody:
    if version >= (3, 0):
        body, x, y, z, qx, qy, qz, qw, _, params = cursor.take(BODY)
    else:
        body, x, y, z, qx, qy, qz, qw = cursor.take(POSE)
        cursor.skip(cursor.count(MARKER_IN_BODY) * MARKER_IN_BODY)
        _, params = cursor.take(ERROR_AND_PARAMS)
    return RigidBody(body, (x, y, z), (qx, qy, qz, qw), bool(params & 1))


def _skip_marker_set(cursor: Cursor, version: Version) -> None:
    cursor.name()
    cursor.skip(cursor.count(12) * 12)


def _skip_skeleton(cursor: Cursor, version: Version) -> None:
    cursor.skip(4)
    if version >= (3, 0):
        cursor.skip(cursor.count(BODY.size) * BODY.size)
        return
    for _ in range(cursor.count(smallest_body(version))):
        cursor.skip(POSE.size)
        cursor.skip(cursor.count(MARKER_IN_BODY) * MARKER_IN_BODY)
        cursor.skip(smallest_body(version) - POSE.size - 4)


def _skip_channels(cursor: Cursor, version: Version) -> None:
    cursor.skip(4)
    for _ in range(cursor.count(4)):
        cursor.skip(cursor.count(4) * 4)


@dataclass(frozen=True, slots=True)
class _Section:
    since: Version
    smallest: Callable[[Version], int]  # least size of an element [bytes]
    skip_one: Callable[[Cursor, Version], None] | None  # None: all elements have that size


def _skip(cursor: Cursor, version: Version, section: _Section) -> None:
    smallest = section.smallest(version)
    count = cursor.count(smallest)
    if version >= SIZED:
        cursor.skip(cursor.size(count, smallest))
    elif section.skip_one is None:
        cursor.skip(count * smallest)
    else:
        for _ in range(count):
            section.skip_one(cursor, version)


_MARKER_SETS = _Section(OLDEST, lambda _: 5, _skip_marker_set)
_OTHER_MARKERS = _Section(OLDEST, lambda _: 12, None)
_AFTER_BODIES = (
    _Section(OLDEST, lambda _: 8, _skip_skeleton),
    _Section(SIZED, lambda _: 12, None),  # assets
    _Section(OLDEST, labelled_size, None),
    _Section(Version(2, 9), lambda _: 8, _skip_channels),  # force plates
    _Section(Version(2, 11), lambda _: 8, _skip_channels),  # devices
)


MARKER_SET, RIGID_BODY, SKELETON, FORCE_PLATE, DEVICE, CAMERA = range(6)
_PLATE = (2 + 3 + 12 * 12 + 4 * 3) * 4 + 8  # width, length, origin, matrix, corners, two types


def parse_modeldef(payload: bytes, version: Version) -> ModelDef:
    """Read the rigid bodies' names and ids; bodies inside skeletons are left out."""
    if version < OLDEST:
        raise WireError(f"protocol {version} is older than {OLDEST}")
    cursor = Cursor(payload)
    bodies: list[BodyName] = []
    for _ in range(cursor.count(5)):
        kind = cursor.i32()
        if version >= SIZED:
            stop = cursor.at + cursor.size(0, 0) + 4
            if kind == RIGID_BODY:
                bodies.append(_named(Cursor(payload, stop, cursor.at)))
            cursor.skip(stop - cursor.at)
        elif kind == RIGID_BODY:
            bodies.append(_whole_description(cursor, version))
        elif not _step_over(cursor, kind, version):
            return ModelDef(tuple(bodies), complete=False)
    return ModelDef(tuple(bodies))


def _named(cursor: Cursor) -> BodyName:
    """Read name and id, and skip the parent's id."""
    named = BodyName(cursor.name(), cursor.i32())
    cursor.skip(4)
    return named


def _whole_description(cursor: Cursor, version: Version) -> BodyName:
    """Read a body's complete description, in a version that does not state its size."""
    body = _named(cursor)
    cursor.skip(12)
    if version >= (3, 0):
        count = cursor.count(16)
        cursor.skip(count * 16)
        if version >= (4, 0):
            for _ in range(count):
                cursor.name()
    return body


def _step_over(cursor: Cursor, kind: int, version: Version) -> bool:
    if kind == MARKER_SET:
        cursor.name()
    elif kind == SKELETON:
        cursor.name()
        cursor.skip(4)
        for _ in range(cursor.count(21)):
            _whole_description(cursor, version)
        return True
    elif kind == FORCE_PLATE and version >= (3, 0):
        cursor.skip(4)
        cursor.name()
        cursor.skip(_PLATE)
    elif kind == DEVICE and version >= (3, 0):
        cursor.skip(4)
        cursor.name()
        cursor.name()
        cursor.skip(8)
    elif kind == CAMERA:
        cursor.name()
        cursor.skip(28)
        return True
    else:
        return False
    for _ in range(cursor.count(1)):  # names of markers or channels
        cursor.name()
    return True
