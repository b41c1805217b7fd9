"""A port to devices that take UDP datagrams, used as a serial port: `udp://host:port`.

A datagram to a broadcast address reaches all devices of a network. Nothing tells whether a datagram
arrives. `udp://:port` hears what anybody sends to this port of this computer, and sends nothing.
"""

import fcntl
import socket
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import Heard, PortHeldError, SerialPort

SCHEME = "udp://"
DATAGRAM_MAX = 1500


def address_of(name: str) -> tuple[str, int] | None:
    """Return host and port of `udp://host:port`; None if the name is not of this form."""
    host, colon, port = name.removeprefix(SCHEME).rpartition(":")
    right = name.startswith(SCHEME) and host and colon and port.isascii() and port.isdecimal()
    return (host, int(port)) if right and 0 < int(port) < 65536 else None


def heard_at(name: str) -> int | None:
    """Return the port of `udp://:port`; None if the name is not of this form."""
    address = address_of(name.replace(f"{SCHEME}:", f"{SCHEME}all:", 1))
    return address[1] if address is not None and name.startswith(f"{SCHEME}:") else None


def lock_file(name: str) -> Path:
    """Return the file that a program locks while it uses the port of this name."""
    safe = "".join(c if c.isalnum() or c in ".-" else "_" for c in name.removeprefix(SCHEME))
    return Path(tempfile.gettempdir()) / f"tetractl-udp-{safe}.lock"


class UdpPort(SerialPort):
    """The devices at `udp://host:port`; see SerialPort, whose `baud` has no meaning here."""

    def __init__(
        self, name: str, baud: int, device: str, clock: Clock, heard: Heard, hint: str
    ) -> None:
        super().__init__(name, baud, device, clock, heard, hint)
        self._socket: socket.socket | None = None
        self._address: Any = None
        self._lock = lock_file(name)
        self._locked = None

    def open(self, alone: bool = True) -> None:
        """Open a socket and start to read; PortHeldError if `alone` and another program uses the
        devices at this address."""
        if (own := heard_at(self._name)) is not None:
            self._listen(own)
            return
        address = address_of(self._name)
        if address is None:
            raise AbortError(f"{self._name}: must be {SCHEME}HOST:PORT, or {SCHEME}:PORT to listen")
        if alone:
            self._locked = self._lock.open("a")
            try:
                fcntl.flock(self._locked, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self._locked.close()
                raise PortHeldError(str(self._lock), self._name) from None
        try:
            self._address = socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        except OSError as error:
            why = f"{self._name}: {error.strerror}"
            raise AbortError(why, "is the address right, and is this computer online?") from None
        self._listen(0)

    def _listen(self, own: int) -> None:
        """Read from a port of this computer, 0 for any; AbortError if another program does."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.settimeout(0.05)
        try:
            self._socket.bind(("", own))
        except OSError as error:
            why = f"{self._name}: {error.strerror}"
            raise AbortError(why, "does another program listen at this port?") from None
        self._thread.start()

    def write(self, data: bytes) -> int:
        """Send a datagram; return the time when the system accepted it [ns]."""
        with self._sending:
            if self.failure or self._socket is None:
                raise AbortError(self.failure or f"{self._name} is not open", self._hint)
            if self._address is None:
                return self._clock.now()
            try:
                self._socket.sendto(data, self._address)
            except OSError as error:
                raise self._fail(f"cannot be reached: {error.strerror or error}") from None
            return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Do nothing: a network has no baud rate."""

    def close(self) -> None:
        """End the reader's thread and close the socket; may be called twice, never raises."""
        super().close()
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._locked is not None:
            self._locked.close()

    def _read(self) -> None:
        assert self._socket is not None
        while not self._closing.is_set():
            with suppress(TimeoutError, ConnectionError):
                self._heard(self._socket.recv(DATAGRAM_MAX), self._clock.now())


def open_port(
    name: str, baud: int, device: str, clock: Clock, heard: Heard, hint: str
) -> SerialPort:
    """Return the port of this name, not yet opened: UDP for `udp://...`, else a serial port."""
    make = UdpPort if name.startswith(SCHEME) else SerialPort
    return make(name, baud, device, clock, heard, hint)
