"""The connections to toio cubes, which the camera and the actuator of a run share.

The devices share the connections because a cube accepts only one connection.
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
CONNECTION_HINT = (
    "are the cubes on and charged? A cube that is connected to another program is still "
    "driven by that program; all other cubes stop by themselves"
)
BITS_PER_S = 1_000_000
"""Bit rate of Bluetooth Low Energy [bit/s]."""
Listener = Callable[[int, bytes, int], None]
"""A function that is called with each notification of a cube, in the thread of the cube's port.

The arguments are the number of the characteristic, the data and the time of arrival [ns].
"""


class CubeConnections:
    """The connections of a run to its cubes.

    Args:
        clock: The clock of all times.
        create_port: Function that creates the port to a cube.
    """

    def __init__(self, clock: Clock, create_port: PortFactory) -> None:
        self._create_port = create_port
        self.emulated = False  # whether a cube has reported that it is emulated
        self._clock = clock
        self._user_count = 0
        self._port_by_cube: dict[str, SerialPort] = {}
        self._listeners_by_cube: dict[str, list[Listener]] = {}

    @property
    def failure(self) -> str | None:
        """The reason why a cube can no longer be reached. None if all cubes can be reached."""
        return next((port.failure for port in self._port_by_cube.values() if port.failure), None)

    def open(self, listeners: Mapping[str, Listener]) -> None:
        """Register listeners, and connect to each cube that is not yet connected.

        Args:
            listeners: For each cube's name, a function that is called with each of its
                notifications.

        Raises:
            AbortError: If a cube cannot be reached.
        """
        self._user_count += 1
        for cube, listener in listeners.items():
            self._listeners_by_cube.setdefault(cube, []).append(listener)
            if cube not in self._port_by_cube:
                port = self._create_port(
                    cube,
                    BITS_PER_S,
                    "the cube",
                    self._clock,
                    self._create_receiver(cube),
                    CONNECTION_HINT,
                )
                self._port_by_cube[cube] = port
                port.open()

    def send(self, cube: str, characteristic: Characteristic, data: bytes = b"") -> int:
        """Write a value to a characteristic of a cube, or ask the cube for its value.

        Args:
            cube: Name of the cube.
            characteristic: The characteristic to write or read.
            data: The value to write. Empty to ask for the value.

        Returns:
            The time at which the message was sent [ns].

        Raises:
            AbortError: If the cube cannot be reached.
        """
        return self._port_by_cube[cube].write(pack(characteristic, data))

    def close(self) -> bool:
        """Unregister a user, and disconnect from all cubes if no user is left. Never raises.

        Returns:
            Whether the cubes were disconnected.
        """
        self._user_count -= 1
        if self._user_count == 0:
            for port in self._port_by_cube.values():
                port.close()
        return self._user_count == 0

    def _create_receiver(self, cube: str) -> OnReceived:
        """Create the function that a port calls with bytes from a cube.

        The function passes each complete message to the cube's listeners. If several messages of
        one characteristic arrive together, the listeners get only the last message. A refused
        setting is recorded as the cube's failure.
        """
        unpacker = Unpacker()

        def receive(data: bytes, arrival_ns: int) -> None:
            messages = list(unpacker.feed(data))
            for characteristic, payload in messages:
                if characteristic == Characteristic.EMULATED:
                    self.emulated = True
                if characteristic == Characteristic.CONFIGURATION and is_refusal(payload):
                    self._port_by_cube[
                        cube
                    ].failure = f"cube {cube} refuses a setting: it answered {payload.hex()}"
            # of messages that came together, earlier ones are older by a connection interval
            for characteristic, payload in dict(messages).items():
                for listener in self._listeners_by_cube.get(cube, ()):
                    listener(characteristic, payload, arrival_ns)

        return receive


_CONNECTIONS_BY_CLOCK: dict[Clock, CubeConnections] = {}
"""The open connections of each run, by the run's clock. The devices of a run share them."""


class CubesLink:
    """One device's access to the connections of the run that uses this clock.

    Args:
        clock: The clock of the run. Devices with the same clock share their connections.
        cubes: Names of the device's cubes.
        create_port: Function that creates the port to a cube. None for the default, `make_port`.
        on_received: Called with each notification: the cube's index in `cubes`, the characteristic,
            the data and the time of arrival [ns].
    """

    def __init__(
        self,
        clock: Clock,
        cubes: Sequence[str],
        create_port: PortFactory | None,
        on_received: Callable[[int, int, bytes, int], None],
    ) -> None:
        self.cubes = cubes
        self._clock = clock
        self._create_port = create_port
        self._on_received = on_received
        self._connections: CubeConnections | None = None

    @property
    def failure(self) -> str | None:
        """The reason why a cube can no longer be reached.

        None if all cubes can be reached, or if the connections are not open.
        """
        return None if self._connections is None else self._connections.failure

    @property
    def emulated(self) -> bool:
        """Whether a cube has reported that it is emulated.

        False if the connections are not open.
        """
        return self._connections is not None and self._connections.emulated

    def open(self) -> None:
        """Connect to the device's cubes.

        Raises:
            AbortError: If a cube cannot be reached.
        """
        self._connections = _CONNECTIONS_BY_CLOCK.setdefault(
            self._clock, CubeConnections(self._clock, self._create_port or make_port)
        )
        self._connections.open(
            {cube: partial(self._on_received, i) for i, cube in enumerate(self.cubes)}
        )

    def close(self) -> None:
        """Stop using the connections. This method can be called repeatedly and never raises."""
        connections = self._connections
        self._connections = None
        if connections is not None and connections.close():
            del _CONNECTIONS_BY_CLOCK[self._clock]

    def send(self, cube: str, characteristic: Characteristic, data: bytes = b"") -> int:
        """Write a value to a cube, or ask for its value; see `CubeConnections.send`.

        Raises:
            AbortError: If the connections are not open.
        """
        if self._connections is None:
            raise AbortError(f"cube {cube} is not connected", CONNECTION_HINT)
        return self._connections.send(cube, characteristic, data)


class EmulatedCubePort(UdpPort):
    """The UDP port to an emulated cube.

    The port passes on datagrams together if they arrive within SAME_EVENT_S. On a busy computer,
    datagrams wait before they are read. Without this grouping, an old reading that has waited would
    count as a new reading.
    """

    def _read(self) -> None:
        """Receive datagrams until the port is closed, and pass them on in groups."""
        assert self._socket is not None
        while not self._closing.is_set():
            with suppress(TimeoutError, ConnectionError):
                data = self._receive()
                arrival_ns = self._clock.now()
                self._closing.wait(SAME_EVENT_S)
                while select.select([self._socket], [], [], 0)[0]:
                    data += self._receive()
                self._on_received(data, arrival_ns)


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
