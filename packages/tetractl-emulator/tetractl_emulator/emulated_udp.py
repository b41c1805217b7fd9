"""The emulated device's end of a UDP port, with the interface of a serial port's end."""

import socket
from contextlib import suppress
from pathlib import Path

from tetractl.core.errors import TetractlError
from tetractl.lab.udp_port import DATAGRAM_BYTES_MAX, SCHEME, parse_address, parse_listening_port
from tetractl_emulator.port import PseudoPort


class UdpPlug(PseudoPort):
    """An emulated device that receives datagrams at udp://HOST:PORT, on this computer.

    At udp://:PORT, the device sends to that port without being asked.

    Args:
        name: The address.

    Raises:
        TetractlError: If the address is invalid.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        address = parse_address(name)
        listening_port = parse_listening_port(name)
        if address is None and listening_port is None:
            raise TetractlError(f"{name}: must be {SCHEME}HOST:PORT, or {SCHEME}:PORT to listen")
        self._number = address[1] if address else 0
        self._socket: socket.socket | None = None
        self._sender = None if listening_port is None else ("127.0.0.1", listening_port)
        self._stalled = False

    def plug(self) -> None:
        """Start to listen at the port on 127.0.0.1.

        Raises:
            TetractlError: If the port cannot be opened, for example because it is in use.
        """
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", self._number))
        except OSError as error:
            self._socket.close()
            message = f"cannot open UDP port {self._number} on 127.0.0.1: {error.strerror}"
            raise TetractlError(
                message, hint="is another emulation already running on this port?"
            ) from None
        self.fd = self._socket.fileno()

    def unplug(self) -> None:
        """Stop listening. No program notices this. This method can be called repeatedly."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self.fd = -1

    def set_stalled(self, is_stalled: bool) -> None:
        """Drop all received datagrams if `is_stalled`, or accept datagrams again."""
        self._stalled = is_stalled

    def baud(self) -> None:
        """Return None: a network has no baud rate."""

    def read(self) -> bytes:
        """Return the next datagram, or b"" if there is none, or if the port is stalled.

        Answers then go to the sender of this datagram.
        """
        if self._socket is None:
            return b""
        with suppress(BlockingIOError):
            data, self._sender = self._socket.recvfrom(DATAGRAM_BYTES_MAX)
            return b"" if self._stalled else data
        return b""

    def write(self, data: bytes) -> None:
        """Send a datagram to the program from which the last datagram came.

        The new datagram is lost if there is no such program, or if it cannot be sent.
        """
        if self._socket is not None and self._sender is not None:
            with suppress(OSError):
                self._socket.sendto(data, self._sender)


def make_port(link: Path | str) -> PseudoPort:
    """Create the emulated device's end of a port.

    Args:
        link: The name by which programs open the port: an address udp://HOST:PORT, or a path.
    """
    name = str(link)
    if name.startswith(SCHEME):
        return UdpPlug(name)
    return PseudoPort(link)
