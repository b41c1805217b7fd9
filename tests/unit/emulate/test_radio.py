"""The emulated XBee over a real pseudo-terminal, spoken to with pyserial and our frames."""

import pytest
import serial
from support.lab_processes import emulated, turn_until

from tetractl.core.errors import UsageError
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, Flag, encode_command
from tetractl.lab.actuators.xbee.frames import (
    AtCommand,
    AtResponse,
    Decoder,
    Transmit16,
    TransmitStatus,
    encode,
)


@pytest.fixture
def opened(tmp_path):
    """Return a function that opens an emulated lab and its port."""
    open_now = []

    def start(*sets, script="", baud=57600, **options):
        lab = emulated(tmp_path, *sets, script=script, **options)
        lab.__enter__()
        open_now.append(lab)
        port = serial.Serial(
            str(lab.actuator.port.link), baud, timeout=0, write_timeout=0.02, exclusive=True
        )
        open_now.append(port)
        return lab, port

    yield start
    for thing in reversed(open_now):
        thing.close()


def ask(lab, port, frame, count=1, escaped=True):
    """Send a frame; return the next `count` that come."""
    decoder, got = Decoder(escaped), []
    port.write(encode(frame, escaped))

    def enough():
        got.extend(decoder.feed(port.read(4096)))
        return len(got) >= count

    turn_until(lab, enough)
    assert decoder.dropped_bytes == 0
    return got


@pytest.mark.parametrize(("mode", "escaped"), [("api2", True), ("api1", False)])
def test_at_commands(opened, mode, escaped):
    lab, port = opened(f"lab.actuator.mode={mode}")
    for command, value in (
        (b"HV", b"\x17\x44"),
        (b"VR", b"\x10\xec"),
        (b"BD", b"\0\0\0\x06"),
        (b"AP", b"\x02" if escaped else b"\x01"),
    ):
        answer = ask(lab, port, AtCommand(0x11, command), escaped=escaped)
        assert answer == [AtResponse(0x11, command, 0, value)]
    assert ask(lab, port, AtCommand(2, b"QQ"), escaped=escaped) == [AtResponse(2, b"QQ", 2)]


def test_unicasts_are_acknowledged_and_broadcasts_never_fail(opened):
    lab, port = opened(script="faults: [{fault: off, robot: blue, since: start}]")
    assert ask(lab, port, Transmit16(1, 1, 0, b"x")) == [TransmitStatus(1, 0)]
    assert ask(lab, port, Transmit16(2, 2, 0, b"x")) == [TransmitStatus(2, 1)]
    assert ask(lab, port, Transmit16(3, 99, 0, b"x")) == [TransmitStatus(3, 1)]
    lab.actuator.radio.loss = 1.0
    assert ask(lab, port, Transmit16(6, 0xFFFF, 0, b"x")) == [TransmitStatus(6, 0)]
    assert ask(lab, port, Transmit16(7, 1, 0, b"x")) == [TransmitStatus(7, 1)]


def test_a_broadcast_takes_its_time_on_the_wires(opened, tmp_path):
    lab, port = opened()
    frame = encode(
        Transmit16(0, 0xFFFF, 0, encode_command(BroadcastCommand(1, Flag.RUN, ((60, 60),) * 2)))
    )
    heard = []
    lab.actuator.radio._on_heard = lambda robot, data: heard.append(lab.timeline.now_ns)
    read = []
    tell = lab.actuator.radio._on_wire
    lab.actuator.radio._on_wire = lambda data: (read.append(lab.timeline.now_ns), tell(data))
    port.write(frame)
    turn_until(lab, lambda: len(heard) == 2)
    took = heard[0] - read[0]
    serial_ns = (len(frame) + 12) * 10 * 10**9 // 57600  # 12 bytes leave the robot's module
    assert serial_ns + 500_000 < took < serial_ns + 2_000_000
    turn_until(lab, lambda: lab.actuator.robots[0].wheels[0] > 100)
    assert lab.actuator.robots[1].counts() == (60, 60)


def test_a_name_that_is_taken_is_refused_and_left(tmp_path):
    (tmp_path / "radio").write_text("something of somebody")
    with pytest.raises(UsageError, match="exists already"), emulated(tmp_path):
        pass
    assert (tmp_path / "radio").read_text() == "something of somebody"


def test_a_name_left_by_a_killed_emulation_is_taken_over(tmp_path):
    (tmp_path / "radio").symlink_to("/dev/pts/no-such-one")
    with emulated(tmp_path) as lab:
        assert lab.actuator.port.link.exists()
    assert not (tmp_path / "radio").is_symlink()
