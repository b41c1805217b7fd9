"""Tests of datagrams: their headers, texts and numbers, and which need the protocol's version."""

import struct

import pytest

from tetractl.core.errors import WireError
from tetractl.lab.cameras.optitrack import natnet, wire
from tetractl.lab.cameras.optitrack.natnet import MessageKind, Version
from tetractl.lab.cameras.optitrack.payloads import NAME_MAX


def test_a_header_states_kind_and_size():
    datagram = wire.pack_datagram(MessageKind.TEXT, b"abc")
    assert datagram == struct.pack("<HH", 8, 3) + b"abc"
    assert wire.split_datagram(datagram) == (MessageKind.TEXT, b"abc")
    assert wire.split_datagram(wire.pack_datagram(MessageKind.TEXT, b"")) == (MessageKind.TEXT, b"")


@pytest.mark.parametrize(
    "datagram", [b"", b"\x08\x00\x00", b"\x08\0\x02\0a", b"\x08\0\x01\0ab", b"\x0b\0\0\0"]
)
def test_a_datagram_with_a_wrong_header_is_refused(datagram):
    with pytest.raises(WireError):
        wire.split_datagram(datagram)


def test_the_largest_datagram_is_packed_and_a_larger_one_refused():
    room = wire.DATAGRAM_MAX - wire.HEADER.size
    assert len(wire.pack_datagram(MessageKind.TEXT, bytes(room))) == wire.DATAGRAM_MAX
    with pytest.raises(WireError, match="does not fit"):
        wire.pack_datagram(MessageKind.TEXT, bytes(room + 1))


@pytest.mark.parametrize("kind", [MessageKind.FRAME, MessageKind.MODELDEF])
def test_frames_and_models_cannot_be_read_before_the_version_is_known(kind):
    with pytest.raises(WireError, match=f"{kind.name} received before"):
        wire.parse_datagram(wire.pack_datagram(kind, bytes(40)))


def test_messages_whose_contents_do_not_matter_are_read_without_a_version():
    for kind in (MessageKind.TEXT, MessageKind.KEEPALIVE, MessageKind.UNRECOGNIZED):
        assert wire.parse_datagram(wire.pack_datagram(kind, b"xyz")) == natnet.BareMessage(kind)
    assert wire.parse_datagram(wire.pack_datagram(MessageKind.RESPONSE, b"ok")) == natnet.Response(
        b"ok"
    )
    echo = wire.pack_datagram(MessageKind.ECHO_RESPONSE, struct.pack("<QQ", 5, 7))
    assert wire.parse_datagram(echo) == natnet.EchoResponse(client=5, server=7)


CLOCK_AND_PORT = struct.pack("<QH5x", 10_000_000, 1511)


def server_info(version, rest=CLOCK_AND_PORT):
    return wire.pack_datagram(MessageKind.SERVER_INFO, wire.pack_sender("Motive", version) + rest)


def test_a_server_before_3_0_reports_neither_its_clock_nor_its_port():
    for version in (Version(2, 9), Version(2, 10)):
        expected = natnet.ServerInfo("Motive", version, 0, 0)
        assert wire.parse_datagram(server_info(version)) == expected
        assert wire.parse_datagram(server_info(version, b"")) == expected
    for version in (Version(3, 0), Version(4, 3)):
        expected = natnet.ServerInfo("Motive", version, 10_000_000, 1511)
        assert wire.parse_datagram(server_info(version)) == expected
        with pytest.raises(WireError):
            wire.parse_datagram(server_info(version, b""))


def test_a_client_introduces_itself_and_pins_a_version_only_if_it_must():
    version = Version(3, 1)
    for pinned, size in [(False, wire.SENDER.size), (True, wire.SENDER.size + 5)]:
        kind, payload = wire.split_datagram(wire.pack_message(natnet.Connect(version, pinned)))
        assert (kind, len(payload)) == (MessageKind.CONNECT, size)
        assert wire.read_sender(payload) == ("tetractl", version)
    assert payload[-5:] == bytes([0, 3, 1, 0, 0])


def test_requests_are_texts_that_end_and_times_of_eight_bytes():
    asked = wire.split_datagram(wire.pack_message(natnet.NatNetRequest("UpAxis")))
    assert asked == (MessageKind.REQUEST, b"UpAxis\0")
    echo = wire.split_datagram(wire.pack_message(natnet.EchoRequest(2**40)))
    assert echo == (MessageKind.ECHO_REQUEST, struct.pack("<Q", 2**40))


@pytest.mark.parametrize(
    ("kind", "size"), [(MessageKind.KEEPALIVE, wire.SENDER.size), (MessageKind.DISCONNECT, 1)]
)
def test_a_message_without_contents_has_the_size_that_servers_expect(kind, size):
    assert wire.split_datagram(wire.pack_message(natnet.BareMessage(kind))) == (kind, bytes(size))


def test_names_are_as_long_as_their_field_and_have_no_zero():
    assert wire.pack_name("x" * NAME_MAX) == b"x" * NAME_MAX + b"\0"
    for name in ("x" * (NAME_MAX + 1), "a\0b", "\u00fc" * (NAME_MAX // 2 + 1)):
        with pytest.raises(WireError):
            wire.pack_name(name)


def test_texts_end_at_a_zero_or_with_their_field():
    assert wire.read_text(b"abc\0def") == "abc"
    assert wire.read_text(b"abc") == "abc"
    assert wire.read_text(b"x" * wire.TEXT_MAX) == "x" * wire.TEXT_MAX
    with pytest.raises(WireError, match="too long"):
        wire.read_text(b"x" * (wire.TEXT_MAX + 1))


def test_fields_have_exactly_their_size():
    layout = struct.Struct("<HI")
    assert wire.unpack_fields(layout, struct.pack("<HI", 1, 2)) == (1, 2)
    for payload in (bytes(5), bytes(7)):
        with pytest.raises(WireError, match="but 6 are expected"):
            wire.unpack_fields(layout, payload)
    with pytest.raises(WireError, match="cannot pack"):
        wire.pack_fields("H", 70_000)
