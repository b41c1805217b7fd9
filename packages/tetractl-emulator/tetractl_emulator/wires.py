"""Connections between an emulated lab and the program that drives it.

By default, they are sockets and pseudo-terminals of this computer, in real time. `virtual_lab`
creates other `Wires`, in memory.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock, MonotonicClock
from tetractl.core.errors import TetractlError
from tetractl.lab.serial_port import PortFactory
from tetractl_emulator.emulated_udp import make_port
from tetractl_emulator.port import PseudoPort


def bound_udp(address: str, port: int) -> socket.socket:
    """Create a non-blocking UDP socket that is bound to an address and port.

    Raises:
        TetractlError: If the port is in use.
    """
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


@dataclass(frozen=True, slots=True)
class Wires:
    """Functions that create the two ends of each connection.

    Attributes:
        clock: Creates the emulation's clock.
        port: Creates the device's end of a port, from the name by which programs open the port.
        bound: Creates the device's UDP socket and binds it to an address and port.
        http: Whether cameras serve images over HTTP. If not, they pass images in memory.
        ports: Creates the program's end of a port. None for the default of the program's device.
        make_socket: Creates the program's UDP socket; its argument is called when data may have
            arrived. None for the default of the program's device.
    """

    clock: Callable[[], Clock] = MonotonicClock
    port: Callable[[Path | str], PseudoPort] = make_port
    bound: Callable[[str, int], Any] = bound_udp
    http: bool = True
    ports: PortFactory | None = None
    make_socket: Callable[[Callable[[], None]], Any] | None = None
