"""A network and serial ports in memory, between an emulated lab and the program that drives it.

Each connection has two ends in this process: the end of the emulated device, and *our* end, which
the program uses. What one end writes, the other can read at once, byte for byte as on a real wire.
Nothing is lost or late. Nothing here waits or starts a thread: a `LabClock` lets the two ends read
in turn.

    network = MemoryNetwork()
    radio = network.port("/dev/ttyUSB0")                  the device's end of a serial port
    radio.plug()
    ours = network.serial("/dev/ttyUSB0", 57600, ...)     our end, used like a `SerialPort`
    ours.open()
    ours.write(b"AT")
    radio.read()                                          b"AT"
"""

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import PortHeldError, SerialPort, is_network, missing_port_error
from tetractl_emulator.port import PseudoPort

FIRST_FREE_PORT = 40_000
"""The first number for UDP sockets that are bound to any free port."""


class MemoryNetwork:
    """A set of connections in memory.

    Attributes:
        sockets: The bound sockets, by address.
        ports: The devices' ends of plugged-in ports, by the name that programs open.
    """

    def __init__(self) -> None:
        self.sockets: dict[tuple[str, int], MemorySocket] = {}
        self.ports: dict[str, MemoryPort] = {}

    def bound_socket(self, host: str, port: int) -> "MemorySocket":
        """Create a UDP socket in memory that listens at an address.

        Port 0 is replaced by a free port.
        """
        opened = MemorySocket(self)
        opened.bind((host, port))
        return opened

    def port(self, link: Path | str) -> "MemoryPort":
        """Create a device's end of the port `link`. It is not plugged in yet."""
        return MemoryPort(self, link)

    def serial(self, name: str, baud: int, *rest: Any) -> "MemorySerial":
        """Create our end of the port `name`. The arguments are those of `SerialPort`."""
        return MemorySerial(self, name, baud, *rest)


class MemorySocket:
    """A UDP socket in memory. Its methods are those of `socket.socket`."""

    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network
        self._name = ("", 0)
        self._queue = deque[tuple[bytes, tuple[str, int]]]()

    def setsockopt(self, *option: Any) -> None:
        """Do nothing: a network in memory has no options."""

    def setblocking(self, blocking: bool) -> None:
        """Do nothing: `recvfrom` never waits."""

    def getsockname(self) -> tuple[str, int]:
        """Return the address at which the socket listens: host and port. ("", 0) before `bind`."""
        return self._name

    def fileno(self) -> int:
        """Return a number that identifies the socket in its network: its port. 0 before `bind`."""
        return self._name[1]

    def bind(self, address: tuple[str, int]) -> None:
        """Listen at an address. Port 0 is replaced by a free port."""
        host, port = address
        highest_port = max((used_port for _, used_port in self._network.sockets), default=0)
        self._name = (host, port or max(highest_port + 1, FIRST_FREE_PORT))
        self._network.sockets[self._name] = self

    def sendto(self, data: bytes, to: Sequence[Any]) -> None:
        """Send a datagram to an address. It is lost if no socket listens there.

        A socket that is bound to the host "" receives datagrams to its port at any host.
        """
        host, port, *_ = to
        sockets = self._network.sockets
        receiver = sockets.get((host, port)) or sockets.get(("", port))
        if receiver is not None:
            receiver._queue.append((bytes(data), self._name))

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        """Return the oldest waiting datagram, cut to `size` bytes, and its sender's address.

        Raises:
            BlockingIOError: If no datagram is waiting.
        """
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        return data[:size], sender

    def close(self) -> None:
        """Stop listening. This method can be called repeatedly."""
        self._network.sockets.pop(self._name, None)


class MemoryPort(PseudoPort):
    """The device's end of a serial port, or of an address such as udp://HOST:PORT, in memory.

    Attributes:
        fd: A positive number while the port is plugged in, otherwise -1.
        ours: Our end while it is open. None otherwise.
        is_stalled: Whether the port refuses bytes from our end.
    """

    def __init__(self, network: MemoryNetwork, link: Path | str) -> None:
        super().__init__(link)
        self._network = network
        self._is_network = is_network(self.name)
        self._waiting_data = deque[bytes]()  # data that the device has not read yet
        self.ours: MemorySerial | None = None
        self.is_stalled = False

    def plug(self) -> None:
        """Plug the port in, so that programs can open it by its name.

        It replaces a port of the same name.
        """
        ports = self._network.ports
        self.fd = 1 + max((port.fd for port in ports.values()), default=2)
        ports[self.name] = self

    def unplug(self) -> None:
        """Unplug the port. If our end is open, it fails. This method can be called repeatedly."""
        self.fd = -1
        self._waiting_data.clear()
        self._network.ports.pop(self.name, None)
        if self.ours is not None:
            self.ours.hear(b"")

    def set_stalled(self, is_stalled: bool) -> None:
        """Refuse bytes from our end if `is_stalled`, or accept bytes again."""
        self.is_stalled = is_stalled

    def baud(self) -> int | None:
        """Return the speed that our end has set [bits/s].

        It is 0 if our end is closed, and None if the port is a network address.
        """
        if self._is_network:
            return None
        return self.ours.bits_a_second if self.ours else 0

    def take(self, data: bytes) -> None:
        """Queue bytes that our end of the port has written, until the device reads them."""
        self._waiting_data.append(data)

    def read(self) -> bytes:
        """Return all bytes that our end has written, or the next datagram of a network.

        It returns b"" if there is nothing.
        """
        if not self._waiting_data:
            return b""
        if self._is_network:
            return self._waiting_data.popleft()
        data = b"".join(self._waiting_data)
        self._waiting_data.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes to our end. They are lost if it is closed."""
        if self.fd >= 0 and self.ours is not None:
            self.ours.hear(data)


class MemorySerial(SerialPort):
    """Our end of a serial port in memory. It has no thread.

    Args:
        network: The network in memory.
        name: Name of the port.
        baud: Its speed [bits per second].
        rest: The further arguments of `SerialPort`.

    Attributes:
        bits_a_second: Speed of the port [bits/s].
    """

    def __init__(self, network: MemoryNetwork, name: str, baud: int, *rest: Any) -> None:
        super().__init__(name, baud, *rest)
        self._network = network
        self._device_end: MemoryPort | None = None  # None while it is closed
        self.bits_a_second = baud

    def open(self, exclusive: bool = True) -> None:
        """Open the port; see `SerialPort.open`. If `exclusive`, it must not be open already."""
        device_end = self._network.ports.get(str(self._name))
        if device_end is None:
            raise missing_port_error(self._name, self._device)
        if device_end.ours is not None and exclusive:
            raise PortHeldError(str(self._name))
        device_end.ours = self
        self._device_end = device_end

    def write(self, data: bytes) -> int:
        """Send bytes to the device; see `SerialPort.write`.

        Returns:
            The time at which they were sent [ns].

        Raises:
            AbortError: If the port has failed, is closed or takes no bytes.
        """
        if self.failure or self._device_end is None:
            raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
        if self._device_end.is_stalled:
            raise self._fail(f"accepts no more bytes: {self._device} is stuck")
        self._device_end.take(data)
        return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Set the speed of the port [bits/s], which the device can read."""
        self.bits_a_second = baud

    def close(self) -> None:
        """Close the port. This method can be called repeatedly."""
        if self._device_end is not None:
            self._device_end.ours = None
        self._device_end = None

    def hear(self, data: bytes) -> None:
        """Pass on bytes from the device to the program, with the present time.

        Empty bytes mean that the device was unplugged: the port has then failed.
        """
        if not data:
            self._fail("is gone: Input/output error")
        self._on_received(data, self._clock.now())
