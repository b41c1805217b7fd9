"""Tests of ports of robots that take lines of text: who gets which line, whose reply counts."""

import pytest
from testkit.device_replies import reply_line

from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.twist.line_ports import PENDING_MAX, TwistLink
from tetractl.lab.actuators.twist.lines import LineCommand, decode_command
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.cobs import Flag


class Port:
    """Stands for a port: keeps the commands that are written to it."""

    def __init__(self, heard):
        self.heard = heard
        self.commands = []
        self.failure = None

    def open(self, alone=True):
        pass

    def settle(self):
        pass

    def write(self, data):
        if self.failure:
            raise AbortError(self.failure)
        assert data.endswith(b"\n")
        self.commands.append(decode_command(data[:-1]))
        return 1000 + len(self.commands)


def linked(robots=({}, {}, {}), now_ns=0, **fields):
    """A link to robots with these fields; return it with its ports and its clock."""
    names = ["green", "blue", "red"][: len(robots)]
    entries = [{"name": name, **robot} for name, robot in zip(names, robots, strict=True)]
    section = {"type": "twist", "port": "air", "robots": entries, **fields}
    ports = {}

    def make(name, baud, device, clock, heard, hint):
        ports[name] = Port(heard)
        return ports[name]

    clock = VirtualClock()
    clock.sleep_until(now_ns)
    return TwistLink(TwistSection.model_validate(section), names, clock, make), ports, clock


PAIRS = [(100, 10), (200, -20), (300, 30)]


@pytest.mark.parametrize(("sends", "kind"), [("twist", "T"), ("wheels", "W")])
def test_one_port_gets_one_line_for_all_its_robots(sends, kind):
    link, ports, _ = linked(sends=sends)
    assert link.drive(PAIRS) == 1001
    entries = tuple((i, *pair) for i, pair in enumerate(PAIRS))
    assert ports["air"].commands == [LineCommand(kind, 1, Flag.RUN, entries)]


def test_each_port_gets_a_line_for_its_own_robots():
    link, ports, _ = linked([{"port": "a", "index": 7}, {}, {"port": "a", "index": 2}])
    link.drive(PAIRS)
    assert list(ports) == ["a", "air"]
    assert ports["a"].commands[0].entries == ((7, 100, 10), (2, 300, 30))
    assert ports["air"].commands[0].entries == ((1, 200, -20),)
    assert ports["a"].commands[0].sequence == ports["air"].commands[0].sequence


@pytest.mark.parametrize(("emergency", "flags"), [(True, Flag.EMERGENCY_STOP), (False, Flag(0))])
def test_a_stop_names_no_robot_and_reaches_every_port_even_if_one_fails(emergency, flags):
    link, ports, _ = linked([{"port": "a"}, {"port": "b"}, {"port": "c"}])
    link.stop(emergency)
    for port in ports.values():
        assert port.commands == [LineCommand("T", 1, flags)]
    ports["a"].failure = "gone"
    with pytest.raises(AbortError, match="gone"):
        link.stop(emergency)
    assert len(ports["b"].commands) == len(ports["c"].commands) == 2
    assert link.failure == "gone"


def test_sequence_numbers_count_and_begin_anew_after_255():
    link, ports, _ = linked(now_ns=1000)
    for _ in range(600):
        link.stop()
    assert [command.sequence for command in ports["air"].commands] == [
        (1001 + k) % 256 for k in range(600)
    ]


def reply_of(index, sequence=1, battery_mv=4800):
    return Reply(index, sequence, Status.RUNNING, battery_mv, 1, 0)


def test_replies_of_a_ports_own_robots_are_heard_once_and_others_are_not():
    link, ports, _ = linked([{"port": "a"}, {"port": "b"}, {"port": "a"}])
    ports["a"].heard(reply_line(reply_of(0)) + reply_line(reply_of(1)) + b"noise\n", 0)
    ports["a"].heard(reply_line(reply_of(2)), 0)
    assert list(link.receive_replies(1.0)) == [reply_of(0), reply_of(2)]
    ports["b"].heard(reply_line(reply_of(1)), 0)
    assert list(link.receive_replies(1.0)) == [reply_of(1)]


def test_a_line_is_put_together_from_its_pieces_at_each_port():
    link, ports, clock = linked([{"port": "a"}, {"port": "b"}])
    first, second = reply_line(reply_of(0)), reply_line(reply_of(1))
    for a, b in zip(first, second, strict=True):
        ports["a"].heard(bytes([a]), 0)
        ports["b"].heard(bytes([b]), 0)
    assert list(link.receive_replies(1.0)) == [reply_of(0), reply_of(1)]
    assert clock.now() == 0, "nobody waits for what is there"


def test_a_line_that_never_ends_is_not_kept_whole():
    link, ports, _ = linked()
    ports["air"].heard(b"x" * 50 * PENDING_MAX, 0)
    assert len(link._unfinished_lines["air"]) == PENDING_MAX
    ports["air"].heard(b"\n" + reply_line(reply_of(0)), 0)
    assert list(link.receive_replies(1.0)) == [reply_of(0)]


def test_hearing_waits_until_a_reply_or_a_failure_or_the_time_is_over():
    link, ports, clock = linked()
    assert list(link.receive_replies(0.5)) == []
    assert clock.now() == pytest.approx(0.5 * SECOND, rel=0.02)
    before_ns = clock.now()
    ports["air"].failure = "gone"
    assert list(link.receive_replies(0.5)) == []
    assert clock.now() == before_ns


def test_a_poll_drops_what_came_before_and_names_its_number():
    link, ports, _ = linked()
    ports["air"].heard(reply_line(reply_of(0)), 0)
    assert link.send_poll() == (1, 1001)
    assert ports["air"].commands == [LineCommand("T", 1, Flag.POLL)]
    assert list(link.receive_replies(0.1)) == []


def test_the_replies_to_a_poll_are_in_the_order_of_the_setup():
    link, ports, _ = linked([{"index": 9}, {"index": 4}, {"index": 6}])
    write = ports["air"].write

    def answering(data):
        for index in (4, 9):
            ports["air"].heard(reply_line(reply_of(index, decode_command(data[:-1]).sequence)), 0)
        return write(data)

    ports["air"].write = answering
    assert [reply and reply.id for reply in link.poll(1.0)] == [9, 4, None]
