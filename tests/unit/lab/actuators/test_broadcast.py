"""Tests of the frame with the commands of all m3pi robots, and of their replies."""

import struct

import pytest
from testkit.device_replies import packed_reply

from tetractl.core.clock import VirtualClock
from tetractl.core.errors import AbortError, WireError
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi import broadcast
from tetractl.lab.actuators.m3pi.broadcast import (
    COMMAND,
    REPLY_SLOT_MS,
    ROBOTS_MAX,
    BroadcastCommand,
    Broadcaster,
    decode_command,
    decode_reply,
    encode_command,
    stop_in_range,
)
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import COUNT_MAX
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS


class Link:
    """Stands for the radio: keeps commands, and answers each with what a test wants."""

    failure = None

    def __init__(self, replies=lambda command: b""):
        self.replies = replies
        self.commands = []
        self.fresh = []
        self.waits_s = []

    def send(self, data):
        assert data[-1] == 0
        self.commands.append(decode_command(data[:-1]))
        self.fresh.append(self.replies(self.commands[-1]))
        return 1000 + len(self.commands)

    def fetch(self):
        fresh = self.fresh
        self.fresh = []
        return fresh

    def wait(self, timeout_s):
        self.waits_s.append(timeout_s)


def broadcaster(indices=(0, 1, 2), link=None, clock=None):
    link = link or Link()
    return link, Broadcaster(link, clock or VirtualClock(), indices)


@pytest.mark.parametrize("indices", [(0, 1, 2), (2, 0, 1), (5, 0, 9)])
def test_each_robots_counts_are_at_its_number_and_the_others_stop(indices):
    link, robots = broadcaster(indices)
    counts = [(1, -2), (30, 40), (-127, 127)]
    assert robots.drive(counts) == 1001
    (command,) = link.commands
    assert command.flags == Flag.RUN
    assert len(command.wheels) == max(indices) + 1
    for i, wheels in enumerate(command.wheels):
        assert wheels == (counts[indices.index(i)] if i in indices else (0, 0))


def test_sequence_numbers_count_and_begin_anew_after_255():
    link, robots = broadcaster()
    for _ in range(600):
        robots.send(Flag(0))
    numbers = [command.sequence for command in link.commands]
    assert numbers == [(1 + k) % 256 for k in range(600)]
    clock = VirtualClock()
    clock.sleep_until(1000)
    link, robots = broadcaster(clock=clock)
    robots.send(Flag(0))
    assert link.commands[0].sequence == 1001 % 256


def test_a_command_without_counts_stops_every_robot():
    link, robots = broadcaster()
    robots.send(Flag.EMERGENCY_STOP)
    assert link.commands == [BroadcastCommand(1, Flag.EMERGENCY_STOP)]


@pytest.mark.parametrize(
    "command",
    [
        BroadcastCommand(0, Flag(0)),
        BroadcastCommand(255, Flag.RUN, ((COUNT_MAX, -COUNT_MAX),) * ROBOTS_MAX),
        BroadcastCommand(7, Flag.RUN | Flag.POLL, ((1, 2), (3, -4))),
    ],
)
def test_a_command_up_to_the_limits_comes_back(command):
    assert decode_command(encode_command(command)[:-1]) == command


@pytest.mark.parametrize(
    "command",
    [
        BroadcastCommand(-1, Flag(0)),
        BroadcastCommand(256, Flag(0)),
        BroadcastCommand(1, Flag.RUN, ((0, 0),) * (ROBOTS_MAX + 1)),
        BroadcastCommand(1, Flag.RUN, ((COUNT_MAX + 1, 0),)),
        BroadcastCommand(1, Flag.RUN, ((0, -COUNT_MAX - 1),)),
        BroadcastCommand(1, Flag.RUN, ((0, 0, 0),)),
        BroadcastCommand(1, Flag.RUN, ((0,), (0,))),
        BroadcastCommand(1, 8),
    ],
)
def test_a_command_beyond_the_limits_is_refused(command):
    with pytest.raises(WireError):
        encode_command(command)


@pytest.mark.parametrize(
    "payload",
    [
        bytes([COMMAND, 1, 1]),  # too short
        bytes([COMMAND + 1, 1, 1, 0]),
        bytes([COMMAND, 1, 1, 1, 5]),  # half a robot
        bytes([COMMAND, 1, 1, 1, 5, 5, 5]),
        bytes([COMMAND, 1, 1, ROBOTS_MAX + 1]) + bytes(2 * ROBOTS_MAX + 2),
        bytes([COMMAND, 1, 1, 1]) + struct.pack("2b", 0, -128),
        bytes([COMMAND, 1, 1, 1]) + struct.pack("2b", -128, 0),
    ],
)
def test_a_payload_that_is_no_command_is_refused(payload):
    with pytest.raises(WireError):
        decode_command(cobs.encode_with_crc(payload)[:-1])


def test_a_command_for_no_robot_is_one():
    payload = bytes([COMMAND, 3, 4, 0])
    assert decode_command(cobs.encode_with_crc(payload)[:-1]) == BroadcastCommand(3, Flag.POLL)


def test_a_reply_has_its_numbers_in_order_and_unknown_bits_of_its_status_are_left_out():
    reply = Reply(4, 200, Status.RUNNING, 4821, 65535, 12)
    assert decode_reply(packed_reply(reply)[:-1]) == reply
    raw = struct.pack("<BBBBHHH", 0x52, 4, 200, 0xF9, 4821, 65535, 12)
    assert decode_reply(cobs.encode_with_crc(raw)[:-1]).status == Status(1)


def reply_of(index, sequence):
    return Reply(index, sequence, Status.RUNNING, 4800, 1, 0)


def test_robots_are_asked_with_a_poll_and_what_came_before_is_dropped():
    link, robots = broadcaster()
    half = packed_reply(reply_of(1, 1))
    link.fresh = [half]
    sequence, sent_ns = robots.send_poll()
    assert (sequence, sent_ns) == (1, 1001)
    assert link.commands[-1].flags == Flag.POLL
    assert list(robots.receive_replies(0.25)) == []
    assert link.waits_s == [0.25]


def test_replies_are_heard_across_pieces_and_garbage():
    link, robots = broadcaster()
    first, second = packed_reply(reply_of(0, 1)), packed_reply(reply_of(1, 1))
    robots.send_poll()
    link.fresh = [b"noise\0" + first[:3], first[3:], second[:5]]
    assert list(robots.receive_replies(0.1)) == [reply_of(0, 1)]
    link.fresh = [second[5:]]
    assert list(robots.receive_replies(0.1)) == [reply_of(1, 1)]
    link.fresh = [second[:5]]
    assert list(robots.receive_replies(0.1)) == []
    robots.send_poll()
    link.fresh = [second[5:]]
    assert list(robots.receive_replies(0.1)) == [], "half a reply to the poll before"


def test_a_poll_returns_the_replies_in_the_order_of_the_setup():
    def answer(command):
        return b"".join(packed_reply(reply_of(i, command.sequence)) for i in (0, 1, 3))

    _, robots = broadcaster((3, 2, 0), Link(answer))
    clock = robots._clock
    link = robots._link
    link.wait = lambda timeout_s: clock.sleep_until(clock.now() + round(timeout_s * 10**9))
    replies = robots.poll(1.0)
    assert [reply and reply.id for reply in replies] == [3, None, 0]
    # a frame for three robots at most, so each poll waits for the slot after the last robot's
    assert clock.now() % (5 * REPLY_SLOT_MS * 10**6 + 10**8) < 10**7


def test_a_failed_link_is_reported():
    link, robots = broadcaster()
    assert robots.failure is None
    link.failure = "gone"
    assert robots.failure == "gone"


class Module:
    """Stands for the link to a radio module, which answers or not."""

    def __init__(self, answers, failing=False):
        self.answers = answers
        self.failing = failing
        self.commands = []
        self.calls = []

    def __call__(self, module, clock):
        return self

    def open(self, checked, exclusive):
        self.calls.append(("open", checked, exclusive))
        if self.failing:
            raise AbortError("no port")

    def send(self, data):
        self.commands.append(decode_command(data[:-1]))
        return 0

    def request_twice(self, command):
        self.calls.append(command)
        return b"\x02" if self.answers else None

    def close(self):
        self.calls.append("close")


SECTION = XbeeSection(port="radio", baud=57600)


@pytest.mark.parametrize(("alone", "answers"), [(True, True), (False, False), (False, True)])
def test_all_robots_in_range_latch_ten_stops(monkeypatch, alone, answers):
    module = Module(answers)
    monkeypatch.setattr(broadcast, "XbeeLink", module)
    clock = VirtualClock()
    said = stop_in_range(SECTION, clock, alone)
    assert said.startswith("sent 10 stops on radio")
    assert [command.flags for command in module.commands] == [Flag.EMERGENCY_STOP] * STOP_COUNT
    assert clock.now() == STOP_COUNT * STOP_GAP_NS
    assert module.calls == [("open", False, alone), *([b"AP"] if alone else []), "close"]


def test_a_module_that_does_not_answer_after_the_stops_is_named(monkeypatch):
    module = Module(answers=False)
    monkeypatch.setattr(broadcast, "XbeeLink", module)
    with pytest.raises(AbortError, match="no XBee module answers at 57600 baud"):
        stop_in_range(SECTION, VirtualClock(), alone=True)
    assert len(module.commands) == STOP_COUNT
    assert module.calls[-1] == "close"


def test_a_port_that_cannot_be_opened_is_closed_all_the_same(monkeypatch):
    module = Module(answers=True, failing=True)
    monkeypatch.setattr(broadcast, "XbeeLink", module)
    with pytest.raises(AbortError, match="no port"):
        stop_in_range(SECTION, VirtualClock())
    assert module.calls[-1] == "close"
