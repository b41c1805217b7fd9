"""Tests of serial ports and of groups of ports, with pseudo-terminals and with ports in memory."""

import errno
import os
import tty
from queue import Empty, Queue

import pytest

from tetractl.core.clock import MILLISECOND, MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab import serial_port
from tetractl.lab.serial_port import (
    PortGroup,
    PortHeldError,
    SerialPort,
    is_network,
    missing_port_error,
    require_port,
)

PATIENCE_S = 60


@pytest.fixture
def heard():
    return Queue()


@pytest.fixture
def ends():
    """The two ends of a cable: the device's descriptor, and the name of this computer's port."""
    device, port = os.openpty()
    tty.setraw(port)
    yield device, os.ttyname(port)
    for end in (device, port):
        try:
            os.close(end)
        except OSError as error:
            assert error.errno == errno.EBADF, "a test has closed it"


def port_at(name, heard):
    def hear(data, now_ns):
        heard.put(data)

    return SerialPort(name, 57600, "the radio", MonotonicClock(), hear, "a hint")


@pytest.fixture
def port(ends, heard):
    made = port_at(ends[1], heard)
    made.open()
    yield made
    made.close()


def read_all(device, size):
    data = b""
    while len(data) < size:
        data += os.read(device, size)
    return data


def test_bytes_go_both_ways(ends, port, heard):
    device, _ = ends
    before_ns = port._clock.now()
    assert before_ns <= port.write(b"\x00\x7e\nhello") <= port._clock.now()
    assert read_all(device, 8) == b"\x00\x7e\nhello"
    os.write(device, b"answer")
    data = b""
    while data != b"answer":
        data += heard.get(timeout=PATIENCE_S)
    assert port.failure is None


def test_a_port_that_another_program_has_is_refused_unless_it_may_be_shared(ends, port, heard):
    second = port_at(ends[1], heard)
    with pytest.raises(PortHeldError, match="another program has this port open") as caught:
        second.open()
    assert caught.value.port == ends[1]
    shared = port_at(ends[1], heard)
    shared.open(exclusive=False)
    shared.close()


def test_a_device_that_disappears_is_told_to_the_reader_and_the_writer(ends, port, heard):
    device, name = ends
    os.close(device)
    assert heard.get(timeout=PATIENCE_S) == b""
    assert port.failure.startswith(f"the port {name} of the radio is gone")
    with pytest.raises(AbortError, match="is gone") as caught:
        port.write(b"x")
    assert caught.value.hint == "a hint"


def test_a_device_that_takes_nothing_is_stuck_and_the_first_failure_is_kept(ends, port):
    with pytest.raises(AbortError, match="stuck"):
        for _ in range(100):
            port.write(b"x" * 1000)
    failure = port.failure
    with pytest.raises(AbortError) as caught:
        port.write(b"x")
    assert caught.value.message == port.failure == failure


def test_a_closed_port_tells_nobody_and_may_be_closed_again(ends, heard):
    port = port_at(ends[1], heard)
    port.close()
    port.open()
    assert port._closing.is_set()
    port.close()
    port.close()
    with pytest.raises(Empty):
        heard.get_nowait()
    assert port.failure is None
    with pytest.raises(AbortError, match="is not open"):
        port.write(b"x")


def test_a_port_has_its_speed_when_it_is_opened_and_when_it_is_changed(ends, port):
    assert port._port.baudrate == 57600
    port.set_baud(9600)
    assert port._port.baudrate == 9600
    port.close()
    port.set_baud(19200)  # without a port, it does nothing


def test_what_is_no_port_is_refused_with_its_reason(heard, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    reasons = {
        str(tmp_path / "none"): "there is no such port",
        str(file): "this is not a serial port",
        str(tmp_path): "this is not a serial port",
        "/dev/null": "this is not a serial port",
    }
    for name, reason in reasons.items():
        with pytest.raises(AbortError) as caught:
            port_at(name, heard).open()
        assert caught.value.message == f"{name}: {reason}"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.EAGAIN, "busy"), "another program has this port open"),
        (OSError("Could not exclusively lock port"), "another program has this port open"),
        (OSError(errno.ENOENT, "gone"), "there is no such port"),
        (OSError(errno.EACCES, "denied"), "you have no permission to open this port"),
        (OSError(errno.EIO, "a broken cable"), "cannot be opened: a broken cable"),
        (ValueError("a strange speed"), "cannot be opened: a strange speed"),
        (ValueError(), "cannot be opened: ValueError"),
    ],
)
def test_the_reason_why_a_port_cannot_be_opened_is_the_systems(error, message, ends):
    why = serial_port._explain_failed_open(ends[1], "the radio", error)
    assert why.message == f"{ends[1]}: {message}"


def test_a_port_that_must_exist_does_or_is_named(ends):
    require_port(ends[1], "the radio")
    with pytest.raises(AbortError, match="none: there is no such port") as caught:
        require_port("/dev/none", "the radio")
    assert caught.value.hint == missing_port_error("/dev/none", "the radio").hint
    assert caught.value.hint == "is the radio plugged in?"


def test_a_name_with_a_scheme_is_on_the_network():
    names = {"udp://10.0.0.7:9800": True, "/dev/ttyUSB0": False, "COM3": False}
    assert {name: is_network(name) for name in names} == names


class Memory:
    """Stands for a port in memory."""

    def __init__(self, failure=None):
        self.failure = failure
        self.written = []
        self.calls = []

    def open(self):
        self.calls.append("open")

    def settle(self):
        self.calls.append("settle")

    def close(self):
        self.calls.append("close")

    def write(self, data):
        self.written.append(data)
        if self.failure:
            raise AbortError(self.failure)
        return len(data)


def test_a_group_sends_each_port_its_message_and_returns_the_last_time():
    ports = [Memory(), Memory()]
    group = PortGroup(iter(ports))
    assert group.send([b"a", b"bcd"]) == 3
    assert [port.written for port in ports] == [[b"a"], [b"bcd"]]
    with pytest.raises(ValueError, match="argument"):
        group.send([b"a"])


def test_a_group_sends_to_the_others_if_one_port_fails_and_reports_the_first_failure():
    ports = [Memory(), Memory("second"), Memory("third"), Memory()]
    group = PortGroup(ports)
    with pytest.raises(AbortError, match="second"):
        group.send([b"x"] * 4)
    assert [port.written for port in ports] == [[b"x"]] * 4
    assert group.failure == "second"
    assert PortGroup([Memory(), Memory()]).failure is None


def test_a_group_opens_all_ports_before_it_waits_for_any():
    shared = []
    ports = [Memory(), Memory()]
    for port in ports:
        port.calls = shared
    group = PortGroup(ports)
    group.open()
    group.close()
    assert shared == ["open", "open", "settle", "settle", "close", "close"]


def test_settling_waits_until_the_port_is_ready_and_a_serial_port_is_at_once(ends, heard):
    clock = VirtualClock()

    class Slow(SerialPort):
        def is_ready(self):
            return clock.now() >= 9 * MILLISECOND

    for kind, ready_ms in [(SerialPort, 0), (Slow, 10)]:
        kind(ends[1], 57600, "the radio", clock, lambda *_: None, "").settle()
        assert clock.now() == ready_ms * MILLISECOND
