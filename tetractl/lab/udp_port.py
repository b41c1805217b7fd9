"""A port to devices that take UDP datagrams, used like a serial port: `udp://host:port`.

A datagram to a broadcast address reaches all devices of a network. UDP does not confirm delivery,
and the remote computer may refuse a datagram if no device listens. Only datagrams from the address
written to are received. At a broadcast address, those of any sender are received, because each
device replies from its own address. `udp://:port` receives what anybody sends to this port of this
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

SCHEME = "udp://"  # beginning of an address of such a port
PACKET_MAX = 1500  # most bytes of a datagram that are read: an Ethernet frame
PORT_DIGITS = 5  # most digits of a port's number
LOCKS = Path("/tmp")
"""Folder of lock files. It is the same for all users and terminals, whatever TMPDIR is."""
REFUSALS_MAX = 3
"""Maximum number of attempts to send a datagram.

Each attempt may report the refusal of an earlier datagram.
"""


def address_of(name: str) -> tuple[str, int] | None:
    """Return the host and the port number of `udp://host:port`.

    None if the name has another form, or the host or port number is invalid.
    """
    host, _, digits = name.removeprefix(SCHEME).rpartition(":")
    port = _port_number(digits)
    if not name.startswith(SCHEME) or not host or port is None:
        return None
    try:
        host.encode("idna")  # as the system's resolver is asked
    except UnicodeError:  # an empty or too long label, as in a..b
        return None
    return host, port


def heard_at(name: str) -> int | None:
    """Return the port number of `udp://:port`, on which this computer listens.

    None if the name has another form.
    """
    to_all = f"{SCHEME}:"
    return _port_number(name.removeprefix(to_all)) if name.startswith(to_all) else None


def _port_number(digits: str) -> int | None:
    """Parse the number of a port. None if the text is not a number."""
    if not (digits.isascii() and digits.isdecimal()) or len(digits) > PORT_DIGITS:
        return None
    number = int(digits)
    return number if 0 < number < 65536 else None


def lock_file(name: str) -> Path:
    """Return the file that a program locks while it uses the port of this name."""
    tag = hashlib.sha256(name.encode()).hexdigest()[:16]
    return LOCKS / f"tetractl-udp-{tag}.lock"


def _open_lock(path: Path) -> int:
    """Open a lock file in a folder that others can also write to, and return its descriptor.

    A link, which would lead to a file of somebody else's choice, is refused, and so is anything
    that is not a file. The file is opened for reading, which is enough for a lock: it may belong to
    another user who shares the robots.

    Raises:
        OSError: If it cannot be opened.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        file = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o644)
    except FileExistsError:
        file = os.open(path, flags)
    else:
        os.fchmod(file, 0o644)  # other users can read it, whatever this user's umask
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(errno.EINVAL, "is not a regular file")
    return file


def hold(name: str) -> int:
    """Lock the name of devices on the network, so that no other program can use them.

    Args:
        name: An address, such as udp://HOST:PORT.

    Returns:
        The descriptor of the locked file; closing it ends the lock.

    Raises:
        PortHeldError: If another program has locked the name.
        AbortError: If the file cannot be locked.
    """
    lock = lock_file(name)
    file = -1
    try:
        file = _open_lock(lock)
        take_lock(file)
    except OSError as error:
        if file >= 0:
            os.close(file)
        if isinstance(error, BlockingIOError):
            raise PortHeldError(str(lock), name) from None
        why = "is a link" if error.errno == errno.ELOOP else error.strerror
        raise AbortError(
            f"{lock}: this lock file of {name} cannot be used: {why}",
            "remove the file if it exists; otherwise, give this user permission to "
            f"write to the folder {LOCKS}",
        ) from None
    return file


class UdpPort(SerialPort):
    """The devices at `udp://host:port`, as a port.

    The system may report that nobody received a datagram. Such a refusal belongs to an earlier
    datagram, so the port does not fail: the device may be starting, or be out of the network's
    reach. The refusal is remembered until data arrives, because only some of many datagrams are
    refused. An empty datagram, which anybody may send, is ignored.

    Args:
        name: The address, `udp://host:port`.
        baud: Without meaning here.
        device: What is connected, for messages.
        clock: The clock for times.
        on_received: Called with received bytes and their time [ns]; see `SerialPort`.
        hint: The hint of the errors raised.
    """

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
    ) -> None:
        super().__init__(name, baud, device, clock, on_received, hint)
        self._socket: socket.socket | None = None
        self._to: Any = None  # host and port
        self._no_listener = f"no device listens at the address {name}"
        self._locked: list[int] = []
        """Descriptors of the lock files that this port has locked."""

    def open(self, alone: bool = True) -> None:
        """Open a socket and start to read.

        The name is locked before it is resolved, so that a run that uses it is noticed even if no
        name can be resolved. Then the address is locked, which another program may know under
        another name.

        Raises:
            PortHeldError: If `alone` is True and another program uses the devices at this address.
        """
        listening_port = heard_at(self._name)
        if listening_port is not None:
            self._listen(listening_port)
            return
        address = address_of(self._name)
        if address is None:
            raise AbortError(f"{self._name}: must be {SCHEME}HOST:PORT, or {SCHEME}:PORT to listen")
        if alone:
            self._locked.append(hold(self._name))
        try:
            self._to = socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        except OSError as error:
            why = f"{self._name}: {error.strerror}"
            raise AbortError(
                why, "is the address right, and is this computer connected to the network?"
            ) from None
        host, port = self._to
        resolved_name = f"{SCHEME}{host}:{port}"
        if alone and resolved_name != self._name:
            self._locked.append(hold(resolved_name))
        self._listen(0)

    def _listen(self, port: int) -> None:
        """Read from a port of this computer. The number 0 means any free port.

        Raises:
            AbortError: If another program reads from it.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.05)
        try:
            self._socket.bind(("", port))
        except OSError as error:
            why = f"{self._name}: {error.strerror}"
            raise AbortError(why, "does another program already listen on this port?") from None
        if self._to is not None and not ipaddress.ip_address(self._to[0]).is_multicast:
            try:
                self._socket.connect(self._to)  # what others send is not heard
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
        with self._sending:
            if self.failure or self._socket is None:
                raise AbortError(self.failure or f"{self._name} is not open", self._hint)
            if self._to is None:
                return self._clock.now()
            try:
                self._send(self._socket, data)
            except OSError as error:
                raise self._fail(f"cannot be reached: {error.strerror or error}") from None
            return self._clock.now()

    def _send(self, sender: socket.socket, data: bytes) -> None:
        """Send a datagram, and try again up to REFUSALS_MAX times.

        The system may report a refusal that belongs to an earlier datagram, for example while a
        robot starts up.

        Raises:
            AbortError: If every attempt is refused.
        """
        for _ in range(REFUSALS_MAX):
            try:
                sender.sendto(data, self._to)
            except ConnectionRefusedError:
                self.refusal = self._no_listener
            else:
                return
        raise AbortError(self._no_listener, self._hint)

    def close(self) -> None:
        """End the reader's thread, close the socket and release the locks.

        It may be called twice and never raises.
        """
        super().close()
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        while self._locked:
            os.close(self._locked.pop())

    def _read(self) -> None:
        while not self._closing.is_set():
            data = self._received()
            if data:
                self._on_received(data, self._clock.now())

    def _received(self) -> bytes:
        """Wait at most 0.05 s for a datagram, and return it.

        Empty if none arrives, or if the system reports that an earlier datagram was refused.
        """
        assert self._socket is not None
        try:
            data = self._socket.recv(PACKET_MAX)
        except TimeoutError:
            return b""
        except ConnectionRefusedError:
            self.refusal = self._no_listener
            return b""
        except OSError as error:
            self.refusal = f"{self._name}: {error.strerror or error}"
            self._closing.wait(0.05)  # it may come again at once
            return b""
        self.refusal = None
        return data


def open_port(
    name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
) -> SerialPort:
    """Create the port with this name, without opening it.

    It is a UDP port for `udp://...`, and a serial port otherwise.

    Args:
        name: Name of the port.
        baud: Speed [bits per second]. Without meaning for UDP.
        device: What is connected to it, for messages.
        clock: The clock for times.
        on_received: Called with received bytes and their time [ns].
        hint: The hint of the errors raised.
    """
    make = UdpPort if name.startswith(SCHEME) else SerialPort
    return make(name, baud, device, clock, on_received, hint)
