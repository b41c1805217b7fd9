"""A UDP port, with real sockets of this computer."""

import contextlib
import errno
import os
import socket
import tempfile
from queue import Queue

import pytest

from tetractl.core.clock import MonotonicClock, VirtualClock
from tetractl.core.errors import AbortError
from tetractl.experiment.lab_section import STOPS
from tetractl.lab.port_holder import holder
from tetractl.lab.serial_port import PortHeldError, SerialPort, stop_all_at
from tetractl.lab.udp_port import REFUSALS_MAX, UdpPort, address_of, lock_file, open_port

PATIENCE_S = 60


@pytest.fixture
def robot():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.settimeout(PATIENCE_S)
        robot.bind(("127.0.0.1", 0))
        yield robot


def port_to(name, heard=lambda data, now: None):
    return UdpPort(name, 57600, "the radio", MonotonicClock(), heard, "hint")


@contextlib.contextmanager
def run_at(name):
    """A program that has the port of this name open."""
    port = port_to(name)
    port.open()
    try:
        yield port
    finally:
        port.close()
        lock_file(name).unlink()


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
    with run_at(name), contextlib.closing(port_to(name)) as second:
        with pytest.raises(PortHeldError) as held:
            second.open()
        assert holder(held.value.port) == os.getpid()
        beside = port_to(name)
        beside.open(alone=False)
        beside.close()


def test_a_second_program_with_another_temporary_folder_is_refused(robot, monkeypatch, tmp_path):
    """Regression: `lab stop` in a terminal with another TMPDIR than the run's did not see the run,
    said that stops were sent, and the run drove on."""
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    with run_at(name):
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        monkeypatch.setattr(tempfile, "tempdir", None)  # so that TMPDIR is read again
        with contextlib.closing(port_to(name)) as second, pytest.raises(PortHeldError):
            second.open()


@pytest.mark.parametrize("hosts", [("localhost", "127.0.0.1"), ("127.0.0.1", "localhost")])
def test_a_second_program_that_spells_the_address_in_another_way_is_refused(robot, hosts):
    """Regression: a run at `udp://robot.local:5000` was not seen at the robot's number, and drove
    on."""
    first_name, second_name = (f"udp://{host}:{robot.getsockname()[1]}" for host in hosts)
    first = port_to(first_name)
    second = port_to(second_name)
    first.open()
    try:
        with pytest.raises(PortHeldError) as held:
            second.open()
        assert holder(held.value.port) == os.getpid()
        second.close()
        first.close()
        second.open()  # a closed port holds neither spelling
    finally:
        first.close()
        second.close()
        lock_file(first_name).unlink()
        lock_file(second_name).unlink()


def test_a_run_is_seen_while_its_name_cannot_be_resolved(robot, monkeypatch):
    """`lab stop` ends the run that has a port, even if the network that knows its name is gone."""
    name = f"udp://localhost:{robot.getsockname()[1]}"
    first = port_to(name)
    second = port_to(name)
    first.open()
    try:

        def unknown(*_):
            raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

        monkeypatch.setattr(socket, "getaddrinfo", unknown)
        with pytest.raises(PortHeldError):
            second.open()
    finally:
        first.close()
        second.close()
        lock_file(name).unlink()
        lock_file(name.replace("localhost", "127.0.0.1")).unlink()


def test_other_users_can_read_a_lock(robot):
    """Regression: with the umask 077, another user's `lab stop` could not open the lock, and sent
    the robot no stop."""
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    port = port_to(name)
    umask = os.umask(0o077)
    try:
        port.open()
        assert lock_file(name).stat().st_mode & 0o777 == 0o644
    finally:
        os.umask(umask)
        port.close()
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


def stopped(*ports):
    """Return what `lab stop` says of robots at these ports."""

    def stop():
        for port in ports:
            port.write(b"stop")

    return stop_all_at(ports, stop, VirtualClock(), alone=True)


def test_a_host_that_is_reported_unreachable_or_an_empty_datagram_does_not_end_the_port(
    robot, monkeypatch
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

    heard = Queue()
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    monkeypatch.setattr(socket, "socket", ReportingSocket)
    port = port_to(name, lambda data, now: heard.put(data))
    port.open()
    try:
        assert heard.get(timeout=PATIENCE_S) == b"S 0\n"
        assert port.failure is None
    finally:
        port.close()
    assert was_refused[0] == f"{name}: No route to host"


def test_stops_where_no_device_listens_are_not_told_as_sent(robot):
    """Regression: with a wrong port in the spec, `lab stop` said `sent 10 stops`, though the system
    had reported that they were refused."""
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    robot.close()
    try:
        with pytest.raises(AbortError, match=f"^no device listens at {name}"):
            stopped(port_to(name))
    finally:
        lock_file(name).unlink()


def test_robots_that_listen_get_their_stops_though_another_does_not(robot):
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        silent_name = f"udp://127.0.0.1:{closed.getsockname()[1]}"
    what = f"^sent {STOPS} stops, but not to all: no device listens at {silent_name}"
    try:
        with pytest.raises(AbortError, match=what):
            stopped(port_to(silent_name), port_to(name))
        assert [robot.recv(100) for _ in range(STOPS)] == [b"stop"] * STOPS
        assert stopped(port_to(name)) == f"sent {STOPS} stops"
    finally:
        lock_file(name).unlink()
        lock_file(silent_name).unlink()


def test_a_device_that_answers_listens(robot):
    """What was refused while it started says nothing any more."""
    address = robot.getsockname()
    robot.close()
    heard = Queue()
    name = f"udp://127.0.0.1:{address[1]}"
    port = port_to(name, lambda data, now: heard.put(data))
    port.open()
    try:
        port.write(b"?")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as started:
            started.settimeout(PATIENCE_S)
            started.bind(address)
            port.write(b"now")
            _, sender = started.recvfrom(100)
            started.sendto(b"reply", sender)
            assert heard.get(timeout=PATIENCE_S) == b"reply"
            assert port.refusal is None
    finally:
        port.close()
        lock_file(name).unlink()


def test_a_datagram_that_is_not_sent_has_no_time_of_sending(robot, monkeypatch):
    """Regression: `write` returned a time though each try had only reported a refusal. The port can
    be used further, so that all stops are tried."""

    class RefusedSocket(socket.socket):
        tries = 0

        def sendto(self, *_):
            RefusedSocket.tries += 1
            raise ConnectionRefusedError

    monkeypatch.setattr(socket, "socket", RefusedSocket)
    name = f"udp://127.0.0.1:{robot.getsockname()[1]}"
    port = port_to(name)
    port.open()
    try:
        for _ in range(2):
            with pytest.raises(AbortError, match="no device listens"):
                port.write(b"stop")
        assert RefusedSocket.tries == 2 * REFUSALS_MAX
        assert port.failure is None
    finally:
        port.close()
        lock_file(name).unlink()


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
