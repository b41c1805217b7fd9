import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paths import ROOT

from tetractl.core.errors import WireError
from tetractl.lab import cobs
from tetractl.lab.actuators.field.driver import (
    DriverStatus,
    FieldCommand,
    FieldFlag,
    FieldReply,
    decode_command,
    decode_reply,
    encode_command,
    encode_reply,
)

WIRES = ROOT / "docs" / "reference" / "wires.md"
COMMAND = FieldCommand(7, FieldFlag.RUN | FieldFlag.POLL, 300, -250)
REPLY = FieldReply(7, DriverStatus.RUNNING, 1, 299, -250, 12_040, 253, 412, 0, 2000, 20_000, 250)

i16, u8, u16 = st.integers(-32_768, 32_767), st.integers(0, 255), st.integers(0, 65_535)
commands = st.builds(FieldCommand, u8, st.integers(0, 7).map(FieldFlag), i16, i16)
replies = st.builds(
    FieldReply,
    u8,
    st.integers(0, 31).map(DriverStatus),
    u8,
    *(i16, i16, u16, i16),
    *(u16, u16),
    *(u16, st.integers(0, 2**32 - 1), u16),
)


@pytest.mark.parametrize("frame", [encode_command(COMMAND), encode_reply(REPLY)])
def test_the_documented_bytes_are_those_sent(frame):
    assert frame.hex(" ").upper() in " ".join(WIRES.read_text().split())


@given(commands)
def test_commands_round_trip(command):
    frame = encode_command(command)
    assert frame.index(0) == len(frame) - 1 == 10
    assert decode_command(frame[:-1]) == command


@given(replies)
def test_replies_round_trip(reply):
    frame = encode_reply(reply)
    assert frame.index(0) == len(frame) - 1 == 27
    assert decode_reply(frame[:-1]) == reply


@given(
    st.binary(max_size=100)
    | st.binary(min_size=1, max_size=78).map(lambda b: cobs.frame_with_crc(b)[:-1])
)
def test_any_bytes_are_a_frame_or_refused(raw):
    for decode, encode in ((decode_command, encode_command), (decode_reply, encode_reply)):
        try:
            read = decode(raw)
        except WireError:
            continue
        assert decode(encode(read)[:-1]) == read


@pytest.mark.parametrize(
    "command",
    [
        FieldCommand(256, FieldFlag.RUN),
        FieldCommand(-1, FieldFlag.RUN),
        FieldCommand(0, FieldFlag.RUN, 32_768, 0),
        FieldCommand(0, FieldFlag.RUN, 0, -32_769),
        FieldCommand(0, FieldFlag(8)),
    ],
)
def test_what_does_not_fit_is_refused(command):
    with pytest.raises(WireError):
        encode_command(command)


def test_unknown_flags_are_refused_and_unknown_status_bits_dropped():
    with pytest.raises(WireError, match="flags"):
        decode_command(cobs.frame_with_crc(bytes.fromhex("53 01 08 00 00 00 00"))[:-1])
    raw = bytearray(cobs.decode(encode_reply(REPLY)[:-1])[:-2])
    raw[2] |= 0xE0
    assert decode_reply(cobs.frame_with_crc(bytes(raw))[:-1]) == REPLY
