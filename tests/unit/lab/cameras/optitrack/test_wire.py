"""NatNet packing and parsing: round trips, layouts written out by hand, and damage."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.natnet_samples import (
    VERSIONS,
    Channels,
    Clutter,
    every_version,
    full_frame,
    full_modeldef,
    pack_full_frame,
)

from tetractl.core.errors import WireError
from tetractl.emulate.optitrack.natnet_server import pack_answer, pack_modeldef, parse_request
from tetractl.lab.cameras.optitrack.natnet_messages import (
    Bare,
    BodyName,
    Connect,
    EchoRequest,
    EchoResponse,
    MessageKind,
    ModelDef,
    NatNetFrame,
    NatNetRequest,
    Response,
    RigidBody,
    ServerInfo,
    Ticks,
    Version,
)
from tetractl.lab.cameras.optitrack.wire import datagram, pack, parse, response_float, response_int

f32 = st.floats(width=32, allow_nan=False)
i32 = st.integers(-(2**31), 2**31 - 1)
u16, u32, u64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
vec3 = st.tuples(f32, f32, f32)
names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=60)


def tuples(items, most=3):
    return st.lists(items, max_size=most).map(tuple)


bodies = tuples(st.builds(RigidBody, i32, vec3, st.tuples(f32, f32, f32, f32), st.booleans()))


def frames(version):
    ticks = st.builds(Ticks, u64, u64, u64) if version >= (3, 0) else st.none()
    return st.builds(NatNetFrame, number=i32, bodies=bodies, params=u16, ticks=ticks)


def clutters():
    channels = tuples(st.builds(Channels, i32, tuples(tuples(f32))))
    return st.builds(
        Clutter,
        marker_sets=tuples(st.tuples(names, tuples(vec3))),
        other_markers=tuples(vec3),
        body_markers=tuples(vec3),
        skeletons=tuples(st.tuples(i32, bodies)),
        assets=tuples(st.tuples(i32, bodies, tuples(vec3))),
        labelled_markers=tuples(st.tuples(i32, vec3)),
        force_plates=channels,
        devices=channels,
    )


@given(version=st.sampled_from(VERSIONS), data=st.data())
def test_frames_round_trip(version, data):
    frame = data.draw(frames(version))
    assert parse(pack_answer(frame, version), version) == frame
    assert parse(pack_full_frame(frame, version, data.draw(clutters())), version) == frame


@given(
    version=st.sampled_from(VERSIONS),
    found=tuples(st.builds(BodyName, names, i32)),
    markers=st.integers(0, 3),
)
def test_models_round_trip(version, found, markers):
    model = ModelDef(found)
    payload = pack_modeldef(model, version, markers=markers)
    assert parse(datagram(MessageKind.MODELDEF, payload), version) == model


@every_version
def test_models_are_found_behind_other_data_sets(version):
    model, packed = full_modeldef(version)
    assert parse(packed, version) == model
    assert model.ids() == {"green": 1, "blü": 2}


@pytest.mark.parametrize("version", [Version(2, 9), Version(4, 0)], ids=str)
def test_an_unknown_data_set_ends_the_reading_and_says_so(version):
    packed = pack_modeldef(ModelDef((BodyName("green", 1),)), version, [(9, b"?")])
    assert parse(datagram(MessageKind.MODELDEF, packed), version) == ModelDef((), complete=False)


def test_a_skeletons_bones_are_not_robots():
    bone = b"hip\0" + struct.pack("<ii3fi", 1, 0, 0, 0, 0, 0)
    other = (2, b"actor\0" + struct.pack("<ii", 5, 1) + bone)
    payload = pack_modeldef(ModelDef((BodyName("green", 4),)), Version(3, 1), [other])
    assert parse(datagram(MessageKind.MODELDEF, payload), Version(3, 1)).ids() == {"green": 4}


def test_frame_2_9_as_written_by_hand():
    body = struct.pack("<i7f", 3, 1, 2, 3, 0, 0, 0, 1)
    body += struct.pack("<i3fif", 1, 9, 9, 9, 1, 0.01) + struct.pack("<fH", 0.5, 1)
    payload = struct.pack("<iiii", 42, 0, 0, 1) + body + struct.pack("<iii", 0, 0, 0)
    payload += struct.pack("<fIIdHi", 0.25, 6, 7, 8.5, 4, 0)
    frame = parse(struct.pack("<HH", 7, len(payload)) + payload, Version(2, 9))
    assert frame == NatNetFrame(42, (RigidBody(3, (1, 2, 3), (0, 0, 0, 1), True),), 4)
    assert (frame.edit_mode, frame.models_changed) == (True, False)


def test_frame_4_2_as_written_by_hand():
    body = struct.pack("<i7ffH", 3, 1, 2, 3, 0, 0, 0, 1, 0.5, 2)
    payload = struct.pack("<iiiiiii", 42, 0, 0, 0, 0, 1, 38) + body + bytes(5 * 8)
    payload += struct.pack("<IIdQQQIIHi", 6, 7, 8.5, 10, 11, 12, 13, 14, 3, 0)
    frame = parse(struct.pack("<HH", 7, len(payload)) + payload, Version(4, 2))
    ticks = Ticks(10, 11, 12)
    body = RigidBody(3, (1, 2, 3), (0, 0, 0, 1), False)
    assert frame == NatNetFrame(42, (body,), 3, ticks)
    assert frame.models_changed
    assert struct.unpack_from("<H", payload, len(payload) - 6) == (3,)  # params, from the tail


SENT = (
    Bare(MessageKind.KEEPALIVE),
    Bare(MessageKind.REQUEST_MODELDEF),
    Bare(MessageKind.DISCONNECT),
)


@pytest.mark.parametrize(
    ("message", "size"),
    [
        (Connect("tetractl", (1, 0, 0, 0), (4, 1, 0, 0)), 268),
        (Connect("tetractl", (1, 0, 0, 0), (4, 1, 0, 0), True, (4, 1, 0, 0)), 273),
        (ServerInfo("Motive", (1, 9, 0, 0), (2, 10, 0, 0)), 268),
        (
            ServerInfo("Motive", (3, 1, 0, 0), (4, 1, 0, 0), 10**7, 1511, True, (239, 255, 42, 99)),
            283,
        ),
        (Bare(MessageKind.KEEPALIVE), 268),
        (Bare(MessageKind.REQUEST_MODELDEF), 5),
        (Bare(MessageKind.DISCONNECT), 5),
        (Bare(MessageKind.UNRECOGNIZED), 4),
        (EchoRequest(2**64 - 1), 12),
        (EchoResponse(1, 2**64 - 1), 20),
        (NatNetRequest("FrameRate"), 14),
        (Response(b"\0\0\xf0\x42"), 8),
    ],
    ids=lambda value: type(value).__name__,
)
def test_handshake_messages_round_trip_in_their_sizes(message, size):
    ours = isinstance(message, Connect | EchoRequest | NatNetRequest) or message in SENT
    packed = (pack if ours else pack_answer)(message)
    assert len(packed) == size
    assert (parse_request if ours else parse)(packed) == message
    with pytest.raises(WireError):
        (pack_answer if ours else pack)(message)


def test_details_of_the_handshake():
    info = ServerInfo("Motive", (1, 9, 0, 0), (2, 10, 0, 0))
    packed = bytearray(pack_answer(info))
    packed[4 + 7 : 4 + 256] = b"\xff" * 249  # garbage after the name's NUL
    assert parse(bytes(packed)) == info
    assert Version(2, 9) < info.version == (2, 10)
    assert parse_request(datagram(MessageKind.CONNECT, b"Ping\0")) == Connect("Ping")
    assert response_float(Response(struct.pack("<f", 120.0))) == 120.0
    assert response_int(Response(struct.pack("<i", 1))) == 1
    for read in (response_float, response_int):
        with pytest.raises(WireError):
            read(Response(b"text\0"))


@pytest.mark.parametrize(
    ("packed", "version"),
    [
        (b"", None),
        (b"\x07\0\0", None),
        (struct.pack("<HH", 7, 5) + bytes(4), Version(3, 0)),  # the header lies
        (struct.pack("<HH", 11, 0), None),  # no such message
        (pack_answer(NatNetFrame(1, ()), Version(3, 0)), None),  # a frame before SERVERINFO
        (pack_answer(NatNetFrame(1, ()), Version(2, 6)), Version(2, 5)),
        (pack_answer(NatNetFrame(1, ()), Version(3, 0)), Version(4, 1)),  # another version's layout
        (pack_answer(NatNetFrame(1, ()), Version(4, 1)), Version(3, 0)),
        (datagram(MessageKind.SERVER_INFO, bytes(263)), None),
        (datagram(MessageKind.SERVER_INFO, bytes(260) + b"\4\1\0\0"), None),  # 4.1 is longer
        (datagram(MessageKind.ECHO_RESPONSE, bytes(15)), None),
        (datagram(MessageKind.MODELDEF, struct.pack("<ii", 1, 1) + b"x" * 300), Version(3, 0)),
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
