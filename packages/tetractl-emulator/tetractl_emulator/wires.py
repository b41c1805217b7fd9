"""How an emulated lab and the program that drives it reach each other.

By default by sockets and pseudo-terminals of this computer, in real time; `virtual_lab` makes other
`Wires`, in memory.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.core.clock import Clock, MonotonicClock
from tetractl.core.errors import TetractlError
from tetractl.lab.serial_port import Ports
from tetractl_emulator.emulated_udp import make_port
from tetractl_emulator.port import PseudoPort


def bound_udp(address: str, port: int) -> socket.socket:
    """Return a UDP socket bound to an address.

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
    """Functions that open the ends of connections. By default, they use this computer in real time.

    Attributes:
        clock: Returns the clock of the emulation.
        port: Creates the emulation's end of a port, from the name that programs open.
        bound: Creates the emulation's UDP socket at an address and port.
        http: Whether cameras serve images over HTTP, not in memory.
        ports: Creates the programs' end of a port. None for the devices' own.
        make_socket: Creates the programs' UDP socket. None for the devices' own.
    """

    clock: Callable[[], Clock] = MonotonicClock
    port: Callable[[Path | str], PseudoPort] = make_port
    bound: Callable[[str, int], Any] = bound_udp
    http: bool = True
    ports: Ports | None = None
    make_socket: Callable[[Callable[[], None]], Any] | None = None
