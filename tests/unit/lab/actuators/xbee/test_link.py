"""The link to a module played by the test in memory, and the port on a real pseudo-terminal."""

import os
import pty
import tty

import pytest

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.emulate.virtual_wires import LabClock, memory_wires
from tetractl.lab.actuators.m3pi.broadcast import decode_command
from tetractl.lab.actuators.m3pi.serial_protocols import BroadcastProtocol
from tetractl.lab.actuators.xbee.frames import (
    AtCommand,
    AtResponse,
    Decoder,
    Receive16,
    Transmit16,
    TransmitStatus,
    encode,
)
from tetractl.lab.actuators.xbee.hardware import FAMILIES, XbeeSection, protocol
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.cobs import Splitter

SERIES_1 = {b"HV": b"\x17\x44", b"VR": b"\x10\xed", b"BD": b"\x00\x00\x00\x06", b"AP": b"\x02"}


class Module:
    """The other end of a port in memory: answers AT commands, keeps what is to be sent."""

    def __init__(self, answers=SERIES_1, respond=lambda frame: []):
        self.name, self.clock = "radio", LabClock()
        self.wires = memory_wires(self.clock)
        self.port = self.wires.port(self.name)
        self.port.plug()
        self.port.written = self._hear
        self.answers, self.respond = answers, respond
        self.decoder = Decoder()
        self.sent = []

    def opened(self, **radio):
        link = Link(XbeeSection(port=self.name, **radio), self.clock, self.wires.ports)
        link.open()
        return link

    def _hear(self):
        for frame in self.decoder.feed(self.port.read()):
            if not isinstance(frame, AtCommand):
                self.sent.append(frame)
                for answer in self.respond(frame):
                    self.say(answer)
            elif frame.command in self.answers:
                value = self.answers[frame.command]
                self.say(AtResponse(frame.frame_id, frame.command, 0, value))

    def say(self, frame):
        self.port.write(encode(frame))


def test_a_good_module_is_opened_and_sends():
    radio = Module(respond=lambda frame: [Receive16(0x1234, 40, 0, b"hello")])
    link = radio.opened()
    link.send(b"data")
    link.wait(10)
    (received,) = link.fetch()
    assert (received.source, received.data) == (0x1234, b"hello")
    assert radio.sent == [Transmit16(0, 0xFFFF, 0, b"data")]


def test_a_unicast_that_nobody_acknowledged_is_counted():
    def lose(frame):
        return [TransmitStatus(frame.frame_id, 1), Receive16(1, 0, 0, b"x")]

    radio = Module(respond=lose)
    link = radio.opened()
    link.send(b"data", address=7)
    link.wait(10)
    assert link.undelivered == 1
    assert radio.sent[0].frame_id, "it asks for a status"


@pytest.mark.parametrize(
    ("answers", "radio", "says"),
    [
        ({b"VR": b"\x80\x6b"}, {}, "the module runs DigiMesh firmware"),
        ({b"HV": b"\x19\x44", b"VR": b"\x21\xa7"}, {}, "the module runs Zigbee firmware"),
        ({b"HV": b"\x22\x44", b"VR": b"\x40\x60"}, {}, "the module runs Zigbee firmware"),
        ({b"HV": b"\x23\x44", b"VR": b"\x20\x03"}, {}, "the module runs 900 MHz firmware"),
        ({b"BD": b"\x03"}, {}, "the module is set to 9600 baud, not the spec's 57600"),
        ({b"AP": b"\x01"}, {}, "the module is in api1, not the spec's api2"),
        ({b"BD": b"\x07"}, {"baud": 115200}, "loses API frames at 115200"),
    ],
)
def test_a_module_that_would_not_do_is_refused(answers, radio, says):
    with pytest.raises(AbortError, match=says) as caught:
        Module(SERIES_1 | answers).opened(**radio)
    assert caught.value.hint


def test_a_port_without_a_module_is_told():
    with pytest.raises(AbortError, match="no XBee module answers at 57600 or any other baud rate"):
        Module({}).opened()


class Sleepy(Module):
    """A module that wakes once it has received some requests, and then answers all of them."""

    def __init__(self, wakes_after):
        super().__init__()
        self.wakes_after, self.held = wakes_after, []

    def say(self, frame):
        self.held.append(frame)
        if len(self.held) >= self.wakes_after:
            for one in self.held:
                super().say(one)
            self.held.clear()
            self.wakes_after = 0


@pytest.mark.parametrize("wakes_after", range(1, 7))
def test_a_late_answer_is_not_one_at_the_next_baud_rate(wakes_after):
    """Regression: "the module answers at 38400 baud, not the spec's 57600"."""
    radio = Sleepy(wakes_after)
    link = radio.opened()
    assert link._port.bits_a_second == 57600
    assert link.ask(b"AP") == b"\x02"


def test_an_answer_to_another_question_is_dropped():
    radio = Module()
    link = radio.opened()
    radio.port.written = lambda: radio.say(AtResponse(link._frame_id, b"BD", 0, b"\x07"))
    assert link.ask(b"AP") is None


@pytest.mark.parametrize(
    ("hardware", "version", "runs"),
    [
        (b"\x17\x44", b"\x10\xed", "802.15.4"),
        (b"\x18\x44", b"\x10\xec", "802.15.4"),
        (b"\x22\x44", b"\x20\x03", "802.15.4"),
        (b"\x41\x45", b"\x20\x0d", "802.15.4"),
        (b"\x41\x45", b"\x10\x12", "Zigbee"),
        (b"\x1a\x44", b"\x20\xa7", "Zigbee"),
        (b"\x22\x44", b"\x90\x00", "DigiMesh"),
        (b"\x30\x44", b"\x20\x03", "802.15.4"),  # S2C PRO SMT
        (b"\x52\x44", b"\x20\x14", "802.15.4"),  # XBee RR
        (b"\x57\x44", b"\x20\x14", "802.15.4"),  # XBee RR TH
        (b"\x57\x44", b"\x30\x14", "DigiMesh"),
        (b"\x53\x44", b"\xc0\x01", "802.15.4"),  # S2C P5
        (b"\x53\x44", b"\xb0\x01", "DigiMesh"),
        (b"\x53\x44", b"\x20\x01", "Zigbee"),
        (b"\x23\x44", b"\x20\x03", "900 MHz"),
        (b"\x32\x44", b"\x20\x03", "Zigbee"),  # S2D
        (b"\x19\x44", b"", "Zigbee"),
        (b"\x22\x44", b"", None),
        (b"\xff\x00", b"\x10\x00", None),
        (b"", b"", None),
    ],
)
def test_a_protocol_is_told_by_hardware_and_version(hardware, version, runs):
    assert protocol(hardware, version) == runs


def test_no_hardware_is_of_two_families():
    codes = [code for family in FAMILIES for code in family.codes]
    assert len(codes) == len(set(codes))


def test_a_radio_that_takes_nothing_is_stuck_and_stays_so():
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = Link(XbeeSection(port=os.ttyname(slave), mode="transparent"), MonotonicClock())
    try:
        link.open()
        with pytest.raises(AbortError, match="the radio is stuck"):
            for _ in range(10_000):
                link.send(bytes(64))
        with pytest.raises(AbortError, match="the radio is stuck"):
            link.send(b"x")
        assert "stuck" in link.failure
    finally:
        link.close()
        os.close(master)
        os.close(slave)


def test_a_broadcast_puts_every_robot_at_its_number():
    radio = Module()
    link = radio.opened()
    BroadcastProtocol(link, link._clock, [2, 0]).drive([(10, -20), (30, 40)])
    (frame,) = Splitter().feed(radio.sent[0].data)
    assert decode_command(frame).wheels == ((30, 40), (0, 0), (10, -20))
