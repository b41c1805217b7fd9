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

    Of the emulation: `port` makes a port from the name that programs open, `bound` a UDP
    socket at an address and port, and `clock` its clock; cameras serve pictures over `http` or in
    memory. Of programs: `ports` and `make_socket`, None for the devices' own.
    """

    clock: Callable[[], Clock] = MonotonicClock
    port: Callable[[Path | str], PseudoPort] = make_port
    bound: Callable[[str, int], Any] = bound_udp
    http: bool = True
    ports: Ports | None = None
    make_socket: Callable[[Callable[[], None]], Any] | None = None
