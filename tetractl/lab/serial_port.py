"""A serial port of the lab's devices: opened by one process only, written without long waits.

A write raises AbortError if the port accepts no bytes for 20 ms, and at once if the port has
disappeared; after either failure the port cannot be used any more. A separate thread reads.
"""

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
from tetractl.spec.lab_section import STOPS

WRITE_TIMEOUT_S = 0.02  # longest wait until a port takes what is written [s]
UNREADABLE = (
    *(ValueError, LookupError, TypeError, AttributeError, ArithmeticError),
    struct.error,
)
"""Exceptions that code may raise when it reads a message of another format than it expects."""
SWITCH_OFF = "switch the robots off by hand if they move"


def is_network(name: str) -> bool:
    """Check whether the name of a port is a network address, such as udp://HOST:PORT.

    Over a network, each message arrives whole or not at all, and a device can disappear unnoticed.
    """
    return "://" in name


class PortHeldError(AbortError):
    """An error that says that another process has locked a port.

    `port` is the locked file. If the port `name` is not a file, this is its lock file.
    """

    def __init__(self, port: str, name: str = "") -> None:
        super().__init__(
            f"{name or port}: another program has this port open",
            "only one run can use a port; `tetractl lab stop` stops and ends the run that "
            "has it open",
        )
        self.port = port


OnReceived = Callable[[bytes, int], None]
Ports = Callable[[str, int, str, Clock, OnReceived, str], "SerialPort"]
"""A function that creates a port from the arguments of `SerialPort`, for example one in memory."""


class SerialPort:
    """A serial port of the computer, read by a thread of its own.

    Args:
        name: Name of the port.
        baud: Speed [bits per second].
        device: What is connected to it, for messages.
        clock: The clock for times.
        on_received: Called in the reader's thread with received bytes and their time [ns], and with
            b"" when the port has failed.
        hint: The hint of the errors raised.
    """

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
    ) -> None:
        self.failure: str | None = None
        self.refusal: str | None = None
        """Why nobody receives the data sent, although sending works.

        None if nothing is known.
        """
        self._name = name
        self._baud = baud
        self._device = device
        self._hint = hint
        self._clock = clock
        self._on_received = on_received
        self._sending = threading.Lock()
        self._closing = threading.Event()
        self._port: serial.Serial | None = None
        self._thread = threading.Thread(target=self._read, name=device, daemon=True)

    def open(self, alone: bool = True) -> None:
        """Open the port, exclusively if `alone`, and start to read.

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
                exclusive=alone or None,
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise _cannot_open(self._name, self._device, error) from error
        self._thread.start()

    def is_ready(self) -> bool:
        """Check whether the device is there, or whether the port has stopped waiting for it.

        A serial port does not wait for a device.
        """
        return True

    def settle(self) -> None:
        """Wait until the open port is ready. If several ports are open, their waits overlap.

        A serial port is ready at once.
        """
        while not self.is_ready():
            self._clock.sleep_until(self._clock.now() + 2 * MILLISECOND)

    def write(self, data: bytes) -> int:
        """Send bytes, and return the time when the system accepted them [ns].

        Raises:
            AbortError: If the port is stuck, gone or not open.
        """
        with self._sending:
            if self.failure or self._port is None:
                raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
            try:
                _put(self._port.fileno(), data)
                waiting = self._port.out_waiting
            except TimeoutError:
                raise self._fail(f"accepts no more bytes: {self._device} is stuck") from None
            except (serial.SerialException, OSError, TypeError) as error:
                raise self._fail(f"is gone: {_why(error)}") from error
            if waiting > 2048:
                raise self._fail(f"does not send {waiting} bytes: {self._device} is stuck")
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

    def _fail(self, what: str) -> AbortError:
        self.failure = self.failure or f"the port {self._name} of {self._device} {what}"
        return AbortError(self.failure, self._hint)

    def _end(self, why: str) -> None:
        """Mark the port as failed, and report that no more data will come.

        If the port is just being closed, this does nothing.
        """
        if not self._closing.is_set():
            self.failure = self.failure or why
            self._on_received(b"", self._clock.now())

    def _read(self) -> None:
        port = self._port
        assert port is not None
        while not self._closing.is_set():
            try:
                data = port.read(1)
                if data:
                    data += port.read(port.in_waiting)
            except (serial.SerialException, OSError, TypeError, ValueError) as error:
                self._end(f"the port {self._name} of {self._device} is gone: {_why(error)}")
                return
            if data:
                self._on_received(data, self._clock.now())


def _put(fd: int, data: bytes) -> None:
    """Write to a file descriptor.

    pyserial's own write would also time out if this process was not scheduled for that time.

    Raises:
        TimeoutError: If it accepts no bytes for 20 ms.
    """
    rest = memoryview(data)
    while rest:
        with suppress(BlockingIOError):
            rest = rest[os.write(fd, rest) :]
        if rest and not select.select([], [fd], [], WRITE_TIMEOUT_S)[1]:
            raise TimeoutError


def _why(error: Exception) -> str:
    system = error.strerror if isinstance(error, OSError) else None
    return system or str(error) or type(error).__name__


def _cannot_open(name: str, device: str, error: Exception) -> AbortError:
    number = error.errno if isinstance(error, OSError) else None
    text = str(error)
    if number == 11 or "exclusively lock" in text:
        return PortHeldError(name)
    if number == 2 or "No such file" in text:
        return missing_port(name, device)
    if number == 13:
        return AbortError(
            f"{name}: you have no permission to open this port",
            "join the group that owns the port, often dialout: run sudo usermod -aG dialout "
            "$USER, then log out and in again",
        )
    if not Path(name).is_char_device() or "Inappropriate ioctl" in text:
        return AbortError(f"{name}: this is not a serial port")
    return AbortError(f"{name}: cannot be opened: {_why(error)}")


def require_port(name: str, device: str) -> None:
    """Raise AbortError if no port has this name.

    Args:
        name: Name of the port.
        device: What should be connected to it, for the hint.
    """
    if not Path(name).exists():
        raise missing_port(name, device)


def missing_port(name: str, device: str) -> AbortError:
    """Create the error for a port that does not exist.

    Its hint asks whether `device` is plugged in.
    """
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
        """Open all ports, exclusively, then wait until they are ready."""
        for port in self.ports:
            port.open()
        for port in self.ports:
            port.settle()

    def send(self, messages: Iterable[bytes]) -> int:
        """Send each port its message, even if another port fails.

        Returns:
            The time of the last sending [ns].

        Raises:
            AbortError: If a port has failed.
        """
        sent_ns = 0
        lost = list[AbortError]()
        for port, message in zip(self.ports, messages, strict=True):
            try:
                sent_ns = port.write(message)
            except AbortError as error:
                lost.append(error)
        if lost:
            raise lost[0]
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
        alone: False if another process may have the ports open.

    Returns:
        A summary.

    Raises:
        AbortError: If some robots were not reached. The error names them.
        PortHeldError: If `alone` is True and another process has a port open.
    """

    def are_ready() -> bool:
        return sum(port.is_ready() for port in ports) == len(ports)  # asks every port

    try:
        unreached = _open_reachable(ports, alone)
        send_stops(stop, clock, are_ready)  # which port has failed, the ports say below
    finally:
        for port in ports:
            port.close()
    for port in ports:
        reason = port.failure or port.refusal
        if reason is not None:
            unreached.setdefault(port, reason)
    reasons = list(unreached.values())
    if len(reasons) == len(ports):
        raise AbortError(reasons[0], SWITCH_OFF)
    if reasons:
        raise AbortError(
            f"sent {STOPS} stops, but not to all robots: {'; '.join(reasons)}", SWITCH_OFF
        )
    return f"sent {STOPS} stops"


def _open_reachable(ports: Iterable[SerialPort], alone: bool) -> dict[SerialPort, str]:
    """Open ports, and return those that cannot be opened, as {port: reason}.

    Raises PortHeldError if another process has locked one of them.
    """
    unreached = dict[SerialPort, str]()
    for port in ports:
        try:
            port.open(alone)
        except PortHeldError:
            raise
        except AbortError as error:
            unreached[port] = error.message
    return unreached
