"""The emulated XBee over a real pseudo-terminal, spoken to with pyserial and our frames."""

import pytest
import serial
from support.emulated_lab import emulated, turn_until

from tetractl.core.errors import UsageError
from tetractl.lab.actuators.m3pi.broadcast import (
    BroadcastCommand,
    Flag,
    Reply,
    Status,
    decode_reply,
    encode_command,
)
from tetractl.lab.actuators.m3pi.slave import encode_wheels
from tetractl.lab.actuators.xbee.frames import (
    AtCommand,
    AtResponse,
    Receive16,
    Transmit16,
    TransmitStatus,
)
from tetractl.lab.actuators.xbee.framing import Decoder, encode

POLL = encode_command(BroadcastCommand(9, Flag.POLL))


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


def test_zigbee_firmware_says_so(opened):
    lab, port = opened(script="emulation: {actuator: {firmware: zigbee}}")
    (hardware,) = ask(lab, port, AtCommand(1, b"HV"))
    (firmware,) = ask(lab, port, AtCommand(1, b"VR"))
    assert (hardware.data, firmware.data) == (b"\x19\x44", b"\x21\xa7")


def test_every_robot_answers_a_poll_in_its_slot(opened):
    lab, port = opened(script="emulation: {actuator: {robots: [{name: blue, battery_mv: 4444}]}}")
    status, *replies = ask(lab, port, Transmit16(5, 0xFFFF, 0, POLL), 3)
    assert status == TransmitStatus(5, 0)
    assert [(reply.source, type(reply)) for reply in replies] == [(1, Receive16), (2, Receive16)]
    # the poll was the first frame heard: not running, not silent any more
    assert [decode_reply(reply.data[:-1]) for reply in replies] == [
        Reply(0, 9, Status(0), 5100, 1, 0),
        Reply(1, 9, Status(0), 4444, 1, 0),
    ]


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
    turn_until(lab, lambda: lab.actuator.robots[0].left > 100)
    assert lab.actuator.robots[1].counts() == (60, 60)


def test_transparent_mode(opened):
    lab, port = opened("lab.actuator.mode=transparent")
    got = bytearray()

    def said(text):
        def check():
            got.extend(port.read(4096))
            return text in got

        return check

    port.write(POLL)
    turn_until(lab, lambda: said(b"\0")() and got.count(0) == 2)
    assert [decode_reply(part).id for part in bytes(got).split(b"\0")[:2]] == [0, 1]


def test_slaves_hear_only_their_own_unicasts(opened):
    slave = "lab.actuator.protocol={type: slave, accept_no_watchdog: true}"
    lab, port = opened(slave)
    ask(lab, port, Transmit16(1, 2, 0, encode_wheels(40, -40)))
    turn_until(lab, lambda: lab.actuator.robots[1].counts() == (40, -40))
    assert lab.actuator.robots[0].counts() == (0, 0)
    battery = ask(lab, port, Transmit16(0, 1, 0, b"\xb1"))
    assert battery == [Receive16(1, 40, 0, (5100).to_bytes(2, "little"))]


def test_at_another_speed_the_module_hears_nothing(opened):
    lab, port = opened(baud=9600)
    port.write(encode(AtCommand(1, b"HV")))
    turn_until(lab, lambda: lab.actuator.radio.garbled)
    assert port.read(100) == b""
    port.baudrate = 57600
    assert ask(lab, port, AtCommand(1, b"HV"))[0].status == 0


def test_a_port_that_is_taken_away_raises_and_comes_back(opened):
    lab, port = opened()
    lab.actuator.plugged(False)
    assert not lab.actuator.port.link.is_symlink()
    with pytest.raises(serial.SerialException):
        port.write(b"x")
    lab.actuator.plugged(True)
    again = serial.Serial(str(lab.actuator.port.link), 57600, timeout=0, write_timeout=0.02)
    try:
        assert ask(lab, again, AtCommand(1, b"HV"))[0].status == 0
    finally:
        again.close()


def test_a_stuck_port_times_out_and_recovers(opened):
    lab, port = opened()
    lab.actuator.port.stall(True)
    with pytest.raises(serial.SerialTimeoutException):
        port.write(b"x")
    lab.actuator.port.stall(False)
    assert ask(lab, port, AtCommand(1, b"HV"))[0].status == 0


def test_a_name_that_is_taken_is_refused_and_left(tmp_path):
    (tmp_path / "radio").write_text("something of somebody")
    with pytest.raises(UsageError, match="is there already"), emulated(tmp_path):
        pass
    assert (tmp_path / "radio").read_text() == "something of somebody"


def test_a_name_left_by_a_killed_emulation_is_taken_over(tmp_path):
    (tmp_path / "radio").symlink_to("/dev/pts/no-such-one")
    with emulated(tmp_path) as lab:
        assert lab.actuator.port.link.exists()
    assert not (tmp_path / "radio").is_symlink()
