import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.core.errors import WireError
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi.broadcast import (
    ROBOTS_MAX,
    BroadcastCommand,
    Flag,
    Reply,
    Status,
    decode_command,
    decode_reply,
    encode_command,
    encode_reply,
)

u8, u16 = st.integers(0, 255), st.integers(0, 65535)
counts = st.integers(-127, 127)
flags = st.integers(0, 7).map(Flag)
commands = st.builds(
    BroadcastCommand, u8, flags, st.lists(st.tuples(counts, counts), max_size=ROBOTS_MAX).map(tuple)
)
replies = st.builds(Reply, u8, u8, st.integers(0, 7).map(Status), u16, u16, u16)


def test_documented_command():
    command = BroadcastCommand(7, Flag.RUN, ((64, -64), (127, 127), (0, 0)))
    frame = bytes.fromhex("09 51 07 01 03 40 C0 7F 7F 01 01 02 7D 00")
    assert encode_command(command) == frame
    assert decode_command(frame[:-1]) == command
    assert cobs.decode(frame[:-1]) == bytes.fromhex("51 07 01 03 40 C0 7F 7F 00 00 00 7D")


def test_crc_check_value():
    assert cobs.crc16(b"123456789") == 0x29B1


@pytest.mark.parametrize(
    ("payload", "stuffed"),
    [
        ("", "01 00"),
        ("00", "01 01 00"),
        ("00 00", "01 01 01 00"),
        ("11 22 00 33", "03 11 22 02 33 00"),
        ("11 00 00 00", "02 11 01 01 01 00"),
    ],
)
def test_stuffing_as_in_its_paper(payload, stuffed):
    assert cobs.encode(bytes.fromhex(payload)) == bytes.fromhex(stuffed)


@given(st.binary(max_size=600) | st.integers(250, 520).map(lambda size: b"x" * size))
def test_stuffing_round_trips(payload):
    frame = cobs.encode(payload)
    assert frame.index(0) == len(frame) - 1
    assert len(frame) <= len(payload) + 2 + len(payload) // 254
    assert cobs.decode(frame[:-1]) == payload


@given(commands)
def test_commands_round_trip(command):
    assert decode_command(encode_command(command)[:-1]) == command


@given(replies)
def test_replies_round_trip(reply):
    frame = encode_reply(reply)
    assert len(frame) == 14
    assert decode_reply(frame[:-1]) == reply
    with pytest.raises(WireError):
        decode_command(frame[:-1])


@given(commands)
def test_every_single_bit_error_is_detected(command):
    frame = encode_command(command)[:-1]
    for at in range(len(frame)):
        for bit in range(8):
            bad = bytearray(frame)
            bad[at] ^= 1 << bit
            with pytest.raises(WireError):
                decode_command(bytes(bad))


@pytest.mark.parametrize(
    "command",
    [
        BroadcastCommand(256, Flag(0)),
        BroadcastCommand(-1, Flag(0)),
        BroadcastCommand(0, Flag.RUN, ((-128, 0),)),
        BroadcastCommand(0, Flag.RUN, ((0, 128),)),
        BroadcastCommand(0, Flag.RUN, ((0, 0),) * (ROBOTS_MAX + 1)),
    ],
)
def test_bad_commands_are_not_encoded(command):
    with pytest.raises(WireError):
        encode_command(command)


@pytest.mark.parametrize(
    "payload",
    [
        b"\x51\x00\x08\x00",  # an unknown flag
        b"\x51\x00\x00\x01\x00",  # too short for one robot
        b"\x51\x00\x00\x00\x00",
        b"\x51\x00\x01\x01\x80\x00",  # -128
        b"\x52\x00\x00\x00",
        b"\x51\x00",
    ],
)
def test_bad_commands_with_a_good_crc_are_refused(payload):
    with pytest.raises(WireError):
        decode_command(cobs.frame_with_crc(payload)[:-1])


def test_replies_that_are_none():
    for bad in (Reply(256, 0, Status(0), 0, 0, 0), Reply(0, 0, Status(0), 70_000, 0, 0)):
        with pytest.raises(WireError):
            encode_reply(bad)
    with pytest.raises(WireError):
        decode_reply(encode_command(BroadcastCommand(1, Flag.POLL))[:-1])
    with pytest.raises(WireError):
        cobs.frame_with_crc(bytes(cobs.FRAME_MAX))


@given(st.lists(replies, max_size=6), st.lists(st.integers(0, 100), max_size=10), st.binary())
def test_replies_are_cut_out_of_any_stream(sent, cuts, garbage):
    stream = garbage.replace(b"\0", b"") + b"\0" + b"".join(map(encode_reply, sent))
    splitter = cobs.Splitter()
    edges = sorted({0, len(stream), *(cut % len(stream) for cut in cuts)})
    frames = [
        frame
        for start, stop in itertools.pairwise(edges)
        for frame in splitter.feed(stream[start:stop])
    ]
    assert [decode_reply(frame) for frame in frames[len(frames) - len(sent) :]] == sent
