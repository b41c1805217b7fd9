"""Commands for a lab, in this process and in virtual time, on the wires in memory of an emulation.

`virtual_wires` lets what the commands build for a lab find these wires in place of the host's.
"""

import contextlib
from unittest import mock

from tetractl.core.clock import wait_for
from tetractl.emulate.virtual_wires import LabClock
from tetractl.emulate.wires import Wires
from tetractl.lab.cameras.optitrack.camera import OptitrackCamera
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.inner_loop import InnerLoop

PATIENCE_S = 10.0
HOST_CLOCKS = (
    "tetractl.core.clock",
    "tetractl.experiment.lab_section",
    "tetractl.lab.actuators.m3pi.calibrate",
    "tetractl.lab.actuators.m3pi.stop_sequence",
    "tetractl.plant.lab_plant",
)


class PatientClock(LabClock):
    """A clock on which a test waits for what happens."""

    def wait(self, condition, patience_s=PATIENCE_S):
        """Let time pass until a condition holds; return whether it does."""
        return wait_for(self, condition, patience_s)


class TrialClock:
    """A clock that starts at 0 when it is made, as a trial's does; `base` goes on below it."""

    def __init__(self, base):
        self._base, self._start = base, base.now()

    def now(self):
        return self._base.now() - self._start

    def sleep_until(self, when):
        self._base.sleep_until(self._start + when)


class Joined:
    """Our NatNet client on the present wires: the `device` of a section."""

    wires: Wires

    def __new__(cls, section, setup, clock, wake):
        return OptitrackCamera(section, setup, clock, wake, cls.wires.make_socket)


@contextlib.contextmanager
def virtual_wires(wires, clock):
    """Let the lab's code in this process find these wires and this clock in place of the host's."""
    Joined.wires = wires

    def close(loop):
        if loop.turn in clock.steps:
            clock.steps.remove(loop.turn)

    with contextlib.ExitStack() as stack:
        for name, value in (
            *((f"{module}.MonotonicClock", lambda: TrialClock(clock)) for module in HOST_CLOCKS),
            ("tetractl.lab.actuators.xbee.link.SerialPort", wires.ports),
            ("tetractl.lab.actuators.field.driver.SerialPort", wires.ports),
            ("tetractl.lab.serial_port.require_port", lambda name, device: None),
        ):
            stack.enter_context(mock.patch(name, value))
        start = mock.patch.object(InnerLoop, "start", lambda loop: clock.steps.append(loop.turn))
        stack.enter_context(start)
        stack.enter_context(mock.patch.object(InnerLoop, "close", close))
        device = f"{__name__}:{Joined.__name__}"
        stack.enter_context(mock.patch.object(OptitrackSection, "device", device))
        yield
