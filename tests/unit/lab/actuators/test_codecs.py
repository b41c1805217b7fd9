"""Tests of the bytes between host and robots: COBS frames, m3pi frames and wheel counts."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.codec_checks import ANY_BYTES, check_any_bytes, check_round_trip
from testkit.device_replies import packed_reply
from testkit.lab_specs import SPEC
from testkit.paths import ROOT

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import WireError
from tetractl.core.poses import Pose
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.m3pi.actuator import M3piActuator
from tetractl.lab.actuators.m3pi.broadcast import ROBOTS_MAX, BroadcastCommand
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.cobs import Flag
from tetractl.spec.load import parse_spec

ROBOTS = BroadcastCommand(7, Flag.RUN, ((64, -64), (127, 127), (0, 0)))

u8 = st.integers(0, 255)
u16 = st.integers(0, 65_535)
counts = st.integers(-127, 127)
flags = st.integers(0, 7)
pairs = st.lists(st.tuples(counts, counts), max_size=ROBOTS_MAX).map(tuple)
robots = st.builds(BroadcastCommand, u8, flags.map(Flag), pairs)
robot_replies = st.builds(Reply, u8, u8, flags.map(Status), u16, u16, u16)
CODECS = [
    (broadcast.encode_command, broadcast.decode_command, robots),
    (packed_reply, broadcast.decode_reply, robot_replies),
]
for_each_codec = pytest.mark.parametrize(("encode", "decode", "messages"), CODECS)


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


CUTS = st.lists(st.integers(0, 100), max_size=10)


def test_the_documented_bytes_are_those_sent():
    page = (ROOT / "docs" / "reference" / "wires.md").read_text()
    words = " ".join(page.split())
    frame = broadcast.encode_command(ROBOTS)
    assert frame.hex(" ").upper() in words
    assert len(frame) == 14


@for_each_codec
@given(data=st.data())
def test_messages_round_trip_and_every_bit_error_is_detected(encode, decode, messages, data):
    check_round_trip(encode, decode, data.draw(messages))


@for_each_codec
@given(raw=ANY_BYTES)
def test_any_bytes_are_a_message_or_refused(encode, decode, messages, raw):
    check_any_bytes(encode, decode, raw)


@pytest.mark.parametrize(
    ("encode", "message"),
    [
        (broadcast.encode_command, BroadcastCommand(256, Flag(0))),
        (broadcast.encode_command, BroadcastCommand(-1, Flag(0))),
        (broadcast.encode_command, BroadcastCommand(0, Flag.RUN, ((-128, 0),))),
        (broadcast.encode_command, BroadcastCommand(0, Flag.RUN, ((0, 128),))),
        (broadcast.encode_command, BroadcastCommand(0, Flag.RUN, ((0, 0),) * (ROBOTS_MAX + 1))),
        (packed_reply, Reply(256, 0, Status(0), 0, 0, 0)),
        (packed_reply, Reply(0, 0, Status(0), 70_000, 0, 0)),
        (cobs.encode_with_crc, bytes(cobs.PAYLOAD_BYTES_MAX)),
    ],
)
def test_what_does_not_fit_is_not_encoded(encode, message):
    with pytest.raises(WireError):
        encode(message)


@pytest.mark.parametrize(
    ("decode", "payload"),
    [
        (broadcast.decode_command, "51 00 08 00"),  # an unknown flag
        (broadcast.decode_command, "51 00 00 01 00"),  # too short for one robot
        (broadcast.decode_command, "51 00 00 00 00"),
        (broadcast.decode_command, "51 00 01 01 80 00"),  # -128
        (broadcast.decode_command, "52 00 00 00"),
        (broadcast.decode_command, "51 00"),
        (broadcast.decode_reply, "51 01 04 00"),
    ],
)
def test_bad_messages_with_a_good_crc_are_refused(decode, payload):
    with pytest.raises(WireError):
        decode(cobs.encode_with_crc(bytes.fromhex(payload))[:-1])


@given(sent=st.lists(robot_replies, max_size=6), cuts=CUTS, garbage=st.binary())
def test_replies_are_cut_out_of_any_stream(sent, cuts, garbage):
    """Garbage ends with a zero, as frames do, and so may give a frame before those sent."""
    head = garbage.replace(b"\0", b"") + b"\0"
    stream = head + b"".join(map(packed_reply, sent))
    places = [cut % len(stream) for cut in cuts]
    edges = sorted({0, len(stream), *places})
    splitter = cobs.FrameSplitter()
    frames = []
    for start, stop in itertools.pairwise(edges):
        frames += splitter.feed(stream[start:stop])
    of_those_sent = frames[len(frames) - len(sent) :]
    assert [broadcast.decode_reply(frame) for frame in of_those_sent] == sent


def test_headings_are_predicted_over_a_tenth_of_a_second_at_most():
    """From a frame's exposure until the wheels have a command, 7 ms after it is sent."""
    experiment = parse_spec(SPEC, "lab.yaml").experiment

    def counts(age_ms):
        clock = VirtualClock()
        clock.sleep_until(SECOND)
        actuator = M3piActuator(experiment.lab.actuator, experiment.setup, clock)
        poses = [Pose(500, 500, 0.5)] * 2
        wished = actuator.compute_wheel_speeds(Steer(2.0), poses, SECOND - age_ms * 1_000_000)
        return actuator.outputs(wished, np.ones(2, bool)).tolist()

    assert counts(0) != counts(93) == counts(500)


def test_a_frame_that_is_too_long_is_dropped_though_it_comes_in_pieces():
    splitter = cobs.FrameSplitter()
    assert [splitter.feed(b"\1" * 50) for _ in range(3)] == [[]] * 3
    assert splitter.feed(b"\0\2\1\0") == [b"\2\1"]


@given(st.binary(max_size=cobs.PAYLOAD_BYTES_MAX))
def test_stuffing_round_trips(payload):
    frame = cobs.encode(payload)
    assert frame.index(0) == len(frame) - 1
    assert len(frame) == len(payload) + 2
    assert cobs.decode(frame[:-1]) == payload
