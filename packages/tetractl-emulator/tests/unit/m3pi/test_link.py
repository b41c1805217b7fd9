"""Tests of the link to an XBee module that the test plays, over connections in memory."""

import pytest
from testkit.device_replies import packed_reply
from testkit.emulator.heard_port import HeardPort
from tetractl_emulator.m3pi.emulated_radio import encode_at_response
from tetractl_emulator.memory_wires import MemoryNetwork
from tetractl_emulator.virtual_lab import LabClock

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.m3pi.broadcast import Broadcaster, decode_command, stop_in_range
from tetractl.lab.actuators.wheel_commands import Reply, Status
from tetractl.lab.actuators.xbee.api_frames import (
    AT_COMMAND,
    BROADCAST,
    Decoder,
    encode,
)
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.actuators.xbee.link import XbeeLink
from tetractl.lab.cobs import Flag, FrameSplitter

SERIES_1 = {b"HV": b"\x17\x44", b"VR": b"\x10\xed", b"BD": b"\x00\x00\x00\x06", b"AP": b"\x02"}


class Module:
    """Stands for an XBee module at the other end of a port in memory: answers AT commands, keeps
    what is to be sent."""

    def __init__(self, answers=SERIES_1, respond=lambda frame: []):
        self.name = "radio"
        self.clock = LabClock()
        self.network = MemoryNetwork()
        self.port = HeardPort(self.network, self.name, self._hear)
        self.port.plug()
        self.answers = answers
        self.respond = respond
        self.decoder = Decoder()
        self.sent = []
        self.loses = lambda content: False  # whether a question to the module is lost

    def opened(self, **radio):
        link = XbeeLink(XbeeSection(port=self.name, **radio), self.clock, self._ports)
        link.open()
        return link

    def _ports(self, *args):
        """Make the port of the link, whose baud rate a test may read."""
        self.port_of_link = self.network.serial(*args)
        return self.port_of_link

    def _hear(self):
        for content in self.decoder.feed(self.port.read()):
            command = content[2:4]
            if self.loses(content):
                continue
            if content[0] != AT_COMMAND:
                self.sent.append(content)
                for answer in self.respond(content):
                    self.say(answer)
            elif command in self.answers:
                self.say(encode_at_response(content[1], command, self.answers[command]))

    def say(self, content):
        self.port.write(encode(content))


def test_a_good_module_is_opened_and_sends():
    radio = Module(respond=lambda content: [b"\x81\x12\x34\x28\0hello"])
    link = radio.opened()
    link.send(b"data")
    link.wait(10)
    assert link.fetch() == [b"hello"]
    assert radio.sent == [BROADCAST + b"data"]


@pytest.mark.parametrize(
    ("answers", "radio", "says"),
    [
        ({b"VR": b"\x80\x6b"}, {}, "the module runs DigiMesh firmware"),
        ({b"HV": b"\x19\x44", b"VR": b"\x21\xa7"}, {}, "the module runs Zigbee firmware"),
        ({b"HV": b"\x22\x44", b"VR": b"\x40\x60"}, {}, "the module runs Zigbee firmware"),
        ({b"BD": b"\x03"}, {}, "the module is set to 9600 baud, but the spec says 57600"),
        ({b"AP": b"\x01"}, {}, "the XBee module is not in API mode with escapes"),
        ({b"BD": b"\x07"}, {"baud": 115200}, "loses API frames at 115200"),
    ],
)
def test_a_module_that_would_not_do_is_refused(answers, radio, says):
    with pytest.raises(AbortError, match=says) as caught:
        Module(SERIES_1 | answers).opened(**radio)
    assert caught.value.hint


def test_an_answer_that_is_lost_once_is_asked_for_again():
    module = Module(SERIES_1)
    heard = []

    def lose_the_first(content):
        heard.append(content[2:4])
        return heard.count(b"AP") == 1 and content[2:4] == b"AP"

    module.loses = lose_the_first
    module.opened()
    assert heard.count(b"AP") == 2


def test_a_port_without_a_module_is_told():
    with pytest.raises(
        AbortError, match="no XBee module answers at 57600 baud or any other baud rate"
    ):
        Module({}).opened()


def test_a_broadcast_puts_every_robot_at_its_number():
    radio = Module()
    link = radio.opened()
    Broadcaster(link, radio.clock, [2, 0]).drive([(10, -20), (30, 40)])
    (frame,) = FrameSplitter().feed(radio.sent[0].removeprefix(BROADCAST))
    assert decode_command(frame).wheels == ((30, 40), (0, 0), (10, -20))


def test_a_poll_ends_once_the_port_is_gone():
    """Regression: a module unplugged while robots were asked was asked for ever."""
    radio = Module(respond=lambda content: radio.port.unplug() or [])
    link = radio.opened()
    assert Broadcaster(link, radio.clock, (0, 1)).poll(1.0) == [None, None]
    assert link.failure is not None


def test_a_reply_to_another_command_is_not_believed():
    """Regression: any reply that came counted, such as that of a robot switched off since."""

    def forge(content):
        sequence = decode_command(content[len(BROADCAST) : -1]).sequence
        stale = Reply(0, (sequence + 7) % 256, Status.RUNNING, 9999, 1, 0)
        right = Reply(1, sequence, Status.RUNNING, 4800, 1, 0)
        return [b"\x81\x12\x34\x28\0" + packed_reply(reply) for reply in (stale, right)]

    radio = Module(respond=forge)
    first, second = Broadcaster(radio.opened(), radio.clock, (0, 1)).poll(1.0)
    assert first is None
    assert second.battery_mv == 4800


@pytest.fixture
def stop_robots(monkeypatch):
    """Return what `lab stop` does at a module's port: what it says, or its error."""

    def stop(module, alone=True):
        monkeypatch.setattr("tetractl.lab.actuators.xbee.link.SerialPort", module.network.serial)
        return stop_in_range(XbeeSection(port=module.name), module.clock, alone)

    return stop


def emergency_stops(module):
    """Return how many of the frames that the module has to send stop robots for good."""
    commands = [decode_command(content[len(BROADCAST) : -1]) for content in module.sent]
    return sum(command.flags == Flag.EMERGENCY_STOP for command in commands)


def test_lab_stop_sends_ten_stops_through_a_module_that_answers(stop_robots):
    module = Module()
    assert stop_robots(module).startswith(
        "sent 10 stops on radio; to drive the robots again, switch"
    )
    assert emergency_stops(module) == 10


def test_lab_stop_says_that_no_module_answers_after_the_stops(stop_robots):
    """Regression: at a wrong baud rate, where a module hears garbage, it said `sent 10 stops` and
    that the robots have to be switched off and on to drive again, though none had heard a stop."""
    module = Module(answers={})
    with pytest.raises(AbortError, match="but no XBee module answers at 57600 baud") as raised:
        stop_robots(module)
    assert "baud rate" in raised.value.hint
    assert "switch the robots off by hand" in raised.value.hint
    assert emergency_stops(module) == 10


def test_a_module_that_falls_silent_is_not_said_to_have_another_mode():
    """Regression: a module that began again between two questions was "not in API mode"."""
    answers = {command: value for command, value in SERIES_1.items() if command != b"AP"}
    with pytest.raises(AbortError, match="the radio's module does not answer any more"):
        Module(answers).opened()


class Sleepy(Module):
    """Stands for a module that wakes once it has received some requests, and then answers all."""

    def __init__(self, wakes_after):
        super().__init__()
        self.wakes_after = wakes_after
        self.unanswered = []

    def say(self, frame):
        self.unanswered.append(frame)
        if len(self.unanswered) >= self.wakes_after:
            for answer in self.unanswered:
                super().say(answer)
            self.unanswered.clear()
            self.wakes_after = 0


@pytest.mark.parametrize("wakes_after", range(1, 7))
def test_a_late_answer_is_not_one_at_the_next_baud_rate(wakes_after):
    """Regression: "the module answers at 38400 baud, not the spec's 57600"."""
    radio = Sleepy(wakes_after)
    link = radio.opened()
    assert radio.port_of_link.bits_a_second == 57600
    assert link.request(b"AP") == b"\x02"


def test_robots_are_asked_again_if_the_computer_slept_meanwhile():
    """Regression: of a robot whose first reply was lost it was said that it does not answer."""
    polls = []

    def sleep(content):
        polls.append(content)
        radio.clock.sleep_until(radio.clock.now() + 3 * SECOND)
        return []

    radio = Module(respond=sleep)
    assert Broadcaster(radio.opened(), radio.clock, (0, 1)).poll(1.0) == [None, None]
    assert len(polls) == 5
