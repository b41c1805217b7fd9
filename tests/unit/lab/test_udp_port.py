"""A UDP port, with real sockets of this computer."""

import os
import socket
from queue import Queue

import pytest

from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import PortHeldError, SerialPort, holder
from tetractl.lab.udp_port import UdpPort, address_of, lock_file, open_port

PATIENCE_S = 60


@pytest.fixture
def robot():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.settimeout(PATIENCE_S)
        robot.bind(("127.0.0.1", 0))
        yield robot


def port_to(name, heard=lambda data, now: None):
    return UdpPort(name, 57600, "the radio", MonotonicClock(), heard, "hint")


def test_datagrams_go_and_come(robot):
    heard = Queue()
    port = port_to(f"udp://127.0.0.1:{robot.getsockname()[1]}", lambda data, now: heard.put(data))
    port.open()
    try:
        assert port.write(b"T 1 0*0000\n") > 0
        data, sender = robot.recvfrom(100)
        assert data == b"T 1 0*0000\n"
        robot.sendto(b"S 0\n", sender)
        assert heard.get(timeout=PATIENCE_S) == b"S 0\n"
        assert port.failure is None
    finally:
        port.close()
        port.close()
    with pytest.raises(AbortError, match="is not open"):
        port.write(b"x")


def test_a_second_program_is_refused_and_the_first_is_found(robot):
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    first, second = port_to(name), port_to(name)
    first.open()
    try:
        with pytest.raises(PortHeldError) as held:
            second.open()
        assert holder(held.value.port) == os.getpid()
        beside = port_to(name)
        beside.open(alone=False)
        beside.close()
    finally:
        first.close()
        second.close()
        lock_file(name).unlink()


def test_an_unknown_host_is_one_line():
    port = port_to("udp://no.such.host.invalid:9750")
    try:
        with pytest.raises(AbortError, match=r"no\.such\.host\.invalid"):
            port.open()
    finally:
        port.close()
        lock_file("udp://no.such.host.invalid:9750").unlink()


@pytest.mark.parametrize(
    ("name", "address"),
    [
        ("udp://192.168.4.255:9750", ("192.168.4.255", 9750)),
        ("udp://robot:1", ("robot", 1)),
        ("udp://robot", None),
        ("udp://:9750", None),
        ("udp://robot:0", None),
        ("udp://robot:65536", None),
        ("udp://robot:\u00b2", None),
        ("/dev/ttyUSB0", None),
    ],
)
def test_names(name, address):
    assert address_of(name) == address


def test_a_port_is_chosen_by_its_name():
    given = 57600, "the radio", MonotonicClock(), lambda data, now: None, ""
    assert isinstance(open_port("udp://robot:1", *given), UdpPort)
    assert type(open_port("/dev/ttyUSB0", *given)) is SerialPort
