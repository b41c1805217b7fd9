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
    first = port_to(name)
    second = port_to(name)
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
        ("udp://a..b:9", None),
        (f"udp://{'a' * 64}:9", None),
        (f"udp://robot:{'9' * 5000}", None),
        ("/dev/ttyUSB0", None),
    ],
)
def test_names(name, address):
    assert address_of(name) == address


def test_a_port_is_chosen_by_its_name():
    settings = 57600, "the radio", MonotonicClock(), lambda data, now: None, ""
    assert isinstance(open_port("udp://robot:1", *settings), UdpPort)
    assert type(open_port("/dev/ttyUSB0", *settings)) is SerialPort


def test_who_has_another_address_is_not_heard(robot):
    """Regression: any sender's reply to a poll was accepted."""
    heard = Queue()
    port = port_to(f"udp://127.0.0.1:{robot.getsockname()[1]}", lambda data, now: heard.put(data))
    port.open()
    try:
        port.write(b"?")
        _, sender = robot.recvfrom(100)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.1", 0))
            stranger.sendto(b"forged", sender)
        robot.sendto(b"own", sender)
        assert heard.get(timeout=PATIENCE_S) == b"own"
        assert heard.empty()
    finally:
        port.close()


def test_a_device_that_is_not_there_yet_does_not_end_the_port(robot):
    """The refusal of one datagram is reported with a later one."""
    address = robot.getsockname()
    robot.close()
    port = port_to(f"udp://127.0.0.1:{address[1]}")
    port.open()
    try:
        for _ in range(20):
            port.write(b"?")
        assert port.failure is None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
            again.settimeout(PATIENCE_S)
            again.bind(address)
            port.write(b"now")
            assert again.recv(100) == b"now"
    finally:
        port.close()


def test_all_devices_are_heard_at_a_broadcast_address():
    heard = Queue()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.settimeout(PATIENCE_S)
        robot.bind(("", 0))
        name = f"udp://127.255.255.255:{robot.getsockname()[1]}"
        port = port_to(name, lambda data, now: heard.put(data))
        port.open()
        try:
            port.write(b"?")
            data, sender = robot.recvfrom(100)
            assert data == b"?"
            robot.sendto(b"reply", ("127.0.0.1", sender[1]))
            assert heard.get(timeout=PATIENCE_S) == b"reply"
        finally:
            port.close()


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    """Regression: in the shared temporary folder, another user chose which file was opened."""
    name = "udp://127.0.0.1:9758"
    victim = tmp_path / "victim"
    lock = lock_file(name)
    lock.symlink_to(victim)
    port = port_to(name)
    try:
        with pytest.raises(AbortError, match=r"tetractl-udp.*: is a link"):
            port.open()
        assert not victim.exists()
    finally:
        port.close()
        lock.unlink()


def test_a_pipe_in_the_place_of_the_lock_is_refused_at_once():
    name = "udp://127.0.0.1:9757"
    lock = lock_file(name)
    os.mkfifo(lock)
    port = port_to(name)
    try:
        with pytest.raises(AbortError, match="is not a regular file"):
            port.open()
    finally:
        port.close()
        lock.unlink()
