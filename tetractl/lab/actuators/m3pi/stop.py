"""The emergency stop by itself: needs a port, nothing else."""

from collections.abc import Sequence

from tetractl.core.clock import SECOND, MonotonicClock
from tetractl.experiment.lab import Radio
from tetractl.lab.actuators.m3pi import slave
from tetractl.lab.actuators.m3pi.broadcast import Command, Flag, encode_command
from tetractl.lab.actuators.xbee.link import Link

TIMES = 10
GAP_NS = SECOND // 50


def stop_all(radio: Radio, addresses: Sequence[int] = ()) -> int:
    """Tell every robot in reach to stop, ten times over 200 ms; return how many frames left.

    The mbed firmware latches its emergency stop on a broadcast frame; the serial-slave program
    stops on bytes of its own, sent to each address and to all. The module is not checked: a
    wrong module is better than no stop.
    """
    clock = MonotonicClock()
    link = Link(radio, clock)
    sent = 0
    try:
        link.open(checked=False)
        for i in range(TIMES):
            # both kinds of robots ignore what is meant for the other
            link.send(encode_command(Command(i, Flag.EMERGENCY_STOP)))
            link.send(slave.SIGNATURE_REQUEST + slave.STOP)
            for address in addresses:
                link.send(slave.SIGNATURE_REQUEST + slave.STOP, address)
            sent += 2 + len(addresses)
            clock.sleep_until(clock.now() + GAP_NS)
    finally:
        link.close()
    return sent
