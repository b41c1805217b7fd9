"""A network and serial ports in memory, between an emulated lab and the program that drives it.

Each wire has two ends in this process: the end of the emulated device, and *our* end, that of the
program. What one end writes, the other can read at once, byte for byte as on real wires. Nothing is
lost or late. Nothing here waits or has a thread: a `LabClock` lets the two ends read in turn.

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
from tetractl.lab.serial_port import PortHeldError, SerialPort, is_network, missing_port
from tetractl_emulator.port import PseudoPort

FIRST_FREE = 40_000
"""The first number of a UDP port that is bound to any free one."""


class MemoryNetwork:
    """The ends of wires in memory.

    They are the bound `sockets`, by their addresses, and the plugged `ports`, by the names that
    programs open.
    """

    def __init__(self) -> None:
        self.sockets: dict[tuple[str, int], MemorySocket] = {}
        self.ports: dict[str, MemoryPort] = {}

    def bound_socket(self, host: str, port: int) -> "MemorySocket":
        """Return a UDP socket that listens at an address."""
        opened = MemorySocket(self)
        opened.bind((host, port))
        return opened

    def port(self, link: Path | str) -> "MemoryPort":
        """Return a device's end of the port `link`, not plugged in yet."""
        return MemoryPort(self, link)

    def serial(self, name: str, baud: int, *rest: Any) -> "MemorySerial":
        """Return our end of the port `name`, from the arguments of a `SerialPort`."""
        return MemorySerial(self, name, baud, *rest)


class MemorySocket:
    """A UDP socket of a network in memory, with the methods of `socket.socket`."""

    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network
        self._name = ("", 0)
        self._queue = deque[tuple[bytes, tuple[str, int]]]()

    def setsockopt(self, *option: Any) -> None:
        """Do nothing: a network in memory has no options."""

    def setblocking(self, blocking: bool) -> None:
        """Do nothing: `recvfrom` never waits."""

    def getsockname(self) -> tuple[str, int]:
        """Return the address at which the socket listens."""
        return self._name

    def fileno(self) -> int:
        """Return a number that no other socket of the network has: its port."""
        return self._name[1]

    def bind(self, address: tuple[str, int]) -> None:
        """Listen at an address; port 0 is any free port."""
        host, port = address
        highest = max((taken for _, taken in self._network.sockets), default=0)
        self._name = (host, port or max(highest + 1, FIRST_FREE))
        self._network.sockets[self._name] = self

    def sendto(self, data: bytes, to: Sequence[Any]) -> None:
        """Send a datagram to an address, or to a socket that is bound to all addresses."""
        host, port, *_ = to
        sockets = self._network.sockets
        receiver = sockets.get((host, port)) or sockets.get(("", port))
        if receiver is not None:
            receiver._queue.append((bytes(data), self._name))

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        """Return the oldest datagram and its sender's address.

        Raises:
            BlockingIOError: If no datagram waits.
        """
        if not self._queue:
            raise BlockingIOError
        data, sender = self._queue.popleft()
        return data[:size], sender

    def close(self) -> None:
        """Stop listening."""
        self._network.sockets.pop(self._name, None)


class MemoryPort(PseudoPort):
    """A device's end of a serial port, or of an address such as udp://HOST:PORT, in memory.

    It is plugged in while `fd` is not negative, connected while our end `ours` is open, and may be
    `stalled`: then it takes no bytes.
    """

    def __init__(self, network: MemoryNetwork, link: Path | str) -> None:
        super().__init__(link)
        self._network = network
        self._is_network = is_network(self.name)
        self._taken = deque[bytes]()  # what our end has written, a datagram or a write each
        self.ours: MemorySerial | None = None
        self.stalled = False

    def plug(self) -> None:
        """Make the port known by its name."""
        ports = self._network.ports
        self.fd = 1 + max((port.fd for port in ports.values()), default=2)
        ports[self.name] = self

    def unplug(self) -> None:
        """Remove the port; our end fails. May be called twice."""
        self.fd = -1
        self._taken.clear()
        self._network.ports.pop(self.name, None)
        if self.ours is not None:
            self.ours.hear(b"")

    def stall(self, stalled: bool) -> None:
        """Refuse bytes, or accept them again."""
        self.stalled = stalled

    def baud(self) -> int | None:
        """Return the speed that our end has set [bits per second].

        It is 0 if our end is closed, and None for a network.
        """
        if self._is_network:
            return None
        return self.ours.bits_a_second if self.ours else 0

    def take(self, data: bytes) -> None:
        """Take what our end writes."""
        self._taken.append(data)

    def read(self) -> bytes:
        """Return the bytes that our end has written. On a network, return the next datagram."""
        if not self._taken:
            return b""
        if self._is_network:
            return self._taken.popleft()
        data = b"".join(self._taken)
        self._taken.clear()
        return data

    def write(self, data: bytes) -> None:
        """Pass bytes to our end, if it is open."""
        if self.fd >= 0 and self.ours is not None:
            self.ours.hear(data)


class MemorySerial(SerialPort):
    """Our end of a serial port in memory, without a thread.

    Args:
        network: The network in memory.
        name: Name of the port.
        baud: Its speed [bits per second].
        rest: The further arguments of `SerialPort`.
    """

    def __init__(self, network: MemoryNetwork, name: str, baud: int, *rest: Any) -> None:
        super().__init__(name, baud, *rest)
        self._network = network
        self._devices_end: MemoryPort | None = None  # None while it is closed
        self.bits_a_second = baud

    def open(self, alone: bool = True) -> None:
        """Open the port as SerialPort does."""
        devices_end = self._network.ports.get(str(self._name))
        if devices_end is None:
            raise missing_port(self._name, self._device)
        if devices_end.ours is not None and alone:
            raise PortHeldError(str(self._name))
        devices_end.ours = self
        self._devices_end = devices_end

    def write(self, data: bytes) -> int:
        """Send bytes as SerialPort does; return the time [ns]."""
        if self.failure or self._devices_end is None:
            raise AbortError(self.failure or f"the port {self._name} is not open", self._hint)
        if self._devices_end.stalled:
            raise self._fail(f"takes no more bytes: {self._device} is stuck")
        self._devices_end.take(data)
        return self._clock.now()

    def set_baud(self, baud: int) -> None:
        """Change the speed [bits per second]."""
        self.bits_a_second = baud

    def close(self) -> None:
        """Close the port; may be called twice."""
        if self._devices_end is not None:
            self._devices_end.ours = None
        self._devices_end = None

    def hear(self, data: bytes) -> None:
        """Receive bytes from the device; fail if there are none, since it was unplugged."""
        if not data:
            self._fail("is gone: Input/output error")
        self._on_received(data, self._clock.now())
