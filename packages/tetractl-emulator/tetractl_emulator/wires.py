"""The wires between an emulated lab and the programs that use it."""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock, MonotonicClock
from tetractl.core.errors import TetractlError
from tetractl.lab.serial_port import Ports
from tetractl_emulator.port import PseudoPort


def bound_udp(address: str, port: int) -> socket.socket:
    """Return a UDP socket bound to an address; TetractlError if the port is in use."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.setblocking(False)
        bound.bind((address, port))
    except OSError as error:
        bound.close()
        raise TetractlError(
            f"cannot open UDP {address}:{port}: {error.strerror}",
            hint="is another emulation or Motive running? Choose other ports with --command-port "
            "and --data-port; 0 takes any free port",
        ) from None
    return bound


def _network_camera(*arguments: Any, **settings: Any) -> Any:
    from tetractl_emulator.pictures.stream_side import EmulatedNetworkCamera  # imports OpenCV

    return EmulatedNetworkCamera(*arguments, **settings)


@dataclass(frozen=True, slots=True)
class Wires:
    """Functions that make the ends of connections; by default those of this computer, in real time.

    Of the emulation: `port` makes a serial port from the name that programs open, `bound` a UDP
    socket at an address and port, `network_camera` a camera from the arguments of
    EmulatedNetworkCamera, and `clock` its clock. Of programs: `ports` and `make_socket`, None for
    the devices' own.
    """

    clock: Callable[[], Clock] = MonotonicClock
    port: Callable[[Path], PseudoPort] = PseudoPort
    bound: Callable[[str, int], Any] = bound_udp
    network_camera: Callable[..., Any] = _network_camera
    ports: Ports | None = None
    make_socket: Callable[[Callable[[], None]], Any] | None = None
