"""Tests of the robots' C firmware against the Python codec, byte by byte."""

import contextlib
import random

import pytest
from testkit.device_replies import packed_reply
from tetractl_emulator import firmware
from tetractl_emulator.firmware import CoreEvent, RobotCore

from tetractl.core.errors import TetractlError, WireError
from tetractl.lab.actuators.m3pi.broadcast import (
    REPLY_SLOT_MS,
    ROBOTS_MAX,
    BroadcastCommand,
    decode_command,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.cobs import Flag, encode, encode_with_crc

pytestmark = pytest.mark.slow

needs_compiler = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return firmware.load("m3pi", tmp_path_factory.mktemp("firmware"))


def run(sequence, *wheels, flags=Flag.RUN):
    return encode_command(BroadcastCommand(sequence, flags, wheels))


def switched_on(index, library):
    """A robot that was switched on long ago."""
    core = RobotCore(index, library)
    core.wheels(10_000)
    return core


@needs_compiler
def test_every_robot_obeys_its_own_wheels(library):
    rng = random.Random(1)
    for robots in range(ROBOTS_MAX + 1):
        wheels = [(rng.randint(-127, 127), rng.randint(-127, 127)) for _ in range(robots)]
        for index in {0, max(0, robots - 1), robots, 255}:
            core = switched_on(index, library)
            assert core.push(run(robots, *wheels), 0) == [CoreEvent.ACCEPTED]
            assert core.wheels(0) == (wheels[index] if index < robots else (0, 0))


@pytest.mark.long
@needs_compiler
def test_core_and_codec_agree_on_what_a_frame_is(library):
    rng = random.Random(2)
    core = switched_on(0, library)
    counts_of_event = dict.fromkeys(CoreEvent, 0)
    for _ in range(30_000):
        frame = damaged(rng)
        expected = None
        with contextlib.suppress(WireError):
            expected = decode_command(frame)
        before = core.wheels(0)
        events = core.push(frame + b"\0", 0)
        for event in events:
            counts_of_event[event] += 1
        if expected is None:
            assert events in ([], [CoreEvent.REJECTED], [CoreEvent.FOREIGN])
            assert core.wheels(0) == before
        else:
            assert events in ([CoreEvent.ACCEPTED], [CoreEvent.STALE])
            runs = expected.flags & (Flag.RUN | Flag.EMERGENCY_STOP) == Flag.RUN
            if not runs:
                assert core.wheels(0) == (0, 0)
            elif events == [CoreEvent.ACCEPTED]:
                assert core.wheels(0) == (expected.wheels or ((0, 0),))[0]
            else:
                assert core.wheels(0) == before
            if Flag.EMERGENCY_STOP in expected.flags or rng.random() < 0.05:
                core = switched_on(0, library)
    counted = set(counts_of_event) - {CoreEvent.NOTHING}
    assert min(counts_of_event[event] for event in counted) > 200


def random_command(rng):
    """A valid command to up to three robots."""
    robots = rng.randrange(4)

    def random_wheels():
        return rng.randint(-127, 127), rng.choice([0, 5])

    wheels = tuple(random_wheels() for _ in range(robots))
    flags = rng.choice([Flag.RUN, Flag.RUN, Flag.RUN | Flag.POLL, Flag(0), Flag.EMERGENCY_STOP])
    return BroadcastCommand(rng.randrange(256), flags, wheels)


def random_content(rng):
    """What looks like a command: a type, a sequence, flags, a number of robots, and some bytes."""
    message_type = rng.choice([0x51, 0x51, 0x52])
    head = bytes([message_type, 0, rng.randrange(16), rng.randrange(4)])
    return head + rng.randbytes(rng.randrange(8))


def damaged(rng):
    """Return a frame without its 00: good, damaged, or well sealed but wrong inside."""
    good = encode_command(random_command(rng))
    frame = bytearray(good.removesuffix(b"\0"))
    match rng.randrange(6):
        case 0:
            bit = 1 << rng.randrange(8)
            frame[rng.randrange(len(frame))] ^= bit
        case 1:
            del frame[rng.randrange(len(frame)) :]
        case 2:
            start = rng.randrange(len(frame) + 1)
            frame[start:] = rng.randbytes(rng.randint(1, 90))
        case 3:
            frame = bytearray(encode_with_crc(random_content(rng))[:-1])
        case 4:
            noise = rng.randbytes(rng.randrange(254))
            frame = bytearray(encode(noise)[:-1])
    return bytes(frame.replace(b"\0", b"\x01"))


@needs_compiler
def test_polled_robots_answer_once_each_in_its_slot(library):
    cores = [switched_on(index, library) for index in range(3)]
    poll = run(0, flags=Flag.POLL)
    for index, core in enumerate(cores):
        core.set_battery(4900 + index)
        assert core.push(b"\x05rubbish\0" + poll, 10) == [CoreEvent.REJECTED, CoreEvent.ACCEPTED]
    answers = {}
    for now in range(10, 100):
        for index, core in enumerate(cores):
            reply = core.take_reply(now)
            if reply:
                answers[now] = (index, reply)
    assert [now - 10 for now in answers] == [0, REPLY_SLOT_MS, 2 * REPLY_SLOT_MS]
    for index, raw in answers.values():
        reply = decode_reply(raw[:-1])
        assert reply == Reply(index, 0, Status(0), 4900 + index, 1, 1)
        assert packed_reply(reply) == raw
        assert cores[0].push(raw, 200) == [CoreEvent.FOREIGN]
    assert cores[0].take_reply(200) == b""


@needs_compiler
def test_a_source_that_does_not_compile_is_one_clear_line(tmp_path, monkeypatch):
    for name in ("m3pi_core.c", "m3pi_core.h", "framing.c", "framing.h"):
        (tmp_path / name).write_text("this is not C\n")
    monkeypatch.setattr(firmware, "source_folder", lambda: tmp_path)
    with pytest.raises(TetractlError, match=r"could not compile .* firmware: .*error") as got:
        firmware.load("m3pi", tmp_path / "out")
    assert "\n" not in got.value.message
    assert list((tmp_path / "out").iterdir()) == []
