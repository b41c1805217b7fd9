"""The radio's port on a real pseudo-terminal, with a module at its other end played by the test."""

import os
import pty
import threading
import tty

import pytest

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.lab.actuators.m3pi.broadcast import Reply, Status, decode_command, encode_reply
from tetractl.lab.actuators.m3pi.protocols import BroadcastProtocol, SlaveProtocol
from tetractl.lab.actuators.xbee.frames import (
    AtCommand,
    AtResponse,
    Other,
    Receive16,
    Transmit16,
    TransmitStatus,
)
from tetractl.lab.actuators.xbee.framing import Decoder, encode
from tetractl.lab.actuators.xbee.hardware import BAUDS, FAMILIES, protocol
from tetractl.lab.actuators.xbee.link import Link
from tetractl.lab.actuators.xbee.section import XbeeSection
from tetractl.lab.cobs import Splitter

SERIES_1 = {b"HV": b"\x17\x44", b"VR": b"\x10\xed", b"BD": b"\x00\x00\x00\x06", b"AP": b"\x02"}


class Module:
    """The other end of a pseudo-terminal: answers AT commands, keeps what is to be sent."""

    def __init__(self, answers=SERIES_1, respond=lambda frame: []):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.name = os.ttyname(self.slave)
        self.answers, self.respond = answers, respond
        self.decoder = Decoder()
        self.sent = []
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self):
        while True:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            if not data or b"end of the test" in data:
                return
            for frame in self.decoder.feed(data):
                if isinstance(frame, AtCommand):
                    if frame.command in self.answers:
                        value = self.answers[frame.command]
                        self.say(AtResponse(frame.frame_id, frame.command, 0, value))
                else:
                    self.sent.append(frame)
                    for answer in self.respond(frame):
                        self.say(answer)

    def say(self, frame):
        os.write(self.master, encode(frame))

    def close(self):
        os.write(self.slave, b"end of the test")
        self.thread.join(10)
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def module():
    made = []

    def make(*args, **kwargs):
        made.append(Module(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


def opened(module, **radio):
    link = Link(XbeeSection(port=module.name, **radio), MonotonicClock())
    try:
        link.open()
    except AbortError:
        link.close()
        raise
    return link


def test_a_good_module_is_opened_and_sends(module):
    radio = module(respond=lambda frame: [Receive16(0x1234, 40, 0, b"hello")])
    link = opened(radio)
    try:
        link.send(b"data")
        link.wait(10)
        (received,) = link.fetch()
        assert (received.source, received.data) == (0x1234, b"hello")
        assert radio.sent == [Transmit16(0, 0xFFFF, 0, b"data")]
    finally:
        link.close()


def test_a_unicast_that_nobody_acknowledged_is_counted(module):
    done = threading.Event()

    def lose(frame):
        done.set()
        return [TransmitStatus(frame.frame_id, 1), Receive16(1, 0, 0, b"x")]

    link = opened(module(respond=lose))
    try:
        link.send(b"data", address=7)
        link.wait(10)
        assert link.undelivered == 1
    finally:
        link.close()


@pytest.mark.parametrize(
    ("answers", "radio", "says"),
    [
        ({b"VR": b"\x80\x6b"}, {}, "the module runs DigiMesh firmware"),
        ({b"HV": b"\x19\x44", b"VR": b"\x21\xa7"}, {}, "the module runs Zigbee firmware"),
        ({b"HV": b"\x22\x44", b"VR": b"\x40\x60"}, {}, "the module runs Zigbee firmware"),
        ({b"HV": b"\x23\x44", b"VR": b"\x20\x03"}, {}, "the module runs 900 MHz firmware"),
        ({b"BD": b"\x03"}, {}, "the module says 9600 baud, the spec 57600"),
        ({b"AP": b"\x01"}, {}, "the module is in api1, the spec says api2"),
        ({b"BD": b"\x07"}, {"baud": 115200}, "loses API frames at 115200"),
    ],
)
def test_a_module_that_would_not_do_is_refused(module, answers, radio, says):
    with pytest.raises(AbortError, match=says) as caught:
        opened(module(SERIES_1 | answers), **radio)
    assert caught.value.hint


@pytest.mark.slow
def test_a_port_without_a_module_is_told(module):
    with pytest.raises(AbortError, match="no XBee module answers at 57600 baud or another"):
        opened(module({}))


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


@pytest.mark.parametrize(("hardware", "version"), [(b"\x7f\x44", b"\x20\x03"), (b"\x22\x44", b"")])
def test_a_module_that_is_not_known_is_asked_about_and_used(module, hardware, version):
    """Regression: it was refused."""
    radio = module(SERIES_1 | {b"HV": hardware, b"VR": version})
    link = opened(radio)
    try:
        told = version.hex() or "not told"
        assert link.questions == (
            f"{radio.name}: the module (HV {hardware.hex().upper()}, VR {told}) is not known here: "
            "does it run 802.15.4 firmware?",
        )
    finally:
        link.close()


def test_frames_of_type_0x91_are_reported(module):
    """Regression: they were passed over, and every robot was said not to answer."""
    said = bytes(10) + bytes.fromhex("E8E80011C10501") + b"hello"
    radio = module(respond=lambda frame: [Other(0x91, said), Receive16(1, 40, 0, b"x")])
    link = opened(radio)
    try:
        assert link.problems() == ()
        link.send(b"data")
        link.wait(10)
        (problem,) = link.problems()
        assert problem == (
            f"{radio.name}: the module reports what it hears in frames of type 0x91, which are "
            "not read: set AO in it to 0 or 2"
        )
    finally:
        link.close()


def test_the_rates_are_the_modules_own():
    assert BAUDS[3] == 9600
    assert BAUDS[6] == 57600


def test_a_second_program_cannot_open_the_port(module):
    radio = module()
    link = opened(radio)
    try:
        with pytest.raises(AbortError, match="another program has this port open"):
            opened(radio)
    finally:
        link.close()


def test_there_must_be_a_port(tmp_path):
    with pytest.raises(AbortError, match="there is no such port"):
        Link(XbeeSection(port=str(tmp_path / "none")), MonotonicClock()).open()


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


def test_a_radio_that_is_unplugged_raises():
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = Link(XbeeSection(port=os.ttyname(slave), mode="transparent"), MonotonicClock())
    try:
        link.open()
        os.close(slave)
        os.close(master)
        with pytest.raises(AbortError, match="is gone"):
            for _ in range(1000):
                link.send(b"x")
    finally:
        link.close()


def robot(index, battery_mv=4900):
    """Answer polls as robot `index`, through a module."""
    splitter = Splitter()

    def respond(frame):
        return [
            Receive16(
                index + 1,
                0,
                0,
                encode_reply(Reply(index, command.sequence, Status(0), battery_mv, 3, 0)),
            )
            for command in map(decode_command, splitter.feed(frame.data))
            if command.flags & 4
        ]

    return respond


@pytest.mark.slow
def test_robots_that_answer_a_poll_are_told_from_those_that_do_not(module):
    link = opened(module(respond=robot(2)))
    try:
        found = BroadcastProtocol(link, MonotonicClock(), [2, 5]).poll(0.3)
        assert found[0].battery_mv == 4900
        assert found[1] is None
    finally:
        link.close()


def test_a_broadcast_puts_every_robot_at_its_number(module):
    seen = threading.Event()
    radio = module(respond=lambda frame: seen.set() or [])
    link = opened(radio)
    try:
        BroadcastProtocol(link, MonotonicClock(), [2, 0]).drive([(10, -20), (30, 40)])
        assert seen.wait(10)
        (frame,) = Splitter().feed(radio.sent[0].data)
        assert decode_command(frame).wheels == ((30, 40), (0, 0), (10, -20))
    finally:
        link.close()


@pytest.mark.slow
def test_slaves_are_spoken_to_one_by_one(module):
    def battery(frame):
        known = frame.destination == 5 and frame.data == b"\xb1"
        return [Receive16(5, 0, 0, b"\x88\x13")] if known else []

    radio = module(respond=battery)
    link = opened(radio)
    try:
        voice = SlaveProtocol(link, MonotonicClock(), [5, 6])
        answers = voice.poll(0.3)
        assert answers[0].battery_mv == 5000
        assert answers[1] is None
        radio.sent.clear()
        voice.drive([(10, -20), (0, 0)])
        voice.poll(0.01)
        assert [(f.destination, f.data) for f in radio.sent[:2]] == [
            (5, b"\xc1\x0a\xc6\x14"),
            (6, b"\xc1\x00\xc5\x00"),
        ]
    finally:
        link.close()
