"""Tests of the emulated XBee module over a real pseudo-terminal, with pyserial and our frames."""

import os

import pytest
import serial
from testkit.emulator.lab_processes import emulated, turn_until
from tetractl_emulator.m3pi.emulated_radio import encode_at_response
from tetractl_emulator.port import PseudoPort

from tetractl.core.clock import SECOND
from tetractl.core.errors import UsageError
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.actuators.xbee.api_frames import AT_COMMAND, BROADCAST, Decoder, encode
from tetractl.lab.cobs import Flag


@pytest.fixture
def opened(tmp_path):
    """Return a function that opens an emulated lab and its port."""
    open_now = []

    def start(*sets, script="", baud=57600, **options):
        lab = emulated(tmp_path, *sets, script=script, **options)
        lab.__enter__()
        open_now.append(lab)
        port = serial.Serial(
            str(lab.actuator.serial_devices[0].port.link),
            baud,
            timeout=0,
            write_timeout=5,
            exclusive=True,
        )
        open_now.append(port)
        return lab, port

    yield start
    for thing in reversed(open_now):
        thing.close()


def ask(lab, port, content):
    """Send a frame; return the one that comes."""
    decoder = Decoder()
    got = []
    port.write(encode(content))

    def enough():
        got.extend(decoder.feed(port.read(4096)))
        return bool(got)

    turn_until(lab, enough)
    assert decoder.dropped_bytes == 0
    return got


def test_at_commands(opened):
    lab, port = opened()
    for command, value in (
        (b"HV", b"\x17\x44"),
        (b"VR", b"\x10\xec"),
        (b"BD", b"\0\0\0\x06"),
        (b"AP", b"\x02"),
        (b"QQ", None),
    ):
        answer = encode_at_response(0x11, command, value)
        assert ask(lab, port, bytes((AT_COMMAND, 0x11)) + command) == [answer]


def test_a_broadcast_takes_its_time_on_the_wires(opened):
    lab, port = opened()
    command = encode_command(BroadcastCommand(1, Flag.RUN, ((60, 60),) * 2))
    frame = encode(BROADCAST + command)
    sent_ns, heard_ns = [], []
    lab.actuator.radio.note = lambda *_, **facts: sent_ns.append(lab.timeline.now_ns)
    for robot in lab.actuator.robots:

        def heard(data, receive=robot.receive):
            heard_ns.append(lab.timeline.now_ns)
            receive(data)

        robot.receive = heard
    port.write(frame)
    turn_until(lab, lambda: len(heard_ns) == 2)
    way_ns = heard_ns[0] - sent_ns[0]
    serial_bits = 10 * (len(frame) + 12)  # 12 bytes leave the robot's module
    serial_ns = serial_bits * SECOND // 57600
    assert serial_ns + 500_000 < way_ns < serial_ns + 2_000_000  # and some time in the air
    turn_until(lab, lambda: lab.actuator.robots[0].wheels[0] > 100)
    assert lab.actuator.robots[1].counts() == (60, 60)


def test_a_name_that_an_emulation_uses_is_refused(tmp_path):
    first = PseudoPort(tmp_path / "radio")
    second = PseudoPort(tmp_path / "radio")
    first.plug()
    try:
        with pytest.raises(UsageError, match="exists already"):
            second.plug()
    finally:
        first.unplug()


def test_a_name_left_by_a_killed_emulation_is_taken_over_if_its_number_is_used_again(tmp_path):
    """Regression: the new port had the number of the killed one, and the link to it "exists"."""
    link = tmp_path / "radio"
    first = PseudoPort(link)
    first.plug()
    target = link.readlink()
    link.unlink()
    first.unplug()
    link.symlink_to(target)  # as SIGKILL leaves it
    os.utime(link, (0, 0), follow_symlinks=False)
    again = PseudoPort(link)
    again.plug()
    assert link.exists()
    again.unplug()
    assert not link.is_symlink()
