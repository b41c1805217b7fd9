"""Ports to devices that receive UDP datagrams. They are used like serial ports.

The name of such a port is `udp://host:port`. UDP does not confirm delivery, and the remote computer
may refuse a datagram if no device listens. The port receives only the datagrams that come from its
own address. A datagram to a broadcast address reaches all devices of a network. Each of them
replies from its own address, so a port with a broadcast address receives datagrams from any sender.

A port named `udp://:port` only listens: it receives what anybody sends to this port of this
computer, and sends nothing.
"""

import errno
import hashlib
import ipaddress
import os
import socket
import stat
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import OnReceived, PortHeldError, SerialPort
from tetractl.tools.files import lock_file as take_lock

SCHEME = "udp://"
"""Beginning of the name of a UDP port."""
DATAGRAM_BYTES_MAX = 1500
"""Maximum number of bytes of a datagram that are read. An Ethernet frame has no more."""
PORT_DIGITS_MAX = 5
"""Maximum number of digits of a port number."""
LOCK_FOLDER = Path("/tmp")
"""Folder of lock files. It is the same for all users and terminals, whatever TMPDIR is."""
ATTEMPTS_MAX = 3
"""Maximum number of attempts to send a datagram.

An attempt fails if the system reports the refusal of an earlier datagram.
"""


def parse_address(name: str) -> tuple[str, int] | None:
    """Parse the name `udp://host:port` of a UDP port.

    Returns:
        The host and the port number. None if the name has another form, or the host or the port
        number is invalid.
    """
    host, _, digits = name.removeprefix(SCHEME).rpartition(":")
    port = _parse_port(digits)
    if not name.startswith(SCHEME) or not host or port is None:
        return None
    try:
        host.encode("idna")  # as the system's resolver encodes it
    except UnicodeError:  # a label is empty, as in a..b, or too long
        return None
    return host, port


def parse_listening_port(name: str) -> int | None:
    """Parse the name `udp://:port` of a port on which this computer only listens.

    Returns:
        The port number. None if the name has another form.
    """
    listening_prefix = f"{SCHEME}:"
    return (
        _parse_port(name.removeprefix(listening_prefix))
        if name.startswith(listening_prefix)
        else None
    )


def _parse_port(digits: str) -> int | None:
    """Parse a port number from 1 to 65535. The result is None if the digits are not one."""
    if not (digits.isascii() and digits.isdecimal()) or len(digits) > PORT_DIGITS_MAX:
        return None
    number = int(digits)
    return number if 0 < number < 65536 else None


def lock_file_of(name: str) -> Path:
    """Return the path of the file that a program locks while it uses the port `name`."""
    digest = hashlib.sha256(name.encode()).hexdigest()[:16]
    return LOCK_FOLDER / f"tetractl-udp-{digest}.lock"


def _open_lock(path: Path) -> int:
    """Open a lock file in a folder to which other users can also write. Return its descriptor.

    A link is refused, because it could lead to a file that another user has chosen. Anything else
    that is not a regular file is refused as well. The file is opened for reading, which is enough
    for a lock: the file may belong to another user who shares the robots.

    Raises:
        OSError: If the file cannot be opened.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        descriptor = os.open(path, flags)
    else:
        os.fchmod(descriptor, 0o644)  # other users can read it, whatever this user's umask
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is not a regular file")
    return descriptor


def lock_address(name: str) -> int:
    """Lock an address on the network, so that no other run on this computer drives its devices.

    Args:
        name: The address, such as udp://HOST:PORT.

    Returns:
        The descriptor of the locked file. Close it to end the lock.

    Raises:
        PortHeldError: If another program has locked the address.
        AbortError: If the lock file cannot be opened or locked.
    """
    lock_path = lock_file_of(name)
    descriptor = -1
    try:
        descriptor = _open_lock(lock_path)
        take_lock(descriptor)
    except OSError as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise PortHeldError(str(lock_path), name) from None
        problem = "is a link" if error.errno == errno.ELOOP else error.strerror
        raise AbortError(
            f"{lock_path}: this lock file of {name} cannot be used: {problem}",
            "remove the file if it exists; otherwise, give this user permission to "
            f"write to the folder {LOCK_FOLDER}",
        ) from None
    return descriptor


class UdpPort(SerialPort):
    """A UDP port: the devices at `udp://host:port`, used like a serial port.

    The system may report that nobody received a datagram. Such a refusal belongs to an earlier
    datagram, so the port does not fail: the device may be starting, or be out of the network's
    reach. The port keeps the refusal in `refusal` until data arrives, because the system refuses
    only some of many datagrams. An empty datagram, which anybody may send, is ignored.

    Args:
        name: The address, `udp://host:port`, or `udp://:port` to listen only.
        baud: Ignored. It is there because serial ports need it.
        device: Description of the connected device, for messages.
        clock: The clock for times.
        on_received: Called with received bytes and their time [ns]; see `SerialPort`.
        hint: The hint of each AbortError that the port raises.
    """

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
    ) -> None:
        super().__init__(name, baud, device, clock, on_received, hint)
        self._socket: socket.socket | None = None
        self._destination: Any = None
        """Resolved host and port number. None before `open`, and if the port only listens."""
        self._refusal_message = f"no device listens at the address {name}"
        self._lock_descriptors: list[int] = []
        """Descriptors of the lock files that this port has locked."""

    def open(self, exclusive: bool = True) -> None:
        """Open a socket, and start the thread that reads from it.

        The name is locked before it is resolved. A run that uses the same name is therefore noticed
        even if names cannot be resolved at the moment. Then the resolved address is locked, which
        another program may know under another name.

        Args:
            exclusive: Whether to lock the address, so that no other run can use it.

        Raises:
            PortHeldError: If `exclusive` is True and another program has locked the address.
            AbortError: If the address is invalid or cannot be reached.
        """
        listening_port = parse_listening_port(self._name)
        if listening_port is not None:
            self._listen(listening_port)
            return
        address = parse_address(self._name)
        if address is None:
            raise AbortError(f"{self._name}: must be {SCHEME}HOST:PORT, or {SCHEME}:PORT to listen")
        if exclusive:
            self._lock_descriptors.append(lock_address(self._name))
        try:
            self._destination = socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)[0][
                4
            ]
        except OSError as error:
            problem = f"{self._name}: {error.strerror}"
            raise AbortError(
                problem, "is the address right, and is this computer connected to the network?"
            ) from None
        host, port = self._destination
        resolved_name = f"{SCHEME}{host}:{port}"
        if exclusive and resolved_name != self._name:
            self._lock_descriptors.append(lock_address(resolved_name))
        self._listen(0)

    def _listen(self, port: int) -> None:
        """Bind the socket to a port of this computer, and start to read from it.

        Args:
            port: Number of the port. 0 for any free port.

        Raises:
            AbortError: If another program already reads from the port.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.05)
        try:
            self._socket.bind(("", port))
        except OSError as error:
            problem = f"{self._name}: {error.strerror}"
            raise AbortError(problem, "does another program already listen on this port?") from None
        if (
            self._destination is not None
            and not ipaddress.ip_address(self._destination[0]).is_multicast
        ):
            try:
                self._socket.connect(self._destination)  # drops datagrams of other senders
            except PermissionError:  # a broadcast address, which the option below allows
                pass
            except OSError as error:
                raise AbortError(f"{self._name}: {error.strerror}", self._hint) from None
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Send a datagram, and return the time when the system accepted it [ns].

        A port that only listens sends nothing.

        Raises:
            AbortError: If the port is not open, has failed, or every attempt is refused.
        """
        with self._write_lock:
            if self.failure or self._socket is None:
                raise AbortError(self.failure or f"{self._name} is not open", self._hint)
            if self._destination is None:
                return self._clock.now()
            try:
                self._send(self._socket, data)
            except OSError as error:
                raise self._fail(f"cannot be reached: {error.strerror or error}") from None
            return self._clock.now()

    def _send(self, udp_socket: socket.socket, data: bytes) -> None:
        """Send a datagram, and try again up to ATTEMPTS_MAX times.

        The system may report a refusal that belongs to an earlier datagram, for example while a
        robot starts up.

        Raises:
            AbortError: If every attempt is refused.
        """
        for _ in range(ATTEMPTS_MAX):
            try:
                udp_socket.sendto(data, self._destination)
            except ConnectionRefusedError:
                self.refusal = self._refusal_message
            else:
                return
        raise AbortError(self._refusal_message, self._hint)

    def close(self) -> None:
        """End the reader's thread, close the socket and release the locks.

        It may be called twice and never raises.
        """
        super().close()
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        while self._lock_descriptors:
            os.close(self._lock_descriptors.pop())

    def _read(self) -> None:
        """Pass received datagrams on until the port is closed. This runs in the reader's thread."""
        while not self._closing.is_set():
            data = self._receive()
            if data:
                self._on_received(data, self._clock.now())

    def _receive(self) -> bytes:
        """Wait at most 0.05 s for a datagram, and return its bytes.

        The result is empty if no datagram arrives, or if the system reports that an earlier one was
        refused.
        """
        assert self._socket is not None
        try:
            data = self._socket.recv(DATAGRAM_BYTES_MAX)
        except TimeoutError:
            return b""
        except ConnectionRefusedError:
            self.refusal = self._refusal_message
            return b""
        except OSError as error:
            self.refusal = f"{self._name}: {error.strerror or error}"
            self._closing.wait(0.05)  # the error may repeat at once
            return b""
        self.refusal = None
        return data


def open_port(
    name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
) -> SerialPort:
    """Create the port with a name, without opening it.

    The port is a UDP port if its name begins with `udp://`. Otherwise, it is a serial port.

    Args:
        name: Name of the port.
        baud: Speed of a serial port [bits per second]. Ignored for UDP.
        device: Description of the connected device, for messages.
        clock: The clock for times.
        on_received: Called with received bytes and their time [ns].
        hint: The hint of each AbortError that the port raises.
    """
    port_type = UdpPort if name.startswith(SCHEME) else SerialPort
    return port_type(name, baud, device, clock, on_received, hint)
