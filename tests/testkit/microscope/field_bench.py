"""A current driver with its section of a spec, in virtual time."""

from tetractl_emulator.loop import Timeline
from tetractl_emulator.memory_wires import MemoryNetwork
from tetractl_emulator.pictures.driver_core import DriverLimits
from tetractl_emulator.pictures.field import CurrentDriver
from tetractl_microscope.coils.actuator import FieldActuator
from tetractl_microscope.coils.driver import FieldCommand
from tetractl_microscope.coils.section import FieldSection

from testkit.emulator.heard_port import HeardPort
from testkit.emulator.virtual_lab import PatientClock
from tetractl.core.clock import SECOND

LIMITS = DriverLimits(current_max_ma=2000, slew_ma_s=100_000)


def section(**changes):
    """Return 2 mT from 2 mT/A and -4 mT/A in an ambient 0.05 mT, limited to 2 A and 100 A/s."""
    x = {"gain_mt_a": 2.0, "offset_mt": 0.03}
    y = {"gain_mt_a": -4.0, "offset_mt": -0.04}
    basis = {
        "type": "field",
        "port": "/dev/none",
        "strength_mt": 2.0,
        "coils": {"x": x, "y": y, "rotation": 0.3},
        "current_max_a": 2.0,
        "slew_max_a_s": 100.0,
    }
    return FieldSection.model_validate(basis | changes)


class Bench:
    """An emulated driver on a port in memory, in virtual time; `told` is what it heard."""

    def __init__(self, limits=LIMITS, baud=115_200):
        self.clock = PatientClock()
        self.told = []
        timeline = Timeline(lambda until: self.driver.advance(until))
        self.clock.set_emulation(timeline)
        self.network = MemoryNetwork()
        self.port = HeardPort(self.network, "coils", lambda: self.driver.read_port())
        self.driver = CurrentDriver(
            timeline,
            self.port,
            limits,
            baud,
            note=lambda event, **facts: self.told.append((event, facts)),
        )
        self.port.plug()
        self.clock.sleep_until(SECOND // 100)  # it has measured

    def opened(self, setup, **changes):
        """Return an actuator that leads to the driver."""
        coils = section(port="coils", **changes)
        return FieldActuator(coils, setup, self.clock, self.network.serial)


class Wire:
    """What an actuator needs of `Driver`, in virtual time."""

    failure = None

    def __init__(self, clock):
        self.sent = []
        self._clock = clock

    def send(self, flags, x_ma=0, y_ma=0):
        self.sent.append(FieldCommand((len(self.sent) + 1) % 256, flags, x_ma, y_ma))
        return self._clock.now()
