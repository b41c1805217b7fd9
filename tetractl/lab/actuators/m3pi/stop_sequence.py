"""The emergency stop of m3pi robots, which needs only the radio's port."""

from collections.abc import Sequence

from tetractl.core.clock import MonotonicClock
from tetractl.experiment.lab_section import STOP_GAP_NS, STOPS
from tetractl.lab.actuators.m3pi import slave
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, Flag, encode_command
from tetractl.lab.actuators.xbee.hardware import XbeeSection
from tetractl.lab.actuators.xbee.link import Link


def stop_all(module: XbeeSection, addresses: Sequence[int] = (), alone: bool = True) -> str:
    """Send stops to every robot in radio range, ten times over 200 ms; return a summary.

    The mbed firmware latches its emergency stop on a broadcast frame; the serial-slave program
    stops on bytes of its own, sent to each address and to all. The module is not checked, because
    sending through a wrong module is better than no stop. If not `alone`, another process may have
    the port open.
    """
    clock = MonotonicClock()
    link = Link(module, clock)
    sent = 0
    try:
        link.open(checked=False, alone=alone)
        for i in range(STOPS):
            # robots of each kind ignore the bytes meant for the other
            link.send(encode_command(BroadcastCommand(i, Flag.EMERGENCY_STOP)))
            link.send(slave.SIGNATURE_REQUEST + slave.STOP)
            for address in addresses:
                link.send(slave.SIGNATURE_REQUEST + slave.STOP, address)
            sent += 2 + len(addresses)
            clock.sleep_until(clock.now() + STOP_GAP_NS)
    finally:
        link.close()
    return f"sent {sent} stops on {module.port}; switch the robots off and on to drive them again"
