"""Connections to toio cubes, shared by the camera and the actuator of a run.

They are shared because a cube accepts only one connection.
"""

import select
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.lab.serial_port import OnReceived, PortFactory, SerialPort
from tetractl.lab.udp_port import SCHEME, UdpPort
from tetractl_toio.messages import SAME_EVENT_S, Characteristic, Unpacker, is_refusal, pack

UDP_HINT = "is `tetractl lab emulate` running in another terminal, with the same spec?"
HINT = (
    "are the cubes on and charged? A cube that is connected to another program is still "
    "driven by that program; all other cubes stop by themselves"
)
SPEED = 1_000_000  # bits a second of Bluetooth Low Energy
Listener = Callable[[int, bytes, int], None]
"""Function that is called with each notification, in a port's thread.

Its arguments are the number of the characteristic, the data and the time of arrival [ns].
"""


class Cubes:
    """Open connections to cubes, by the cubes' names. Times are in ns on `clock`.

    Args:
        clock: The clock for times.
        ports: Creates the port to a cube.
    """

    def __init__(self, clock: Clock, ports: PortFactory) -> None:
        self._ports = ports
        self.emulated = False  # whether a cube has said so
        self._clock = clock
        self._users = 0
        self._links: dict[str, SerialPort] = {}
        self._listeners: dict[str, list[Listener]] = {}

    @property
    def failure(self) -> str | None:
        """The reason why the first unreachable cube is lost.

        The value is None if all cubes can be reached.
        """
        return next((link.failure for link in self._links.values() if link.failure), None)

    def open(self, listeners: Mapping[str, Listener]) -> None:
        """Register listeners, and connect to each cube that is not yet connected.

        Args:
            listeners: For each cube's name, a function that is called with each of its
                notifications.

        Raises:
            AbortError: If a cube cannot be reached.
        """
        self._users += 1
        for cube, listener in listeners.items():
            self._listeners.setdefault(cube, []).append(listener)
            if cube not in self._links:
                link = self._ports(
                    cube, SPEED, "the cube", self._clock, self._receiver_of(cube), HINT
                )
                self._links[cube] = link
                link.open()

    def send(self, cube: str, characteristic: Characteristic, data: bytes = b"") -> int:
        """Write a value to a cube, or ask the cube for a value.

        Args:
            cube: Name of the cube.
            characteristic: The characteristic to write or read.
            data: The value to write. Empty to ask for the value.

        Returns:
            The time at which the message was sent [ns].

        Raises:
            AbortError: If the cube cannot be reached.
        """
        return self._links[cube].write(pack(characteristic, data))

    def close(self) -> bool:
        """Unregister one user, and disconnect from all cubes if it was the last. Never raises.

        Returns:
            Whether the cubes were disconnected.
        """
        self._users -= 1
        if self._users == 0:
            for link in self._links.values():
                link.close()
        return self._users == 0

    def _receiver_of(self, cube: str) -> OnReceived:
        """Create the callback for bytes from a cube.

        It passes each complete message to the cube's listeners. If several messages of one
        characteristic arrive together, it passes only the last one. A refused setting is recorded
        as the cube's failure.
        """
        unpacker = Unpacker()

        def receive(data: bytes, at_ns: int) -> None:
            messages = list(unpacker.feed(data))
            for characteristic, payload in messages:
                if characteristic == Characteristic.EMULATED:
                    self.emulated = True
                if characteristic == Characteristic.CONFIGURATION and is_refusal(payload):
                    self._links[
                        cube
                    ].failure = f"cube {cube} refuses a setting: it answered {payload.hex()}"
            # of what came together, the earlier is as old as the connection's events are apart
            for characteristic, payload in dict(messages).items():
                for listener in self._listeners.get(cube, ()):
                    listener(characteristic, payload, at_ns)

        return receive


_RUNS: dict[Clock, Cubes] = {}
"""The connections of each run while they are open, by its clock: what its devices share."""


class CubesLink:
    """One device's access to the connections of the run that uses this clock.

    Args:
        clock: The clock of the run. Devices with the same clock share their connections.
        cubes: Names of the device's cubes.
        ports: Creates the port to a cube. None for the default, `make_port`.
        on_received: Called with each notification: the cube's index in `cubes`, the characteristic,
            the data and the time of arrival [ns].
    """

    def __init__(
        self,
        clock: Clock,
        cubes: Sequence[str],
        ports: PortFactory | None,
        on_received: Callable[[int, int, bytes, int], None],
    ) -> None:
        self.cubes = cubes
        self._clock = clock
        self._ports = ports
        self._on_received = on_received
        self._run: Cubes | None = None

    @property
    def failure(self) -> str | None:
        """The reason why a cube can no longer be reached.

        It is None if all cubes can be reached, or if the connections are not open.
        """
        return None if self._run is None else self._run.failure

    @property
    def emulated(self) -> bool:
        """Whether a cube has reported that it is emulated.

        False if the connections are not open.
        """
        return self._run is not None and self._run.emulated

    def open(self) -> None:
        """Connect to the device's cubes.

        Raises:
            AbortError: If a cube cannot be reached.
        """
        self._run = _RUNS.setdefault(self._clock, Cubes(self._clock, self._ports or make_port))
        self._run.open({cube: partial(self._on_received, i) for i, cube in enumerate(self.cubes)})

    def close(self) -> None:
        """Stop using the connections. This method can be called repeatedly and never raises."""
        run = self._run
        self._run = None
        if run is not None and run.close():
            del _RUNS[self._clock]

    def send(self, cube: str, characteristic: Characteristic, data: bytes = b"") -> int:
        """Write a value to a cube, or ask for one if `data` is empty; see `Cubes.send`.

        Raises:
            AbortError: If the connections are not open.
        """
        if self._run is None:
            raise AbortError(f"cube {cube} is not connected", HINT)
        return self._run.send(cube, characteristic, data)


class EmulatedCubePort(UdpPort):
    """The UDP port to an emulated cube.

    Datagrams that arrive within SAME_EVENT_S are passed on together. On a busy computer, datagrams
    wait before they are read. Without this grouping, an old reading that has waited would count as
    a new reading.
    """

    def _read(self) -> None:
        assert self._socket is not None
        while not self._closing.is_set():
            with suppress(TimeoutError, ConnectionError):
                data = self._receive()
                at_ns = self._clock.now()
                self._closing.wait(SAME_EVENT_S)
                while select.select([self._socket], [], [], 0)[0]:
                    data += self._receive()
                self._on_received(data, at_ns)


def make_port(
    name: str, baud: int, device: str, clock: Clock, on_received: OnReceived, hint: str
) -> SerialPort:
    """Create the port to a cube, without opening it; see `tetractl.lab.serial_port.SerialPort`.

    The port uses UDP for an emulated cube, whose name is an address, and Bluetooth otherwise.
    """
    if name.startswith(SCHEME):
        return EmulatedCubePort(name, baud, device, clock, on_received, hint)
    from tetractl_toio.ble import BluetoothPort

    return BluetoothPort(name, baud, device, clock, on_received, hint)
