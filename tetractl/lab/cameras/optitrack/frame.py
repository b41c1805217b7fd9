"""FRAMEOFDATA: read a frame's rigid bodies and its suffix, step over the rest.

A frame is: its number, then sections of counted elements, then a suffix of fixed size. From 4.1
every section also states its size in bytes; before, elements are measured one by one. The suffix
is read from the tail, and a frame whose sections do not end exactly where it begins is refused.
"""

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct

from tetractl.lab.cameras.optitrack.cursor import Cursor
from tetractl.lab.cameras.optitrack.natnet_messages import (
    OLDEST,
    NatNetFrame,
    RigidBody,
    Ticks,
    Version,
)
from tetractl.lab.lab_errors import WireError

SIZED = Version(4, 1)  # from here on sections state their size
POSE = Struct("<i7f")
BODY = Struct("<i7ffH")  # a whole body from 3.0 on, 38 bytes
ERROR_AND_PARAMS = Struct("<fH")
MARKER_IN_BODY = 20  # position, id, size


def suffix_layout(version: Version) -> Struct:
    """Return the layout of what follows the last section."""
    if version < (2, 7):
        return Struct("<fIIfHi")
    if version < (3, 0):
        return Struct("<fIIdHi")
    if version < SIZED:
        return Struct("<IIdQQQHi")
    return Struct("<IIdQQQIIHi")


def smallest_body(version: Version) -> int:
    """Return the size of a rigid body without markers."""
    return BODY.size if version >= (3, 0) else POSE.size + 4 + ERROR_AND_PARAMS.size


def labelled_size(version: Version) -> int:
    """Return the size of a labelled marker."""
    return 26 if version >= (3, 0) else 22


def parse_frame(payload: bytes, version: Version) -> NatNetFrame:
    """Read a frame; versions above 4.3 are read as 4.3, which fits or raises."""
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
    fields = suffix.unpack_from(payload, cursor.end)  # params are the last but one
    ticks = Ticks(*fields[3:6]) if version >= (3, 0) else None
    return NatNetFrame(number, bodies, fields[-2], ticks)


def _bodies(cursor: Cursor, version: Version) -> tuple[RigidBody, ...]:
    smallest = smallest_body(version)
    count = cursor.count(smallest)
    if version >= SIZED and cursor.size(count, smallest) != count * smallest:
        raise WireError("the size of the rigid bodies is not theirs")
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
    smallest: Callable[[Version], int]  # bytes of one element at least
    skip_one: Callable[[Cursor, Version], None] | None  # None: all elements are that size


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
