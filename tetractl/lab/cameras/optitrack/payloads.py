"""Decode the NatNet messages with frames (FRAMEOFDATA) and with names of bodies (MODELDEF).

Only rigid bodies are read. A frame consists of its number, sections of counted elements, and a
suffix of fixed size. Since version 4.1, every section also contains its size in bytes. In older
versions, the elements are measured one by one. The suffix is read from the end. A frame is refused
if its sections do not end exactly where the suffix begins.

MODELDEF contains the id of each rigid body. Since version 4.1, a data set contains its size. Only
the name and id of a rigid body are read, and the rest is skipped by that size, because Motive 3.4
sends longer descriptions than protocol 4.3 defines. Before 4.1, a data set has to be measured.
Reading ends at a data set of unknown layout, and `ModelDef.complete` is then False.
"""

from functools import cache
from struct import Struct
from typing import Any, NamedTuple

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet

NAME_MAX = 255
"""Maximum length of a name, without the closing NUL [bytes]."""
I32 = Struct("<i")
POSE = Struct("<i7f")
"""Layout of a rigid body's id, position and quaternion."""
ERROR_AND_PARAMS = Struct("<fH")
BODY = POSE.size + ERROR_AND_PARAMS.size
"""Size of a rigid body without markers [bytes]."""


class Layout(NamedTuple):
    """The layout of NatNet messages, which differs between the protocol's versions.

    Attributes:
        suffix: The end of a frame, whose last two fields are its params and an i32.
        channel_section_count: Number of sections of channels in a frame (force plates, devices).
        has_exposure_time: True since 3.0: the fourth field of the suffix is the time of exposure,
            rigid bodies no longer contain their markers, and labelled markers end with an error.
        has_sizes: True since 4.1: frames have a section of assets, and sections and data sets
            contain their size.
    """

    suffix: Struct
    channel_section_count: int = 2
    has_exposure_time: bool = False
    has_sizes: bool = False


LAYOUTS = {  # by the first version that has the layout
    natnet.OLDEST: Layout(Struct("<fIIfHi"), channel_section_count=0),
    natnet.Version(2, 7): Layout(Struct("<fIIdHi"), channel_section_count=0),
    natnet.Version(2, 9): Layout(Struct("<fIIdHi"), channel_section_count=1),
    natnet.Version(2, 11): Layout(Struct("<fIIdHi")),
    natnet.Version(3, 0): Layout(Struct("<IIdQQQHi"), has_exposure_time=True),
    natnet.Version(4, 1): Layout(Struct("<IIdQQQIIHi"), has_exposure_time=True, has_sizes=True),
}


@cache  # for each frame and body
def find_layout(version: natnet.Version) -> Layout:
    """Find the layout of messages that a version of NatNet uses.

    Raises:
        WireError: If the version is too old.
    """
    if version < natnet.OLDEST:
        raise WireError(f"protocol {version} is older than {natnet.OLDEST}")
    return LAYOUTS[max(since for since in LAYOUTS if since <= version)]


# Size of one element of each section, or the smallest size that it can have [bytes]
MARKER_SET_MIN = 5
MARKER = 12
SKELETON_MIN = 8
ASSET_MIN = 12
LABELLED_MARKER = 26
LABELLED_MARKER_BEFORE_3 = 22
CHANNELS_MIN = 8
CHANNEL_MIN = 4
SAMPLE = 4
MARKER_OF_BODY_BEFORE_3 = 20
POSITION = 12
DESCRIPTION_MIN = 5
BODY_DESCRIPTION_MIN = 21
MARKER_DESCRIPTION = 16


class Cursor:
    """A read position in a payload of little-endian fields. It only moves forward.

    Args:
        data: The payload.
        end: Position at which reading ends. None for the end of the payload.
        start: Position at which reading begins.
    """

    __slots__ = ("data", "end", "position")

    def __init__(self, data: bytes, end: int | None = None, start: int = 0) -> None:
        self.data = data
        self.position = start
        self.end = len(data) if end is None else end

    @property
    def remaining(self) -> int:
        """Number of bytes from the present position to the end of reading."""
        return self.end - self.position

    def skip(self, size: int) -> None:
        """Move forward by `size` bytes.

        Raises:
            WireError: If fewer bytes remain.
        """
        if not 0 <= size <= self.remaining:
            raise WireError(f"{size} bytes are expected, but only {self.remaining} remain")
        self.position += size

    def read(self, layout: Struct) -> tuple[Any, ...]:
        """Read one structure at the present position, and return its fields.

        Raises:
            WireError: If fewer bytes remain.
        """
        start = self.position
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def read_i32(self) -> int:
        """Read a signed 32-bit integer at the present position."""
        return self.read(I32)[0]

    def read_count(self, size_min: int) -> int:
        """Read the number of elements, each of at least `size_min` bytes.

        This limits loops and memory by the datagram's size.

        Raises:
            WireError: If the elements do not fit into the rest of the payload.
        """
        count = self.read_i32()
        self._require(count, size_min, self.remaining)
        return count

    def read_size(self, count: int, size_min: int) -> int:
        """Read the size [bytes] of a part with `count` elements of at least `size_min` bytes.

        Raises:
            WireError: If the elements do not fit into this size, or this size into the payload.
        """
        size = self.read_i32()
        self._require(count, size_min, size)
        return size

    def _require(self, count: int, size_min: int, size: int) -> None:
        """Raise WireError unless `count` elements fit into `size` bytes of the payload."""
        if not 0 <= count * size_min <= size <= self.remaining:
            raise WireError(
                f"{count} elements of at least {size_min} bytes do not fit into the stated size "
                f"of {size} bytes, or this size into the {self.remaining} bytes that remain"
            )

    def skip_elements(self, size: int) -> None:
        """Read a number of elements, and skip that many elements of `size` bytes each."""
        self.skip(self.read_count(size) * size)

    def skip_sized(self, size_min: int) -> None:
        """Skip a part of the message that states its number of elements, and then its size.

        Each element has at least `size_min` bytes.
        """
        count = self.read_count(size_min)
        self.skip(self.read_size(count, size_min))

    def read_part(self) -> "Cursor":
        """Read the size of a part of the message, skip it, and return a cursor to read the part."""
        size = self.read_size(count=0, size_min=0)
        part = Cursor(self.data, end=self.position + size, start=self.position)
        self.skip(size)
        return part

    def skip_names(self) -> None:
        """Read a number of names, and skip that many names, as in lists of markers."""
        for _ in range(self.read_count(1)):
            self.read_name()

    def read_name(self) -> str:
        """Read a name that ends with a zero byte.

        Raises:
            WireError: If it has more than NAME_MAX bytes, or no zero byte follows.
        """
        start = self.position
        stop = self.data.find(b"\0", start, min(self.end, start + NAME_MAX + 1))
        if stop < 0:
            raise WireError(f"a name has more than {NAME_MAX} bytes, or lacks its closing NUL")
        self.position = stop + 1
        return self.data[start:stop].decode("utf-8", "replace")


def parse_frame(payload: bytes, version: natnet.Version) -> natnet.NatNetFrame:
    """Decode the payload of a frame message. Versions above 4.3 are read as 4.3.

    Raises:
        WireError: If the payload does not fit the layout of the version.
    """
    layout = find_layout(version)
    cursor = Cursor(payload, len(payload) - layout.suffix.size)
    number = cursor.read_i32()
    read_sections = _read_sized if layout.has_sizes else _read_measured
    bodies = read_sections(cursor, layout)
    if cursor.remaining:
        raise WireError(
            f"there are {cursor.remaining} unexpected bytes between the last section and the suffix"
        )
    fields = layout.suffix.unpack_from(payload, cursor.end)
    return natnet.NatNetFrame(
        number, bodies, fields[-2], fields[3] if layout.has_exposure_time else None
    )


def _read_sized(cursor: Cursor, layout: Layout) -> tuple[natnet.RigidBody, ...]:
    """Read the rigid bodies of a frame since version 4.1, where sections contain their sizes."""
    cursor.skip_sized(MARKER_SET_MIN)
    cursor.skip_sized(MARKER)  # unlabelled markers
    count = cursor.read_count(BODY)
    if cursor.read_size(count, BODY) != count * BODY:
        raise WireError("the stated size of the rigid bodies is wrong")
    bodies = tuple(_read_body(cursor, layout) for _ in range(count))
    cursor.skip_sized(SKELETON_MIN)
    cursor.skip_sized(ASSET_MIN)
    cursor.skip_sized(LABELLED_MARKER)
    for _ in range(layout.channel_section_count):
        cursor.skip_sized(CHANNELS_MIN)
    return bodies


def _read_measured(cursor: Cursor, layout: Layout) -> tuple[natnet.RigidBody, ...]:
    """Read the sections of a frame before 4.1, and return the rigid bodies.

    The other sections are skipped element by element.
    """
    for _ in range(cursor.read_count(MARKER_SET_MIN)):
        cursor.read_name()
        cursor.skip_elements(MARKER)
    cursor.skip_elements(MARKER)  # unlabelled markers
    bodies = tuple(_read_body(cursor, layout) for _ in range(cursor.read_count(BODY)))
    for _ in range(cursor.read_count(SKELETON_MIN)):
        cursor.skip(I32.size)
        for _ in range(cursor.read_count(BODY)):
            _read_body(cursor, layout)
    cursor.skip_elements(LABELLED_MARKER if layout.has_exposure_time else LABELLED_MARKER_BEFORE_3)
    for _ in range(layout.channel_section_count):
        for _ in range(cursor.read_count(CHANNELS_MIN)):
            cursor.skip(I32.size)
            for _ in range(cursor.read_count(CHANNEL_MIN)):
                cursor.skip_elements(SAMPLE)
    return bodies


def _read_body(cursor: Cursor, layout: Layout) -> natnet.RigidBody:
    """Read one rigid body of a frame. Its markers and its mean error are skipped."""
    number, *pose = cursor.read(POSE)
    if not layout.has_exposure_time:
        cursor.skip_elements(MARKER_OF_BODY_BEFORE_3)
    _, params = cursor.read(ERROR_AND_PARAMS)
    return natnet.RigidBody(number, (*pose[:3],), (*pose[3:],), bool(params & 1))


MARKER_SET, RIGID_BODY, SKELETON, FORCE_PLATE, DEVICE, CAMERA = range(6)


class SkippedLayout(NamedTuple):
    """The layout of a description in MODELDEF that is skipped, because it is no rigid body.

    Protocols before 4.1 do not send its length, so it follows from the parts: bytes, names that
    end with a zero byte, bytes again, and for some kinds a list of names.

    Attributes:
        bytes_before: Number of bytes before the names.
        names: Number of names.
        bytes_after: Number of bytes after the names.
        ends_with_names: True if a list of names follows, which begins with its length.
    """

    bytes_before: int
    names: int
    bytes_after: int
    ends_with_names: bool


SKIPPED = {  # by the type of the description
    MARKER_SET: SkippedLayout(0, 1, 0, ends_with_names=True),
    # after the name of a force plate: size, origin, matrix, corners, types
    FORCE_PLATE: SkippedLayout(4, 1, 652, ends_with_names=True),
    DEVICE: SkippedLayout(4, 2, 8, ends_with_names=True),
    CAMERA: SkippedLayout(0, 1, 28, ends_with_names=False),
}


def parse_modeldef(payload: bytes, version: natnet.Version) -> natnet.ModelDef:
    """Decode the names and ids of rigid bodies from a MODELDEF message.

    Bodies inside skeletons are left out.

    Raises:
        WireError: If the payload does not fit the layout of the version.
    """
    layout = find_layout(version)
    skippable_types = {*SKIPPED} if layout.has_exposure_time else {MARKER_SET, CAMERA}
    cursor = Cursor(payload)
    bodies: list[tuple[str, int]] = []
    for _ in range(cursor.read_count(DESCRIPTION_MIN)):
        description_type = cursor.read_i32()
        if layout.has_sizes:
            description = cursor.read_part()
            if description_type == RIGID_BODY:
                bodies.append(_read_name_and_id(description))
        elif description_type == RIGID_BODY:
            bodies.append(_read_description(cursor, version))
        elif description_type == SKELETON:
            cursor.read_name()
            cursor.skip(I32.size)
            for _ in range(cursor.read_count(BODY_DESCRIPTION_MIN)):
                _read_description(cursor, version)
        elif description_type in skippable_types:
            _skip_description(cursor, SKIPPED[description_type])
        else:
            return natnet.ModelDef(tuple(bodies), complete=False)
    return natnet.ModelDef(tuple(bodies))


def _skip_description(cursor: Cursor, layout: SkippedLayout) -> None:
    """Skip a data set in a version that does not state its size."""
    cursor.skip(layout.bytes_before)
    for _ in range(layout.names):
        cursor.read_name()
    cursor.skip(layout.bytes_after)
    if layout.ends_with_names:
        cursor.skip_names()


def _read_name_and_id(cursor: Cursor) -> tuple[str, int]:
    """Read the name and id of a body, and skip the id of its parent."""
    named = cursor.read_name(), cursor.read_i32()
    cursor.skip(4)
    return named


def _read_description(cursor: Cursor, version: natnet.Version) -> tuple[str, int]:
    """Read a body's complete description, in a version without sizes, and return name and id."""
    named = _read_name_and_id(cursor)
    cursor.skip(POSITION)
    if version < (3, 0):
        return named
    markers = cursor.read_count(MARKER_DESCRIPTION)
    cursor.skip(markers * MARKER_DESCRIPTION)
    if version >= (4, 0):
        for _ in range(markers):
            cursor.read_name()
    return named
