"""Tests of the text lines that robots receive, and of their replies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.device_replies import reply_line

from tetractl.core.errors import WireError
from tetractl.lab.actuators.twist.lines import (
    LINE_MAX,
    LineCommand,
    decode_command,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.cobs import Flag

numbers = st.integers(-5000, 5000)
of_one_robot = st.tuples(st.integers(0, 31), numbers, numbers)
commands = st.builds(
    LineCommand,
    st.sampled_from("TW"),
    st.integers(0, 255),
    st.sampled_from([Flag(n) for n in range(8)]),
    st.lists(of_one_robot, max_size=16).map(tuple),
)
counts = st.integers(0, 65535)
replies = st.builds(
    Reply,
    st.integers(0, 31),
    st.integers(0, 255),
    st.sampled_from([Status(n) for n in range(8)]),
    counts,
    counts,
    counts,
)


def test_a_line_is_as_the_page_shows_it():
    command = LineCommand("T", 17, Flag.RUN, ((0, 150, -2000), (1, 150, 1320)))
    assert encode_command(command) == b"T 17 1 0 150 -2000 1 150 1320*757A\n"
    assert encode_command(LineCommand("T", 18, Flag(0))) == b"T 18 0*767D\n"
    reply = Reply(1, 17, Status.RUNNING, 4987, 25, 0)
    assert reply_line(reply) == b"S 1 17 1 4987 25 0*0CBB\n"


@given(commands)
def test_commands_come_back(command):
    line = encode_command(command)
    assert len(line) <= LINE_MAX + 1
    assert line[-1:] == b"\n"
    assert b"\n" not in line[:-1]
    assert decode_command(line[:-1]) == command
    assert decode_command(line[:-1] + b"\r") == command


@given(replies)
def test_replies_come_back(reply):
    assert decode_reply(reply_line(reply)[:-1]) == reply


@given(commands, st.data())
def test_a_changed_character_is_noticed(command, data):
    line = bytearray(encode_command(command)[:-1])
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(WireError):
        decode_command(bytes(line))


@given(st.binary(max_size=60))
def test_other_bytes_are_no_lines(data):
    for decode in (decode_command, decode_reply):
        with pytest.raises(WireError):
            decode(data)


@pytest.mark.parametrize(
    "wrong",
    [
        LineCommand("T", 256, Flag.RUN),
        LineCommand("T", 1, Flag.RUN, ((32, 0, 0),)),
        LineCommand("T", 1, Flag.RUN, ((0, 5001, 0),)),
        LineCommand("T", 1, Flag.RUN, ((0, 0, -50_001),)),
        LineCommand("W", 1, Flag.RUN, ((0, 0, 5001),)),
        LineCommand("W", 1, Flag.RUN, ((31, 5000, -5000),) * 32),
    ],
)
def test_what_cannot_be_sent_is_refused(wrong):
    with pytest.raises(WireError):
        encode_command(wrong)
