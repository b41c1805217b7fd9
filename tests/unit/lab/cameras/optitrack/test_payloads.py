"""Tests of reading the fields of a payload: exactly what is there, and never beyond its end."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack.natnet import ModelDef, RigidBody, Version
from tetractl.lab.cameras.optitrack.payloads import (
    BODY,
    CAMERA,
    DEVICE,
    FORCE_PLATE,
    MARKER_SET,
    NAME_MAX,
    RIGID_BODY,
    SKELETON,
    Cursor,
    find_layout,
    parse_frame,
    parse_modeldef,
)


def i32(*numbers):
    return struct.pack(f"<{len(numbers)}i", *numbers)


def test_a_cursor_reads_in_order_and_knows_what_is_left():
    cursor = Cursor(i32(5, -6, 7))
    assert (cursor.remaining, cursor.read_i32(), cursor.read_i32(), cursor.remaining) == (
        12,
        5,
        -6,
        4,
    )
    cursor.skip(4)
    cursor.skip(0)
    assert cursor.remaining == 0
    for size in (1, -1):
        with pytest.raises(WireError, match="only 0 remain"):
            cursor.skip(size)
    with pytest.raises(WireError):
        cursor.read_i32()


def test_a_cursor_ends_where_it_is_told():
    cursor = Cursor(i32(1, 2, 3), end=8, start=4)
    assert (cursor.remaining, cursor.read_i32(), cursor.remaining) == (4, 2, 0)
    with pytest.raises(WireError):
        cursor.read_i32()


@given(st.integers(-3, 8), st.integers(1, 5), st.integers(0, 20))
def test_elements_are_counted_only_if_all_of_them_fit(count, smallest, rest):
    cursor = Cursor(i32(count) + bytes(rest))
    if 0 <= count * smallest <= rest:
        assert cursor.read_count(smallest) == count
        assert cursor.remaining == rest
    else:
        with pytest.raises(WireError):
            cursor.read_count(smallest)


@given(st.integers(-3, 30), st.integers(0, 5), st.integers(0, 5), st.integers(0, 20))
def test_a_stated_size_has_room_for_its_elements_and_fits_into_the_payload(
    size, count, smallest, rest
):
    cursor = Cursor(i32(size) + bytes(rest))
    if count * smallest <= size <= rest and size >= 0:
        assert cursor.read_size(count, smallest) == size
    else:
        with pytest.raises(WireError):
            cursor.read_size(count, smallest)


def test_parts_are_skipped_or_read_apart_by_their_size():
    cursor = Cursor(i32(2, 7) + bytes(7) + i32(4, 9, 8))
    cursor.skip_sized(3)
    part = cursor.read_part()
    assert (part.remaining, part.read_i32(), part.remaining) == (4, 9, 0)
    assert cursor.read_i32() == 8
    cursor = Cursor(i32(2) + bytes(6) + b"z")
    cursor.skip_elements(3)
    assert cursor.remaining == 1


def test_names_end_with_a_zero_within_their_length():
    cursor = Cursor(b"green\0" + "blü".encode() + b"\0" + b"x" * NAME_MAX + b"\0" + b"\0")
    assert [cursor.read_name() for _ in range(4)] == ["green", "blü", "x" * NAME_MAX, ""]
    for data in (b"x" * (NAME_MAX + 1) + b"\0", b"green", b""):
        with pytest.raises(WireError, match="a name has more than"):
            Cursor(data).read_name()
    with pytest.raises(WireError):
        Cursor(b"green\0", end=5).read_name()
    cursor = Cursor(i32(2) + b"a\0b\0z")
    cursor.skip_names()
    assert cursor.remaining == 1


@pytest.mark.parametrize(
    ("version", "channels", "timed", "sized"),
    [
        ("2.6", 0, False, False),
        ("2.8", 0, False, False),
        ("2.9", 1, False, False),
        ("2.10", 1, False, False),
        ("2.11", 2, False, False),
        ("3.0", 2, True, False),
        ("4.0", 2, True, False),
        ("4.1", 2, True, True),
        ("4.9", 2, True, True),
    ],
)
def test_a_version_has_the_layout_of_the_last_change_before_it(version, channels, timed, sized):
    layout = find_layout(Version.parse(version))
    assert (layout.channel_section_count, layout.has_exposure_time, layout.has_sizes) == (
        channels,
        timed,
        sized,
    )


def test_a_version_that_is_too_old_is_refused():
    with pytest.raises(WireError, match="older than"):
        find_layout(Version(2, 5))


def body(number, tracked):
    pose = struct.pack("<i7f", number, 1, 2, 3, 0, 0, 0, 1)
    return pose + struct.pack("<fH", 0.5, 0xFFFE | tracked)


SUFFIX = struct.pack("<IIdQQQIIHi", 0, 0, 0.0, 99, 0, 0, 0, 0, 6, 0)


def frame_of(*bodies, size=None, between=b""):
    """A frame of version 4.1: empty sections around those of bodies."""
    data = b"".join(bodies)
    sections = i32(0, 0) + i32(0, 0) + i32(len(bodies), len(data) if size is None else size) + data
    return i32(42) + sections + i32(0, 0) * 5 + between + SUFFIX


def test_bodies_are_read_with_the_bit_that_says_whether_they_are_tracked():
    frame = parse_frame(frame_of(body(3, True), body(4, False)), Version(4, 1))
    assert (frame.number, frame.params, frame.exposure) == (42, 6, 99)
    position, quaternion = (1, 2, 3), (0, 0, 0, 1)
    assert frame.bodies == (
        RigidBody(3, position, quaternion, True),
        RigidBody(4, position, quaternion, False),
    )


@pytest.mark.parametrize(
    "payload",
    [
        frame_of(body(3, True), size=BODY - 1),
        frame_of(body(3, True), size=BODY + 1),
        frame_of(body(3, True), between=b"x"),
        frame_of(body(3, True))[:-1],
        frame_of(body(3, True))[4:],
    ],
)
def test_a_frame_whose_sizes_do_not_agree_is_refused(payload):
    with pytest.raises(WireError):
        parse_frame(payload, Version(4, 1))


def described(name, number, tail=b""):
    return name.encode() + b"\0" + i32(number) + tail


def test_before_4_1_data_sets_are_measured_one_by_one():
    """Markers, skeletons and, since 3.0, force plates, devices and cameras are passed over."""
    markers = i32(MARKER_SET) + b"set\0" + i32(2) + b"a\0b\0"
    camera = i32(CAMERA) + b"camera\0" + bytes(28)
    plate = i32(FORCE_PLATE) + bytes(4) + b"plate\0" + bytes(652) + i32(1) + b"channel\0"
    device = i32(DEVICE) + bytes(4) + b"device\0serial\0" + bytes(8) + i32(0)
    tail = i32(-1) + bytes(12) + i32(0)  # parent, offset, no markers
    rigid = [i32(RIGID_BODY) + described(name, k, tail) for k, name in enumerate(("green", "blue"))]
    bones = i32(SKELETON) + b"man\0" + i32(5) + i32(1) + described("bone", 9, tail)
    sets = [markers, rigid[0], camera, plate, device, bones, rigid[1]]
    payload = i32(len(sets)) + b"".join(sets)
    assert parse_modeldef(payload, Version(3, 0)) == ModelDef((("green", 0), ("blue", 1)))


@pytest.mark.parametrize(("version", "complete"), [(Version(2, 11), False), (Version(3, 0), True)])
def test_reading_ends_at_a_data_set_whose_layout_is_not_known(version, complete):
    plate = i32(FORCE_PLATE) + bytes(4) + b"plate\0" + bytes(652) + i32(0)
    payload = i32(1) + plate
    assert parse_modeldef(payload, version) == ModelDef((), complete)


def test_since_4_1_a_data_set_is_as_long_as_it_says():
    rows = [(RIGID_BODY, described("green", 11, b"more than we know")), (99, b"news"), (2, b"")]
    sets = [i32(kind, len(data)) + data for kind, data in rows]
    payload = i32(len(sets)) + b"".join(sets)
    assert parse_modeldef(payload, Version(4, 1)) == ModelDef((("green", 11),))
    with pytest.raises(WireError):
        parse_modeldef(payload[:-1] + b"\x01", Version(4, 1))


@pytest.mark.parametrize(
    ("version", "after_offset"),
    [
        (Version(2, 11), b""),
        (Version(3, 0), i32(2) + bytes(32)),
        (Version(3, 1), i32(0)),
        (Version(4, 0), i32(2) + bytes(32) + b"a\0b\0"),
    ],
)
def test_the_markers_of_a_body_are_passed_over_as_each_version_has_them(version, after_offset):
    tail = i32(-1) + bytes(12) + after_offset
    sets = [i32(RIGID_BODY) + described(name, k, tail) for k, name in enumerate(("green", "blue"))]
    model = parse_modeldef(i32(2) + b"".join(sets), version)
    assert model == ModelDef((("green", 0), ("blue", 1)))


@pytest.mark.parametrize(
    ("version", "marker", "suffix"),
    [
        (Version(2, 11), 22, struct.pack("<fIIdHi", 0, 0, 0, 0.0, 6, 0)),
        (Version(3, 0), 26, struct.pack("<IIdQQQHi", 0, 0, 0.0, 99, 0, 0, 6, 0)),
    ],
)
def test_before_4_1_all_sections_of_a_frame_are_measured(version, marker, suffix):
    own_markers = b"" if version >= (3, 0) else i32(2) + bytes(40)
    error = struct.pack("<fH", 0.5, 1)
    bodies = [struct.pack("<i7f", k, 1, 2, 3, 0, 0, 0, 1) + own_markers + error for k in (3, 4)]
    channels = i32(1) + i32(7) + i32(2) + i32(3) + bytes(12) + i32(0)
    sections = [
        i32(1) + b"set\0" + i32(2) + bytes(24),  # marker sets
        i32(3) + bytes(36),  # unlabelled markers
        i32(2) + b"".join(bodies),
        i32(1) + i32(5) + i32(1) + bodies[0],  # skeletons
        i32(2) + bytes(2 * marker),
        channels,  # force plates
        channels,  # devices
    ]
    payload = i32(42) + b"".join(sections) + suffix
    frame = parse_frame(payload, version)
    assert [body.id for body in frame.bodies] == [3, 4]
    assert (frame.params, frame.exposure) == (6, 99 if version >= (3, 0) else None)
    for wrong in (payload[:-1], payload[4:], payload[:60] + payload[64:]):
        with pytest.raises(WireError):
            parse_frame(wrong, version)
