"""Tests of finding an XBee radio's frames in the stream of a serial port."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.targets import encode_at_response

from tetractl.core.errors import WireError
from tetractl.lab.actuators.xbee.api_frames import (
    AT_COMMAND,
    BROADCAST,
    CONTENT_BYTES_MAX,
    Decoder,
    answered,
    encode,
    received,
)

ESCAPED = [  # a content, and its frame in escaped mode
    # "Escape characters", page 152 of Digi's XBee/XBee-PRO S2C Zigbee RF Module User Guide
    (b"\x23\x11", "7E 00 02 23 7D 31 CB"),
    # frames of older manuals, whose pages are not known
    (bytes((AT_COMMAND, 1)) + b"BD\x08", "7E 00 05 08 01 42 44 08 68"),
    (
        bytes.fromhex("10010013A200400A0127FFFE0000") + b"TxData0A",
        "7E 00 16 10 01 00 7D 33 A2 00 40 0A 01 27 FF FE 00 00 54 78 44 61 74 61 30 41 7D 33",
    ),
]
S2C = "XBee/XBee-PRO S2C 802.15.4 RF Module User Guide"
SERIES_1 = "XBee/XBee-PRO RF Modules, 802.15.4, v1.xEx [2009.09.23]"
PRINTED = {
    f"{S2C}, page 117, broadcast": "7E 00 0E 01 00 FF FF 00 42 72 6F 61 64 63 61 73 74 6D",
    f"{S2C}, page 117, unicast": "7E 00 0B 01 87 12 34 00 54 78 44 61 74 61 EB",
    f"{S2C}, page 126": "7E 00 11 80 00 13 A2 00 12 34 56 78 5E 01 54 78 44 61 74 61 11",
    f"{S2C}, page 128": "7E 00 0B 81 12 34 5E 01 54 78 44 61 74 61 93",
    f"{S2C}, page 134, set": "7E 00 05 88 01 4E 49 00 DF",
    f"{S2C}, page 134, query": "7E 00 07 88 01 54 50 00 FF FE D5",
    f"{SERIES_1}, page 59": "7E 00 04 08 52 44 4C 15",
    "XBee SX 868 RF Module User Guide, page 191": (
        "7E 00 12 90 00 13 A2 00 41 AE B5 4E FF FE C1 54 78 44 61 74 61 C4"
    ),
    "XBee/XBee-PRO SE RF Modules, 2009, page 95": (
        "7E 00 18 91 00 13 A2 00 40 52 2B AA 7D 84 E0 E0 22 11 C1 05 02 52 78 44 61 74 61 52"
    ),
}
"""Every kind of frame that is sent or read, as Digi's manuals print it: without escapes."""
PAGES_OF_DATA = {f"{S2C}, page 126", f"{S2C}, page 128", *list(PRINTED)[-2:]}
SPECIAL_BYTES = st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5E, 0x00])
SPECIAL_CONTENTS = st.lists(SPECIAL_BYTES, min_size=1, max_size=40).map(bytes)
CONTENTS = st.binary(min_size=1, max_size=CONTENT_BYTES_MAX) | SPECIAL_CONTENTS
QUIET = st.binary(max_size=30).map(lambda raw: raw.replace(b"\x7e", b""))
"""Garbage in which no frame starts."""
QUIET_PARTS = st.lists(st.tuples(QUIET, CONTENTS), max_size=5)
CUTS = st.lists(st.integers(0, 1000), max_size=9)


def stream_of(parts):
    """The bytes of frames with these contents, each behind its garbage."""
    return b"".join(garbage + encode(content) for garbage, content in parts)


def escaped(frame):
    """A printed frame in escaped mode: 7D and the byte xor 20 stand for each special byte."""
    special = {byte: bytes((0x7D, byte ^ 0x20)) for byte in (0x7E, 0x7D, 0x11, 0x13)}
    return frame[:1] + b"".join(special.get(byte, bytes((byte,))) for byte in frame[1:])


@pytest.mark.parametrize(("content", "text"), ESCAPED)
def test_documented_escapes(content, text):
    assert encode(content) == bytes.fromhex(text)
    assert Decoder().feed(bytes.fromhex(text)) == [content]


@pytest.mark.parametrize("page", PRINTED)
def test_frames_that_manuals_print(page):
    frame = bytes.fromhex(PRINTED[page])
    content = frame[3:-1]
    assert encode(content) == escaped(frame)
    assert Decoder().feed(escaped(frame)) == [content]
    assert received(content)[1:] == (b"xData" if page in PAGES_OF_DATA else b"")


def test_our_broadcasts_and_requests_have_the_form_that_manuals_print():
    printed = bytes.fromhex(PRINTED[f"{S2C}, page 117, broadcast"])
    assert encode(BROADCAST + b"Broadcast") == escaped(printed)
    query = bytes.fromhex(PRINTED[f"{SERIES_1}, page 59"])
    assert encode(bytes((AT_COMMAND, 0x52)) + b"DL") == escaped(query)


def test_answers_that_manuals_print():
    contents = [
        bytes.fromhex(PRINTED[f"{S2C}, page 134, {what}"])[3:-1] for what in ("set", "query")
    ]
    assert [answered(content) for content in contents] == [
        (1, b"NI", b""),
        (1, b"TP", b"\xff\xfe"),
    ]


@pytest.mark.parametrize(
    "head",
    [
        "80 00 13 A2 00 12 34 56 78 5E 01",
        "81 12 34 5E 01",
        "90 00 13 A2 00 12 34 56 78 12 34 01",
        "91 00 13 A2 00 12 34 56 78 12 34 E8 E8 00 11 C1 05 01",
    ],
)
def test_data_is_read_from_every_frame_in_which_a_module_reports_it(head):
    head_bytes = bytes.fromhex(head)
    assert received(head_bytes + b"TxData") == b"TxData"
    for size in range(1, len(head_bytes) + 1):
        assert not received(head_bytes[:size])


def test_answers_to_requests():
    assert answered(encode_at_response(5, b"AP", b"\x02")) == (5, b"AP", b"\x02")
    assert answered(encode_at_response(5, b"QQ", None)) == (5, b"QQ", None)
    assert answered(encode_at_response(5, b"AP", b"")[:-1]) is None
    assert answered(b"\x81\0\1\0\0") is None


@given(QUIET_PARTS, CUTS)
def test_garbage_between_frames_is_dropped_and_counted(parts, cuts):
    decoder = Decoder()
    decoded = []
    stream = stream_of(parts)
    places = [cut % (len(stream) + 1) for cut in cuts]
    edges = sorted({0, len(stream), *places})
    for start, stop in itertools.pairwise(edges):
        decoded += decoder.feed(stream[start:stop])
    assert decoded == [content for _, content in parts]
    assert decoder.dropped_bytes == sum(len(garbage) for garbage, _ in parts)


@given(content=CONTENTS, place=st.integers(1, 1000), bit=st.integers(0, 7))
def test_a_flipped_bit_never_gives_a_wrong_frame(content, place, bit):
    raw = bytearray(encode(content))
    place = max(3, place % len(raw))  # content or checksum: a length may cut a shorter frame out
    raw[place] ^= 1 << bit
    assert content not in Decoder().feed(bytes(raw))


@pytest.mark.parametrize("torn", ["7E", "7E 00", "7E 00 03", "7E 00 03 89 7D", "7E 00 7D", "7D"])
def test_a_frame_behind_a_torn_one_is_found(torn):
    decoder = Decoder()
    torn_bytes = bytes.fromhex(torn)
    assert decoder.feed(torn_bytes + encode(b"\x89\1\0")) == [b"\x89\1\0"]
    assert decoder.dropped_bytes == len(torn_bytes)


@pytest.mark.parametrize("size", [0, CONTENT_BYTES_MAX + 1])
def test_frames_longer_than_the_radio_takes_are_not_encoded(size):
    with pytest.raises(WireError):
        encode(bytes(size))


def test_a_frame_of_another_kind_reports_no_data():
    modem_status = b"\x8a" + bytes(18)
    assert received(modem_status) == b""


def test_a_frame_with_a_wrong_checksum_is_dropped_whole():
    good = encode(b"\x89\1\0")
    decoder = Decoder()
    assert decoder.feed(good[:-1] + b"\x76" + good) == [b"\x89\1\0"]
    assert decoder.dropped_bytes == len(good)
