"""Tests of a UDP port with real sockets of this computer."""

import contextlib
import errno
import os
import socket
import tempfile
from queue import Queue

import pytest

from tetractl.core.clock import MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.lab.port_holder import find_holder
from tetractl.lab.serial_port import PortHeldError, SerialPort, stop_all_at
from tetractl.lab.udp_port import ATTEMPTS_MAX, UdpPort, lock_file_of, open_port, parse_address
from tetractl.spec.lab_section import STOP_COUNT

PATIENCE_S = 60


def device():
    """A socket on this computer, as of a robot."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listening.settimeout(PATIENCE_S)
    return listening


@pytest.fixture
def robot():
    with device() as robot:
        robot.bind(("127.0.0.1", 0))
        yield robot


@pytest.fixture
def name(robot):
    """The name of the robot's port."""
    return f"udp://127.0.0.1:{robot.getsockname()[1]}"


@pytest.fixture
def heard():
    """What the ports of a test have heard."""
    return Queue()


@pytest.fixture
def port_to(heard):
    """Make ports; at the end they are closed, and their locks removed."""
    names = []
    with contextlib.ExitStack() as closing:

        def hear(data, now):
            heard.put(data)

        def make(name):
            names.append(name)
            port = UdpPort(name, 57600, "the radio", MonotonicClock(), hear, "hint")
            closing.callback(port.close)
            return port

        yield make
    for name in names:
        lock_file_of(name).unlink(missing_ok=True)


@pytest.fixture
def open_to(port_to):
    """Make open ports."""

    def make(name):
        port = port_to(name)
        port.open()
        return port

    return make


def test_datagrams_go_and_come(robot, name, open_to, heard):
    port = open_to(name)
    assert port.write(b"T 1 0*0000\n") > 0
    data, sender = robot.recvfrom(100)
    assert data == b"T 1 0*0000\n"
    robot.sendto(b"S 0\n", sender)
    assert heard.get(timeout=PATIENCE_S) == b"S 0\n"
    assert port.failure is None
    port.close()
    port.close()
    with pytest.raises(AbortError, match="is not open"):
        port.write(b"x")


def test_a_second_program_is_refused_and_the_first_is_found(name, open_to, port_to):
    open_to(name)
    with pytest.raises(PortHeldError) as held:
        port_to(name).open()
    assert find_holder(held.value.port) == os.getpid()
    port_to(name).open(exclusive=False)


def test_an_unknown_host_is_one_line(port_to):
    with pytest.raises(AbortError, match=r"no\.such\.host\.invalid"):
        port_to("udp://no.such.host.invalid:9750").open()


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
    assert parse_address(name) == address


def test_a_port_is_chosen_by_its_name():
    settings = 57600, "the radio", MonotonicClock(), lambda data, now: None, ""
    assert isinstance(open_port("udp://robot:1", *settings), UdpPort)
    assert type(open_port("/dev/ttyUSB0", *settings)) is SerialPort


def test_who_has_another_address_is_not_heard(robot, name, open_to, heard):
    """Regression: any sender's reply to a poll was accepted."""
    open_to(name).write(b"?")
    _, sender = robot.recvfrom(100)
    with device() as stranger:
        stranger.bind(("127.0.0.1", 0))
        stranger.sendto(b"forged", sender)
    robot.sendto(b"own", sender)
    assert heard.get(timeout=PATIENCE_S) == b"own"
    assert heard.empty()


def test_a_device_that_is_not_there_yet_does_not_end_the_port(robot, name, open_to, heard):
    """The refusal of one datagram is reported with a later one, and a device that answers listens:
    what was refused while it started says nothing any more."""
    address = robot.getsockname()
    robot.close()
    port = open_to(name)
    for _ in range(20):
        port.write(b"?")
    assert port.failure is None
    with device() as started:
        started.bind(address)
        port.write(b"now")
        data, sender = started.recvfrom(100)
        assert data == b"now"
        started.sendto(b"reply", sender)
        assert heard.get(timeout=PATIENCE_S) == b"reply"
    assert port.refusal is None


def stopped(*ports):
    """Return what `lab stop` says of robots at these ports."""

    def stop():
        for port in ports:
            port.write(b"stop")

    return stop_all_at(ports, stop, VirtualClock(), alone=True)


def test_a_host_that_is_reported_unreachable_or_an_empty_datagram_does_not_end_the_port(
    name, port_to, heard, monkeypatch
):
    """Regression: a router's report ended the thread that reads, with a traceback, and an empty
    datagram counted as a port that failed."""
    received = Queue()
    for outcome in (OSError(errno.EHOSTUNREACH, "No route to host"), b"", b"S 0\n"):
        received.put(outcome)
    was_refused = []

    class ReportingSocket(socket.socket):
        def recv(self, most):
            if received.empty():
                return super().recv(most)
            outcome = received.get()
            if isinstance(outcome, OSError):
                raise outcome
            was_refused.append(port.refusal)
            return outcome

    monkeypatch.setattr(socket, "socket", ReportingSocket)
    port = port_to(name)
    port.open()
    assert heard.get(timeout=PATIENCE_S) == b"S 0\n"
    assert port.failure is None
    assert was_refused[0] == f"{name}: No route to host"


def test_stops_where_no_device_listens_are_not_told_as_sent(robot, name, port_to):
    """Regression: with a wrong port in the spec, `lab stop` said `sent 10 stops`, though the system
    had reported that they were refused."""
    robot.close()
    with pytest.raises(AbortError, match=f"^no device listens at the address {name}"):
        stopped(port_to(name))


def test_robots_that_listen_get_their_stops_though_another_does_not(robot, name, port_to):
    with device() as closed:
        closed.bind(("127.0.0.1", 0))
        silent_name = f"udp://127.0.0.1:{closed.getsockname()[1]}"
    what = f"^sent {STOP_COUNT} stops, but not to all robots: .* at the address {silent_name}"
    with pytest.raises(AbortError, match=what):
        stopped(port_to(silent_name), port_to(name))
    assert [robot.recv(100) for _ in range(STOP_COUNT)] == [b"stop"] * STOP_COUNT
    assert stopped(port_to(name)) == f"sent {STOP_COUNT} stops"


def test_a_link_in_the_place_of_the_lock_is_not_followed(port_to, tmp_path):
    """Regression: in the shared temporary folder, another user chose which file was opened."""
    name = "udp://127.0.0.1:9758"
    victim = tmp_path / "victim"
    lock_file_of(name).symlink_to(victim)
    with pytest.raises(AbortError, match=r"tetractl-udp.*: is a link"):
        port_to(name).open()
    assert not victim.exists()


def test_a_second_program_with_another_temporary_folder_is_refused(
    name, open_to, port_to, monkeypatch, tmp_path
):
    """Regression: `lab stop` in a terminal with another TMPDIR than the run's did not see the run,
    said that stops were sent, and the run drove on."""
    open_to(name)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)  # so that TMPDIR is read again
    with pytest.raises(PortHeldError):
        port_to(name).open()


@pytest.mark.parametrize("hosts", [("localhost", "127.0.0.1"), ("127.0.0.1", "localhost")])
def test_a_second_program_that_spells_the_address_in_another_way_is_refused(
    name, hosts, open_to, port_to
):
    """Regression: a run at `udp://robot.local:5000` was not seen at the robot's number, and drove
    on."""
    first_host, second_host = hosts
    first = open_to(name.replace("127.0.0.1", first_host))
    second = port_to(name.replace("127.0.0.1", second_host))
    with pytest.raises(PortHeldError) as held:
        second.open()
    assert find_holder(held.value.port) == os.getpid()
    second.close()
    first.close()
    second.open()  # a closed port holds neither spelling


def test_a_run_is_seen_while_its_name_cannot_be_resolved(name, open_to, port_to, monkeypatch):
    """`lab stop` ends the run that has a port, even if the network that knows its name is gone."""
    port_to(name)  # whose lock is held, too
    by_name = name.replace("127.0.0.1", "localhost")
    open_to(by_name)

    def unknown(*_):
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(PortHeldError):
        port_to(by_name).open()


def test_other_users_can_read_a_lock(name, open_to):
    """Regression: with the umask 077, another user's `lab stop` could not open the lock, and sent
    the robot no stop."""
    umask = os.umask(0o077)
    try:
        open_to(name)
        assert lock_file_of(name).stat().st_mode & 0o777 == 0o644
    finally:
        os.umask(umask)


def test_a_datagram_that_is_not_sent_has_no_time_of_sending(name, open_to, monkeypatch):
    """Regression: `write` returned a time though each try had only reported a refusal. The port can
    be used further, so that all stops are tried."""

    class RefusedSocket(socket.socket):
        tries = 0

        def sendto(self, *_):
            RefusedSocket.tries += 1
            raise ConnectionRefusedError

    monkeypatch.setattr(socket, "socket", RefusedSocket)
    port = open_to(name)
    for _ in range(2):
        with pytest.raises(AbortError, match="no device listens"):
            port.write(b"stop")
    assert RefusedSocket.tries == 2 * ATTEMPTS_MAX
    assert port.failure is None


def test_all_devices_are_heard_at_a_broadcast_address(open_to, heard):
    with device() as robot:
        robot.bind(("", 0))
        port = open_to(f"udp://127.255.255.255:{robot.getsockname()[1]}")
        port.write(b"?")
        data, sender = robot.recvfrom(100)
        assert data == b"?"
        robot.sendto(b"reply", ("127.0.0.1", sender[1]))
        assert heard.get(timeout=PATIENCE_S) == b"reply"


def test_a_pipe_in_the_place_of_the_lock_is_refused_at_once(port_to):
    name = "udp://127.0.0.1:9757"
    os.mkfifo(lock_file_of(name))
    with pytest.raises(AbortError, match="is not a regular file"):
        port_to(name).open()
