"""Tests of the network and the serial ports in memory: they behave as real wires do."""

import pytest
from testkit.hand_clock import HandClock
from tetractl_emulator.memory_wires import FIRST_FREE_PORT, MemoryNetwork

from tetractl.core.errors import AbortError

NAME = "/dev/ttyUSB0"
NETWORK = "udp://192.168.4.1:9750"
HERE = ("127.0.0.1", 1510)


class Wire:
    """A port that is plugged in, with our end of it, which keeps what it hears and how it fails."""

    def __init__(self, name=NAME, baud=57600, plugged=True):
        self.network = MemoryNetwork()
        self.device = self.network.port(name)
        if plugged:
            self.device.plug()
        self.clock = HandClock()
        self.heard = []
        self.ours = self.end(name, baud)

    def end(self, name=NAME, baud=57600):
        """Another end of the port for a program."""
        return self.network.serial(name, baud, "radio", self.clock, self._hear, "plug it in")

    def _hear(self, data, at_ns):
        self.heard.append((data, at_ns))


def opened(**more):
    wire = Wire(**more)
    wire.ours.open()
    return wire


def test_a_datagram_comes_once_in_its_order_with_the_address_of_its_sender():
    network = MemoryNetwork()
    first = network.bound_socket(*HERE)
    second = network.bound_socket("127.0.0.1", 0)
    second.sendto(b"one", HERE)
    second.sendto(b"two", HERE)
    assert first.recvfrom(100) == (b"one", second.getsockname())
    assert first.recvfrom(2) == (b"tw", second.getsockname())
    for socket in (first, second):
        with pytest.raises(BlockingIOError):
            socket.recvfrom(100)


def test_a_datagram_to_nobody_is_lost():
    network = MemoryNetwork()
    first = network.bound_socket(*HERE)
    first.sendto(b"?", ("127.0.0.1", 1511))
    first.sendto(b"?", ("127.0.0.2", 1510))
    with pytest.raises(BlockingIOError):
        first.recvfrom(100)
    late = network.bound_socket("127.0.0.1", 1511)
    with pytest.raises(BlockingIOError):
        late.recvfrom(100)
    late.close()
    late.close()
    first.sendto(b"?", ("127.0.0.1", 1511))


def test_a_socket_that_is_bound_to_all_hosts_hears_its_port_at_each():
    network = MemoryNetwork()
    everywhere = network.bound_socket("", 1511)
    there = network.bound_socket("127.0.0.2", 1511)
    sender = network.bound_socket("127.0.0.1", 0)
    sender.sendto(b"a", ("127.0.0.1", 1511))
    sender.sendto(b"b", ("127.0.0.2", 1511))  # the socket of this very address hears it
    assert everywhere.recvfrom(9)[0] == b"a"
    assert there.recvfrom(9)[0] == b"b"
    with pytest.raises(BlockingIOError):
        everywhere.recvfrom(9)


def test_free_ports_are_not_given_twice_and_a_named_port_is_kept():
    network = MemoryNetwork()
    ports = [network.bound_socket("127.0.0.1", 0).getsockname()[1] for _ in range(3)]
    assert ports == [FIRST_FREE_PORT, FIRST_FREE_PORT + 1, FIRST_FREE_PORT + 2]
    assert network.bound_socket(*HERE).getsockname() == HERE
    assert network.bound_socket("127.0.0.1", 50_000).fileno() == 50_000
    assert network.bound_socket("127.0.0.1", 0).getsockname()[1] == 50_001


def test_what_one_end_writes_the_other_reads():
    wire = opened()
    wire.clock.advance(2.0)
    assert wire.ours.write(b"AT") == 2_000_000_000
    wire.ours.write(b"HV")
    assert wire.device.read() == b"ATHV"
    assert wire.device.read() == b""
    wire.clock.advance(1.0)
    wire.device.write(b"OK")
    assert wire.heard == [(b"OK", 3_000_000_000)]


def test_a_network_keeps_datagrams_apart():
    wire = opened(name=NETWORK)
    wire.ours.write(b"AT")
    wire.ours.write(b"HV")
    assert [wire.device.read() for _ in range(3)] == [b"AT", b"HV", b""]


def test_a_device_reads_the_speed_that_our_end_has_set():
    wire = Wire(baud=9600)
    assert wire.device.baud() == 0
    wire.ours.open()
    assert wire.device.baud() == 9600
    wire.ours.set_baud(115_200)
    assert wire.device.baud() == 115_200
    wire.ours.close()
    assert wire.device.baud() == 0
    assert opened(name=NETWORK).device.baud() is None


def test_a_port_that_is_not_plugged_in_cannot_be_opened():
    wire = Wire(plugged=False)
    assert wire.device.fd == -1
    with pytest.raises(AbortError, match=NAME):
        wire.ours.open()
    wire.device.plug()
    wire.ours.open()
    wire.device.unplug()
    assert wire.device.fd == -1
    with pytest.raises(AbortError, match=NAME):
        wire.end().open()


def test_a_port_is_held_by_one_program_unless_the_next_does_not_ask_to_be_alone():
    wire = opened()
    with pytest.raises(AbortError):
        wire.end().open()
    second = wire.end()
    second.open(exclusive=False)
    second.close()
    wire.end().open()  # nobody holds it any more


def test_plugged_devices_have_numbers_of_their_own():
    network = MemoryNetwork()
    devices = [network.port(f"/dev/ttyUSB{k}") for k in range(3)]
    for device in devices:
        device.plug()
    assert len({device.fd for device in devices}) == 3
    assert min(device.fd for device in devices) > 2  # not those of the standard streams


def test_our_end_fails_when_the_device_is_unplugged_and_what_it_wrote_is_lost():
    wire = opened()
    wire.ours.write(b"AT")
    wire.device.unplug()
    wire.device.unplug()
    assert "is gone" in wire.ours.failure
    with pytest.raises(AbortError, match="is gone"):
        wire.ours.write(b"AT")
    wire.device.write(b"OK")
    assert [data for data, _ in wire.heard if data] == []
    wire.device.plug()
    assert wire.device.read() == b""


def test_what_a_device_writes_while_our_end_is_closed_is_lost():
    wire = Wire()
    wire.device.write(b"early")
    wire.ours.open()
    assert wire.heard == []
    wire.ours.close()
    wire.ours.close()
    wire.device.write(b"late")
    assert wire.heard == []
    with pytest.raises(AbortError, match="is not open"):
        wire.ours.write(b"AT")
    assert wire.device.read() == b""


def test_a_stalled_port_takes_no_bytes_until_it_takes_them_again():
    wire = opened()
    wire.device.set_stalled(False)
    wire.ours.write(b"AT")
    wire.device.set_stalled(True)
    with pytest.raises(AbortError, match="accepts no more bytes"):
        wire.ours.write(b"HV")
    assert wire.device.read() == b"AT"
    wire.device.set_stalled(False)
    fresh = wire.end()
    fresh.open(exclusive=False)
    fresh.write(b"VR")
    assert wire.device.read() == b"VR"
