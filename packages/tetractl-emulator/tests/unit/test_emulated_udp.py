"""Tests of an emulated device at a UDP port of this computer, with plain sockets as programs."""

import socket

import pytest
from tetractl_emulator.emulated_udp import UdpPlug, make_port
from tetractl_emulator.port import PseudoPort

from tetractl.core.errors import TetractlError


@pytest.fixture
def program():
    """A socket that waits at most 5 s for what is sent to it on this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.settimeout(5.0)
        opened.bind(("127.0.0.1", 0))
        yield opened


@pytest.fixture
def device():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    made = UdpPlug(f"udp://192.168.4.1:{number}")
    made.plug()
    yield made
    made.unplug()


def tell(program, device, data):
    with socket.fromfd(device.fd, socket.AF_INET, socket.SOCK_DGRAM) as same:
        program.sendto(data, same.getsockname())


def test_a_device_reads_a_datagram_at_a_time_and_answers_its_sender(program, device):
    assert device.read() == b""
    tell(program, device, b"0.1 0.2\n")
    tell(program, device, b"0 0\n")
    assert [device.read() for _ in range(3)] == [b"0.1 0.2\n", b"0 0\n", b""]
    device.write(b"ok")
    assert program.recv(100) == b"ok"


def test_a_stalled_device_drops_what_comes_until_it_takes_it_again(program, device):
    device.set_stalled(True)
    tell(program, device, b"lost")
    assert device.read() == b""
    device.set_stalled(False)
    tell(program, device, b"heard")
    assert device.read() == b"heard"


def test_a_device_without_a_program_writes_to_nobody(device):
    device.write(b"ok")  # raises nothing
    assert device.baud() is None


def test_a_device_that_nobody_asks_sends_to_the_port_of_its_name(program):
    device = UdpPlug(f"udp://:{program.getsockname()[1]}")
    device.write(b"lost")  # it is not plugged in yet
    device.plug()
    try:
        device.write(b"pose")
        assert program.recv(100) == b"pose"
    finally:
        device.unplug()


def test_an_unplugged_device_reads_and_sends_nothing(program, device):
    tell(program, device, b"waits")
    device.unplug()
    device.unplug()
    assert device.fd == -1
    assert device.read() == b""
    device.write(b"ok")


def test_a_port_in_use_is_refused_with_its_number(program):
    taken = program.getsockname()[1]
    device = UdpPlug(f"udp://localhost:{taken}")
    with pytest.raises(TetractlError, match=f"cannot open UDP port {taken} on 127.0.0.1") as error:
        device.plug()
    assert "another emulation" in error.value.hint
    assert device.fd == -1


@pytest.mark.parametrize("name", ["udp://", "udp://host", "udp://host:port", "udp://:"])
def test_an_address_without_a_port_is_refused(name):
    with pytest.raises(TetractlError, match="must be udp://HOST:PORT"):
        UdpPlug(name)


def test_a_name_that_is_no_address_is_a_pseudo_terminal(tmp_path):
    assert isinstance(make_port("udp://host:9750"), UdpPlug)
    assert isinstance(make_port("udp://:9750"), UdpPlug)
    assert type(make_port(tmp_path / "radio")) is PseudoPort
    assert type(make_port("/dev/ttyUSB0")) is PseudoPort
