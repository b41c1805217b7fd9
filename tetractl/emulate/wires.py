"""The wires between an emulated lab and programs: here those of this computer, in real time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock, MonotonicClock
from tetractl.emulate.optitrack.motive import bound_udp
from tetractl.emulate.port import PseudoPort
from tetractl.lab.serial_port import Ports


class Wires:
    """Makes the ends of all connections: sockets, serial ports and network cameras.

    `ports` and `make_socket` make our ends, None for the devices' own way to make them.
    """

    ports: Ports | None = None
    make_socket: Callable[[], Any] | None = None

    def clock(self) -> Clock:
        """Return the clock of a network camera."""
        return MonotonicClock()

    def each_step(self, turn: Callable[[], None]) -> None:
        """Call `turn` in each step of virtual time; in real time a thread has its task."""

    def port(self, link: Path) -> PseudoPort:
        """Return a device's end of a serial port that programs open by the name `link`."""
        return PseudoPort(link)

    def bound(self, address: str, port: int) -> Any:
        """Return a UDP socket at an address; TetractlError if its port is in use."""
        return bound_udp(address, port)

    def network_camera(self, *args: Any, **settings: Any) -> Any:
        """Return a camera from the arguments of EmulatedNetworkCamera; cv2 must be installed."""
        from tetractl.emulate.stream_side import EmulatedNetworkCamera

        return EmulatedNetworkCamera(*args, **settings)
