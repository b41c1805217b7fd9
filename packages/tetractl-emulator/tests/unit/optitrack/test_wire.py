"""Tests of NatNet packing and parsing: round trips, layouts written by hand, and damage."""

import struct
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.natnet_samples import VERSIONS, every_version, full_frame, full_modeldef
from tetractl_emulator.optitrack.natnet_server import pack_answer, pack_modeldef, parse_request

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.wire import (
    pack_datagram,
    pack_message,
    parse_datagram,
    read_number,
)

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
    assert parse_datagram(pack_answer(frame, version), version) == frame
    among_all_else = parse_datagram(full_frame(version, frame.bodies, frame.params), version)
    assert among_all_else.bodies == frame.bodies
    assert among_all_else.params == frame.params


@given(
    version=st.sampled_from(VERSIONS),
    names_and_ids=tuples(st.tuples(names, i32)),
    markers=st.integers(0, 3),
)
def test_models_round_trip(version, names_and_ids, markers):
    model = natnet.ModelDef(names_and_ids)
    payload = pack_modeldef(model, version, markers=markers)
    assert parse_datagram(pack_datagram(natnet.MessageKind.MODELDEF, payload), version) == model


@pytest.mark.parametrize(
    ("version", "kind"), [(natnet.Version(2, 9), 3), (natnet.Version(4, 0), 9)], ids=str
)
def test_an_unknown_data_set_ends_the_reading_and_says_so(version, kind):
    packed = pack_modeldef(natnet.ModelDef((("green", 1),)), version, [(kind, b"?")])
    parsed = parse_datagram(pack_datagram(natnet.MessageKind.MODELDEF, packed), version)
    assert parsed == natnet.ModelDef((), complete=False)


POSE = struct.pack("<i7f", 3, 1, 2, 3, 0, 0, 0, 1)  # of body 3: its position and quaternion
MARKER = struct.pack("<i3fif", 1, 9, 9, 9, 1, 0.01)  # in bodies before 3.0


@dataclass(frozen=True)
class HandwrittenFrame:
    """Frame 42 with one body, packed by the layout of a version.

    `head` are the frame's number, the counts of the sections before that of bodies, the number of
    bodies and, since 4.1, the size of each section; `others` bytes of empty sections follow the
    body. `tracked`, `params` and `exposure` are what body and suffix say.
    """

    version: str
    head: bytes
    body: bytes
    others: int
    suffix: bytes
    tracked: bool
    params: int
    exposure: int | None

    @property
    def payload(self):
        return self.head + self.body + bytes(self.others) + self.suffix


FRAMES = [
    HandwrittenFrame(
        version="2.9",
        head=struct.pack("<iiii", 42, 0, 0, 1),
        body=POSE + MARKER + struct.pack("<fH", 0.5, 1),
        others=3 * 4,
        suffix=struct.pack("<fIIdHi", 0.25, 6, 7, 8.5, 5, 0),
        tracked=True,
        params=5,
        exposure=None,
    ),
    HandwrittenFrame(
        version="3.0",
        head=struct.pack("<iiii", 42, 0, 0, 1),
        body=POSE + struct.pack("<fH", 0.5, 1),
        others=4 * 4,
        suffix=struct.pack("<IIdQQQHi", 6, 7, 8.5, 10, 11, 12, 4, 0),
        tracked=True,
        params=4,
        exposure=10,
    ),
    HandwrittenFrame(
        version="4.2",
        head=struct.pack("<iiiiiii", 42, 0, 0, 0, 0, 1, 38),
        body=POSE + struct.pack("<fH", 0.5, 2),
        others=5 * 8,
        suffix=struct.pack("<IIdQQQIIHi", 6, 7, 8.5, 10, 11, 12, 13, 14, 3, 0),
        tracked=False,
        params=3,
        exposure=10,
    ),
]


@pytest.mark.parametrize("written", FRAMES, ids=lambda written: written.version)
def test_frames_as_written_by_hand(written):
    payload = written.payload
    header = struct.pack("<HH", natnet.MessageKind.FRAME, len(payload))
    frame = parse_datagram(header + payload, natnet.Version.parse(written.version))
    body = natnet.RigidBody(3, (1, 2, 3), (0, 0, 0, 1), written.tracked)
    assert frame == natnet.NatNetFrame(42, (body,), written.params, written.exposure)
    assert frame.is_edit_mode == bool(written.params & 4)
    assert frame.models_changed == bool(written.params & 2)


@pytest.mark.parametrize(
    ("pack", "read", "message", "size"),
    [
        (pack_message, parse_request, natnet.Connect(V41), 268),
        (pack_message, parse_request, natnet.Connect(V41, pinned=True), 273),
        (pack_message, parse_request, natnet.BareMessage(natnet.MessageKind.KEEPALIVE), 268),
        (pack_message, parse_request, natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF), 5),
        (pack_message, parse_request, natnet.BareMessage(natnet.MessageKind.DISCONNECT), 5),
        (pack_message, parse_request, natnet.EchoRequest(2**64 - 1), 12),
        (pack_message, parse_request, natnet.NatNetRequest("UpAxis"), 11),
        (
            pack_answer,
            parse_datagram,
            natnet.ServerInfo("Motive", natnet.Version(2, 10), 0, 0),
            268,
        ),
        (pack_answer, parse_datagram, natnet.ServerInfo("Motive", V41, 10**7, 1511), 283),
        (pack_answer, parse_datagram, natnet.BareMessage(natnet.MessageKind.UNRECOGNIZED), 4),
        (pack_answer, parse_datagram, natnet.EchoResponse(1, 2**64 - 1), 20),
        (pack_answer, parse_datagram, natnet.Response(b"\0\0\xf0\x42"), 8),
    ],
    ids=lambda value: type(value).__name__,
)
def test_handshake_messages_round_trip_in_their_sizes(pack, read, message, size):
    packed = pack(message)
    assert len(packed) == size
    assert read(packed) == message


def test_the_number_of_a_response_is_read_as_its_question_asks():
    assert read_number(natnet.Response(struct.pack("<f", 120.0)), "f") == 120.0
    assert read_number(natnet.Response(struct.pack("<i", 1)), "i") == 1
    with pytest.raises(WireError):
        read_number(natnet.Response(b"text\0"), "i")


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
        (pack_datagram(natnet.MessageKind.SERVER_INFO, bytes(263)), None),
        (
            pack_datagram(natnet.MessageKind.SERVER_INFO, bytes(260) + b"\4\1\0\0"),
            None,
        ),  # 4.1 is longer
        (pack_datagram(natnet.MessageKind.ECHO_RESPONSE, bytes(15)), None),
        (pack_datagram(natnet.MessageKind.MODELDEF, struct.pack("<ii", 1, 1) + b"x" * 300), V30),
    ],
)
def test_bad_datagrams_raise_the_one_exception(packed, version):
    with pytest.raises(WireError):
        parse_datagram(packed, version)


@every_version
def test_every_truncation_is_refused(version):
    _, modeldef = full_modeldef(version)
    for packed in (full_frame(version), modeldef):
        for size in range(4, len(packed)):
            cut = packed[:2] + struct.pack("<H", size - 4) + packed[4:size]
            with pytest.raises(WireError):
                parse_datagram(cut, version)
