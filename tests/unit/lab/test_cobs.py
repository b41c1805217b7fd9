"""Tests of the frames between PC and robots: what fits, what is refused, what a stream yields."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.lab import cobs

PAYLOADS = st.binary(min_size=1, max_size=cobs.PAYLOAD_BYTES_MAX - 2)


def crc_by_the_bit(data):
    """CRC-16/CCITT-FALSE as its definition computes it."""
    register = 0xFFFF
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
    return register


@given(st.binary(max_size=40))
def test_the_checksum_is_that_of_its_definition(data):
    assert cobs.crc16(data) == crc_by_the_bit(data)


@given(PAYLOADS)
def test_a_frame_has_no_zero_but_the_last_byte_and_gives_its_payload_back(payload):
    frame = cobs.encode_with_crc(payload)
    assert frame.index(0) == len(frame) - 1
    assert cobs.decode_with_crc(frame[:-1]) == payload


def test_a_frame_is_full_with_its_checksum_and_not_earlier():
    full = bytes(range(1, cobs.PAYLOAD_BYTES_MAX - 1))
    assert cobs.decode_with_crc(cobs.encode_with_crc(full)[:-1]) == full
    with pytest.raises(WireError, match="do not fit"):
        cobs.encode_with_crc(full + b"x")
    too_long = full + b"x"
    sealed = too_long + cobs.crc16(too_long).to_bytes(2, "little")
    with pytest.raises(WireError, match="cannot have 81 bytes"):
        cobs.decode_with_crc(cobs.encode(sealed)[:-1])


def test_a_checksum_alone_is_no_frame():
    empty = cobs.crc16(b"").to_bytes(2, "little")
    with pytest.raises(WireError, match="cannot have 2 bytes"):
        cobs.decode_with_crc(cobs.encode(empty)[:-1])


@pytest.mark.parametrize("frame", [b"", b"\x02a\x00", b"\x00", b"\x03a"])
def test_bytes_that_are_no_frame_are_refused(frame):
    with pytest.raises(WireError):
        cobs.decode(frame)


def test_flags_are_the_three_that_the_firmware_knows():
    assert cobs.parse_flags(0) == cobs.Flag(0)
    assert cobs.parse_flags(7) == cobs.Flag.RUN | cobs.Flag.EMERGENCY_STOP | cobs.Flag.POLL
    for flags in (8, 9, 128, 255):
        with pytest.raises(WireError, match="unknown flags"):
            cobs.parse_flags(flags)


def test_fields_come_back_from_a_message_of_their_type_and_size_alone():
    layout = struct.Struct("<BHb")
    frame = cobs.pack_fields(layout, 7, 500, -3)[:-1]
    assert cobs.unpack_fields(layout, 7, frame) == (500, -3)
    with pytest.raises(WireError, match="expected a frame of type 0x08"):
        cobs.unpack_fields(layout, 8, frame)
    with pytest.raises(WireError, match="received type 0x07 with 4 bytes"):
        cobs.unpack_fields(struct.Struct("<BH"), 7, frame)
    with pytest.raises(WireError, match="cannot pack"):
        cobs.pack_fields(layout, 7, 70_000, 0)


@settings(max_examples=40)
@given(st.lists(PAYLOADS, max_size=4), st.data())
def test_every_frame_of_a_stream_is_found_however_it_is_cut(payloads, data):
    stream = b"".join(cobs.encode_with_crc(payload) for payload in payloads)
    splitter = cobs.FrameSplitter()
    frames = []
    while stream:
        cut = data.draw(st.integers(1, min(len(stream), 60)))
        frames += splitter.feed(stream[:cut])
        stream = stream[cut:]
    assert [cobs.decode_with_crc(frame) for frame in frames] == payloads


@pytest.mark.parametrize("pieces", [1, 2, 7])
def test_a_frame_of_the_largest_size_is_kept_and_a_longer_one_dropped_alone(pieces):
    largest = b"x" * (cobs.PAYLOAD_BYTES_MAX + 1)
    for garbage, kept in [(largest, [largest]), (largest + b"x", []), (largest * 9, [])]:
        splitter = cobs.FrameSplitter()
        size = -(-len(garbage) // pieces)
        frames = [
            frame
            for begin in range(0, len(garbage), size)
            for frame in splitter.feed(garbage[begin : begin + size])
        ]
        assert frames == []
        assert splitter.feed(b"\0ab\0") == [*kept, b"ab"]


def test_two_frame_ends_in_a_row_are_no_frame():
    assert cobs.FrameSplitter().feed(b"\0\0ab\0\0") == [b"ab"]
