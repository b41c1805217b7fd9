"""NatNet packing and parsing: round trips, layouts written out by hand, and damage."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.natnet_samples import BODY, VERSIONS, every_version, full_frame, full_modeldef
from tetractl_emulator.optitrack.natnet_server import pack_answer, pack_modeldef, parse_request

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.wire import datagram, number_in, pack, parse

pytestmark = pytest.mark.slow

EMPTY = natnet.NatNetFrame(1, ())
V30 = natnet.Version(3, 0)
V41 = natnet.Version(4, 1)
f32 = st.floats(width=32, allow_nan=False)
i32 = st.integers(-(2**31), 2**31 - 1)
u16, u64 = (st.integers(0, 2**bits - 1) for bits in (16, 64))
vec3 = st.tuples(f32, f32, f32)
names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=60)


def tuples(items, most=3):
    return st.lists(items, max_size=most).map(tuple)


bodies = tuples(
    st.builds(natnet.RigidBody, i32, vec3, st.tuples(f32, f32, f32, f32), st.booleans())
)


def frames(version):
    exposure = u64 if version >= (3, 0) else st.none()
    return st.builds(natnet.NatNetFrame, number=i32, bodies=bodies, params=u16, exposure=exposure)


@given(version=st.sampled_from(VERSIONS), data=st.data())
def test_frames_round_trip(version, data):
    frame = data.draw(frames(version))
    assert parse(pack_answer(frame, version), version) == frame
    among_all_else = parse(full_frame(version, frame.bodies, frame.params), version)
    assert (among_all_else.bodies, among_all_else.params) == (frame.bodies, frame.params)


@given(
    version=st.sampled_from(VERSIONS),
    found=tuples(st.tuples(names, i32)),
    markers=st.integers(0, 3),
)
def test_models_round_trip(version, found, markers):
    model = natnet.ModelDef(found)
    payload = pack_modeldef(model, version, markers=markers)
    assert parse(datagram(natnet.MessageKind.MODELDEF, payload), version) == model


@every_version
def test_models_are_found_behind_other_data_sets(version):
    model, packed = full_modeldef(version)
    assert parse(packed, version) == model
    assert model.ids() == {"green": 1, "blü": 2}


@pytest.mark.parametrize(
    ("version", "kind"), [(natnet.Version(2, 9), 3), (natnet.Version(4, 0), 9)], ids=str
)
def test_an_unknown_data_set_ends_the_reading_and_says_so(version, kind):
    packed = pack_modeldef(natnet.ModelDef((("green", 1),)), version, [(kind, b"?")])
    parsed = parse(datagram(natnet.MessageKind.MODELDEF, packed), version)
    assert parsed == natnet.ModelDef((), complete=False)


def test_a_skeletons_bones_are_not_robots():
    bone = b"hip\0" + struct.pack("<ii3fi", 1, 0, 0, 0, 0, 0)
    other = (2, b"actor\0" + struct.pack("<ii", 5, 1) + bone)
    payload = pack_modeldef(natnet.ModelDef((("green", 4),)), natnet.Version(3, 1), [other])
    assert parse(datagram(natnet.MessageKind.MODELDEF, payload), natnet.Version(3, 1)).ids() == {
        "green": 4
    }


POSE = struct.pack("<i7f", 3, 1, 2, 3, 0, 0, 0, 1)
MARKER = struct.pack("<i3fif", 1, 9, 9, 9, 1, 0.01)  # in bodies before 3.0


@pytest.mark.parametrize(
    ("version", "head", "body", "rest", "suffix", "read"),
    [
        ("2.9", "iiii", MARKER, 3 * 4, ("fIIdHi", 0.25, 6, 7, 8.5, 5, 0), (True, 5, None)),
        ("3.0", "iiii", b"", 4 * 4, ("IIdQQQHi", 6, 7, 8.5, 10, 11, 12, 4, 0), (True, 4, 10)),
        (
            "4.2",
            "iiiiiii",
            b"",
            5 * 8,
            ("IIdQQQIIHi", 6, 7, 8.5, 10, 11, 12, 13, 14, 3, 0),
            (False, 3, 10),
        ),
    ],
)
def test_frames_as_written_by_hand(version, head, body, rest, suffix, read):
    counts = (0, 0, 1) if len(head) == 4 else (0, 0, 0, 0, 1, 38)
    tracked, params, exposure = read
    payload = (
        struct.pack("<" + head, 42, *counts)
        + POSE
        + body
        + struct.pack("<fH", 0.5, 1 if tracked else 2)
    )
    layout, *fields = suffix
    payload += bytes(rest) + struct.pack("<" + layout, *fields)
    frame = parse(struct.pack("<HH", 7, len(payload)) + payload, natnet.Version.of(version))
    shown = natnet.RigidBody(3, (1, 2, 3), (0, 0, 0, 1), tracked)
    assert frame == natnet.NatNetFrame(42, (shown,), params, exposure)
    assert (frame.edit_mode, frame.models_changed) == (bool(params & 4), bool(params & 2))
    assert struct.unpack_from("<H", payload, len(payload) - 6) == (params,)  # from the tail


@pytest.mark.parametrize(
    ("pack", "parse", "message", "size"),
    [
        (pack, parse_request, natnet.Connect(V41), 268),
        (pack, parse_request, natnet.Connect(V41, pinned=True), 273),
        (pack, parse_request, natnet.Bare(natnet.MessageKind.KEEPALIVE), 268),
        (pack, parse_request, natnet.Bare(natnet.MessageKind.REQUEST_MODELDEF), 5),
        (pack, parse_request, natnet.Bare(natnet.MessageKind.DISCONNECT), 5),
        (pack, parse_request, natnet.EchoRequest(2**64 - 1), 12),
        (pack, parse_request, natnet.NatNetRequest("UpAxis"), 11),
        (pack_answer, parse, natnet.ServerInfo("Motive", natnet.Version(2, 10), 0, 0), 268),
        (pack_answer, parse, natnet.ServerInfo("Motive", V41, 10**7, 1511), 283),
        (pack_answer, parse, natnet.Bare(natnet.MessageKind.UNRECOGNIZED), 4),
        (pack_answer, parse, natnet.EchoResponse(1, 2**64 - 1), 20),
        (pack_answer, parse, natnet.Response(b"\0\0\xf0\x42"), 8),
    ],
    ids=lambda value: type(value).__name__,
)
def test_handshake_messages_round_trip_in_their_sizes(pack, parse, message, size):
    packed = pack(message)
    assert len(packed) == size
    assert parse(packed) == message


def test_details_of_the_handshake():
    info = natnet.ServerInfo("Motive", V41, 10**7, 1511)
    packed = bytearray(pack_answer(info))
    packed[4 + 7 : 4 + 256] = b"\xff" * 249  # garbage after the name's NUL
    assert parse(bytes(packed)) == info
    assert natnet.Version(2, 9) < natnet.Version.of("2.10")
    assert number_in(natnet.Response(struct.pack("<f", 120.0)), "f") == 120.0
    assert number_in(natnet.Response(struct.pack("<i", 1)), "i") == 1
    with pytest.raises(WireError):
        number_in(natnet.Response(b"text\0"), "i")


@pytest.mark.parametrize(
    ("packed", "version"),
    [
        (b"", None),
        (b"\x07\0\0", None),
        (struct.pack("<HH", 7, 5) + bytes(4), V30),  # the header lies
        (struct.pack("<HH", 11, 0), None),  # no such message
        (pack_answer(EMPTY, V30), None),  # a frame before SERVERINFO
        (pack_answer(EMPTY, natnet.Version(2, 6)), natnet.Version(2, 5)),
        (pack_answer(EMPTY, V30), V41),  # another version's layout
        (pack_answer(EMPTY, V41), V30),
        (datagram(natnet.MessageKind.SERVER_INFO, bytes(263)), None),
        (datagram(natnet.MessageKind.SERVER_INFO, bytes(260) + b"\4\1\0\0"), None),  # 4.1 is longer
        (datagram(natnet.MessageKind.ECHO_RESPONSE, bytes(15)), None),
        (datagram(natnet.MessageKind.MODELDEF, struct.pack("<ii", 1, 1) + b"x" * 300), V30),
    ],
)
def test_bad_datagrams_raise_the_one_exception(packed, version):
    with pytest.raises(WireError):
        parse(packed, version)


@every_version
def test_every_truncation_is_refused(version):
    for whole in (full_frame(version), full_modeldef(version)[1]):
        for size in range(4, len(whole)):
            cut = whole[:2] + struct.pack("<H", size - 4) + whole[4:size]
            with pytest.raises(WireError):
                parse(cut, version)


def test_a_wrong_size_of_the_section_of_bodies_is_refused():
    packed_answer = pack_answer(natnet.NatNetFrame(1, (BODY,)), V41)
    assert parse(packed_answer, V41).number == 1
    stated = struct.pack("<ii", 1, 38)  # one body, and its size
    assert packed_answer.count(stated) == 1
    with pytest.raises(WireError, match="the stated size of the rigid bodies is wrong"):
        parse(packed_answer.replace(stated, struct.pack("<ii", 1, 39)), V41)
