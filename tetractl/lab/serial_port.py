"""Serial ports of the lab's devices. One process opens a port, and writing never blocks for long.

A write raises AbortError if the port accepts no bytes for 20 ms, and at once if the port has
disappeared. After either failure, the port cannot be used any more. A separate thread reads.
"""

import errno
import os
import select
import struct
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import serial

from tetractl.core.clock import MILLISECOND, Clock
from tetractl.core.errors import AbortError
from tetractl.lab.stop_all import send_stops
from tetractl.spec.lab_section import STOP_COUNT

WRITE_TIMEOUT_S = 0.02
"""Maximum time for which a write waits until the port accepts more bytes [s]."""
UNSENT_BYTES_MAX = 2048
"""Maximum number of written bytes that the system has not sent yet. Beyond it, the port fails."""
UNREADABLE = (
    *(ValueError, LookupError, TypeError, AttributeError, ArithmeticError),
    struct.error,
)
"""Exceptions that a decoder may raise if a message does not have the expected format."""
SWITCH_OFF_HINT = "switch the robots off by hand if they move"
"""The hint of errors after which robots may still be driven."""


def is_network(name: str) -> bool:
    """Check whether the name of a port is a network address, such as udp://HOST:PORT.

    Over a network, each message arrives whole or not at all, and a device can disappear unnoticed.
    """
    return "://" in name


class PortHeldError(AbortError):
    """The error that is raised if another process has locked a port.

    Attributes:
        port: The locked file: the port itself, or the lock file of a port that is not a file.
    """

    def __init__(self, port: str, name: str = "") -> None:
        super().__init__(
            f"{name or port}: another program has this port open",
            "only one run can use a port; `tetractl lab stop` stops and ends the run that "
            "has it open",
        )
        self.port = port


OnReceived = Callable[[bytes, int], None]
"""A function that is called with the received bytes and the time of their arrival [ns]."""
PortFactory = Callable[[str, int, str, Clock, OnReceived, str], "SerialPort"]
"""A function that creates a port from the arguments of `SerialPort`.

Tests and the emulator pass a function that creates ports in memory.
"""


class SerialPort:
    """A serial port of the computer, read by a thread of its own.

    Args:
        name: Name of the port, such as /dev/ttyUSB0.
        baud: Speed [bits per second].
        device: Description of the connected device, for messages.
        clock: The clock for times.
        on_received: Called in the reader's thread with received bytes and their time [ns], and with
            b"" when the port has failed.
        hint: The hint of each AbortError that the port raises.

    Attributes:
        failure: Why the port cannot be used any more. None while it works.
        refusal: Why nobody receives the data sent, although sending works. None if nothing is
            known.
    """

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
    ) -> None:
        self.failure: str | None = None
        self.refusal: str | None = None
        self._name = name
        self._baud = baud
        self._device = device
        self._hint = hint
        self._clock = clock
        self._on_received = on_received
        self._write_lock = threading.Lock()
        self._closing = threading.Event()
        self._port: serial.Serial | None = None
        self._thread = threading.Thread(target=self._read, name=device, daemon=True)

    def open(self, exclusive: bool = True) -> None:
        """Open the port, and start the thread that reads from it.

        Args:
            exclusive: Whether to lock the port, so that no other process can open it.

        Raises:
            PortHeldError: If another process has locked the port.
            AbortError: If the port cannot be opened.
        """
        try:
            self._port = serial.Serial(
                self._name,
                self._baud,
                timeout=0.05,
                write_timeout=WRITE_TIMEOUT_S,
                exclusive=exclusive or None,
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise _explain_failed_open(self._name, self._device, error) from error
        self._thread.start()

    def is_ready(self) -> bool:
        """Check whether the port has stopped waiting for its device.

        It stops when the device is there, or when it gives up. A serial port never waits.
        """
        return True

    def settle(self) -> None:
        """Wait until the open port is ready; see `is_ready`.

        If several ports are open, their waits overlap. A serial port is ready at once.
        """
        while not self.is_ready():
            self._clock.sleep_until(self._clock.now() + 2 * MILLISECOND)

    def write(self, data: bytes) -> int:
        """Send bytes, and return the time when the system accepted them [ns].

        Raises:
            AbortError: If the port accepts no more bytes, has disappeared, or is not open.
        """
        with self._write_lock:
            if self.failure or self._port is None:
                raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
            try:
                _write_all(self._port.fileno(), data)
                n_unsent = self._port.out_waiting
            except TimeoutError:
                raise self._fail(f"accepts no more bytes: {self._device} is stuck") from None
            except (serial.SerialException, OSError, TypeError) as error:
                raise self._fail(f"is gone: {_describe_error(error)}") from error
            if n_unsent > UNSENT_BYTES_MAX:
                raise self._fail(f"does not send {n_unsent} bytes: {self._device} is stuck")
            return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Change the speed of the open port [bits per second].

        Ports that are not serial ignore this.
        """
        if self._port is not None:
            self._port.baudrate = baud

    def close(self) -> None:
        """End the reader's thread and close the port.

        This method can be called twice, and never raises.
        """
        self._closing.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(2.0)
        if self._port is not None:
            with suppress(OSError, serial.SerialException):
                self._port.close()
            self._port = None

    def _fail(self, problem: str) -> AbortError:
        """Mark the port as failed, and return the error that reports the first failure."""
        self.failure = self.failure or f"the port {self._name} of {self._device} {problem}"
        return AbortError(self.failure, self._hint)

    def _report_failure(self, failure: str) -> None:
        """Mark the port as failed, and tell `on_received` that no more data will come.

        If the port is just being closed, nothing happens.
        """
        if not self._closing.is_set():
            self.failure = self.failure or failure
            self._on_received(b"", self._clock.now())

    def _read(self) -> None:
        """Pass received bytes on until the port is closed. This runs in the reader's thread."""
        port = self._port
        assert port is not None
        while not self._closing.is_set():
            try:
                data = port.read(1)
                if data:
                    data += port.read(port.in_waiting)
            except (serial.SerialException, OSError, TypeError, ValueError) as error:
                self._report_failure(
                    f"the port {self._name} of {self._device} is gone: {_describe_error(error)}"
                )
                return
            if data:
                self._on_received(data, self._clock.now())


def _write_all(descriptor: int, data: bytes) -> None:
    """Write all bytes to a file descriptor, and wait while it accepts none.

    pyserial's own write would also time out if this process was not scheduled for that time.

    Raises:
        TimeoutError: If the descriptor accepts no bytes for WRITE_TIMEOUT_S.
    """
    unwritten = memoryview(data)
    while unwritten:
        with suppress(BlockingIOError):
            unwritten = unwritten[os.write(descriptor, unwritten) :]
        if unwritten and not select.select([], [descriptor], [], WRITE_TIMEOUT_S)[1]:
            raise TimeoutError


def _describe_error(error: Exception) -> str:
    """Return the system's message for an error. If there is none, use Python's message."""
    system_message = error.strerror if isinstance(error, OSError) else None
    return system_message or str(error) or type(error).__name__


def _explain_failed_open(name: str, device: str, error: Exception) -> AbortError:
    """Create the error that explains to the operator why a serial port could not be opened."""
    error_number = error.errno if isinstance(error, OSError) else None
    message = str(error)
    if error_number == errno.EAGAIN or "exclusively lock" in message:
        return PortHeldError(name)
    if error_number == errno.ENOENT or "No such file" in message:
        return missing_port_error(name, device)
    if error_number == errno.EACCES:
        return AbortError(
            f"{name}: you have no permission to open this port",
            "join the group that owns the port, often dialout: run sudo usermod -aG dialout "
            "$USER, then log out and in again",
        )
    if not Path(name).is_char_device() or "Inappropriate ioctl" in message:
        return AbortError(f"{name}: this is not a serial port")
    return AbortError(f"{name}: cannot be opened: {_describe_error(error)}")


def require_port(name: str, device: str) -> None:
    """Raise AbortError if this computer has no port with a name.

    Args:
        name: Name of the port.
        device: Description of the device that should be connected, for the hint.
    """
    if not Path(name).exists():
        raise missing_port_error(name, device)


def missing_port_error(name: str, device: str) -> AbortError:
    """Create the error for a port that does not exist, with the hint to plug the device in."""
    return AbortError(f"{name}: there is no such port", f"is {device} plugged in?")


class PortGroup:
    """Several ports used as one, for example one for each robot."""

    def __init__(self, ports: Iterable[SerialPort]) -> None:
        self.ports = tuple(ports)

    @property
    def failure(self) -> str | None:
        """Why commands can no longer be sent to all ports. None if no port has failed."""
        return next((port.failure for port in self.ports if port.failure), None)

    def open(self) -> None:
        """Open all ports, so that no other process can use them, and wait until they are ready."""
        for port in self.ports:
            port.open()
        for port in self.ports:
            port.settle()

    def send(self, messages: Iterable[bytes]) -> int:
        """Send one message to each port, even if another port fails.

        Args:
            messages: The messages, in the order of the ports.

        Returns:
            When the last message was sent [ns].

        Raises:
            AbortError: If a port has failed. The error describes the first failure.
        """
        sent_ns = 0
        failures = list[AbortError]()
        for port, message in zip(self.ports, messages, strict=True):
            try:
                sent_ns = port.write(message)
            except AbortError as error:
                failures.append(error)
        if failures:
            raise failures[0]
        return sent_ns

    def close(self) -> None:
        """Release all ports.

        This method can be called twice, and never raises.
        """
        for port in self.ports:
            port.close()


def stop_all_at(
    ports: Sequence[SerialPort], stop: Callable[[], object], clock: Clock, alone: bool
) -> str:
    """Open the ports of robots, send stops, and close the ports.

    The first stop is sent at once. While some ports are not ready, the robots at the other ports
    get more stops than STOPS. If a port cannot be opened, or no device listens there, the other
    robots still get their stops.

    Args:
        ports: The ports.
        stop: Sends a stop to each port, even if one of them fails.
        clock: The clock for timeouts.
        alone: False if another process may have the ports open. Then they are not locked.

    Returns:
        A sentence that tells the operator how many stops were sent.

    Raises:
        AbortError: If some robots were not reached. The error names them.
        PortHeldError: If `alone` is True and another process has a port open.
    """

    def are_ready() -> bool:
        """Check whether no port waits for its device any more. Every port is asked."""
        return sum(port.is_ready() for port in ports) == len(ports)

    try:
        reason_by_port = _open_reachable(ports, alone)
        send_stops(stop, clock, are_ready)  # failures are read from the ports below
    finally:
        for port in ports:
            port.close()
    for port in ports:
        reason = port.failure or port.refusal
        if reason is not None:
            reason_by_port.setdefault(port, reason)
    reasons = list(reason_by_port.values())
    if len(reasons) == len(ports):
        raise AbortError(reasons[0], SWITCH_OFF_HINT)
    if reasons:
        raise AbortError(
            f"sent {STOP_COUNT} stops, but not to all robots: {'; '.join(reasons)}", SWITCH_OFF_HINT
        )
    return f"sent {STOP_COUNT} stops"


def _open_reachable(ports: Iterable[SerialPort], exclusive: bool) -> dict[SerialPort, str]:
    """Open ports, and return the reason for each port that cannot be opened.

    Raises:
        PortHeldError: If another process has locked a port.
    """
    reason_by_port = dict[SerialPort, str]()
    for port in ports:
        try:
            port.open(exclusive)
        except PortHeldError:
            raise
        except AbortError as error:
            reason_by_port[port] = error.message
    return reason_by_port
