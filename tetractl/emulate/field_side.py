"""The emulated actuator of type `field`: its settings and faults, a current driver, and cells."""

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from tetractl.emulate.cells import Cell, Dish
from tetractl.emulate.faults import STUCK_PORT, UNPLUG, Fault, fault, settings, switching
from tetractl.emulate.field import CurrentDriver
from tetractl.emulate.firmware import DriverLimits
from tetractl.emulate.loop import Loop
from tetractl.emulate.port import PseudoPort
from tetractl.emulate.sides import Facts, Stage
from tetractl.experiment.base import Model, NonNegative
from tetractl.lab.actuators.field.protocol import DriverStatus
from tetractl.lab.actuators.field.section import FieldSection


class FieldSettings(Model):
    """How driver and cells differ from what the spec says."""

    heading_noise: NonNegative = 0.05
    """Random walk of every cell's heading [rad/sqrt(s)]."""
    supply_mv: int = Field(default=12_000, ge=0, le=60_000)
    """The driver's supply voltage [mV]."""


def _driver_of(device: Any, fault: Any) -> CurrentDriver:
    return device.driver


FAULTS = (
    UNPLUG,
    STUCK_PORT,
    fault("off", "The driver is switched off.", switching(lambda d, f: d.driver.switch, False)),
    fault(
        "low_supply",
        "The driver's supply has this voltage.",
        settings(_driver_of, supply_mv=attrgetter("millivolts")),
        millivolts=Annotated[int, Field(ge=0, le=60_000)],
    ),
    fault(
        "hot",
        "The coils have this temperature.",
        settings(_driver_of, temperature_dc=lambda f: round(10 * f.celsius)),
        celsius=Annotated[float, Field(ge=0, le=200)],
    ),
    fault("mute", "The driver hears but does not reply.", settings(_driver_of, mute=True)),
)


class EmulatedField:
    """A current driver on a pseudo-terminal, and the cells between its coils."""

    Settings: ClassVar[type[Model]] = FieldSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: FieldSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, FieldSection), "the table of kinds goes by the type"
        setup, start_ns = stage.setup, stage.timeline.now_ns
        self.port = PseudoPort(stage.options.link or Path(section.port))
        self.driver = CurrentDriver(
            stage.timeline, self.port, _limits(section), section.baud, tell=stage.note
        )
        self.driver.supply_mv = settings.supply_mv
        numbers = zip(setup.names, setup.a.tolist(), setup.speed.tolist(), strict=True)
        self.cells = [
            Cell(name, 0.0, 0.0, 0.0, a, speed * stage.mm, settings.heading_noise)
            for name, a, speed in numbers
        ]
        coils, seed = section.calibrated_coils(), stage.options.seed
        self._dish = Dish(self.driver, coils, section.strength_mt, self.cells, start_ns, seed)
        self._loop: Loop | None = None

    @property
    def bodies(self) -> Sequence[Cell]:
        """The cells, in the order of the setup."""
        return self.cells

    @property
    def driven(self) -> bool:
        """Whether the driver makes a field."""
        return DriverStatus.RUNNING in self.driver.status

    @property
    def truth(self) -> dict[str, Any]:
        """The field where the cells are [mT]."""
        return {"field_mt": [round(part, 5) for part in self._dish.field_mt]}

    def open(self, loop: Loop) -> Facts:
        """Plug the driver in."""
        self._loop = loop
        self.plug()
        link = str(self.port.link)
        return {"actuator": f"current driver at {link}", "port": link}

    def close(self) -> Facts:
        """Pull the driver out."""
        self.unplug()
        return {"garbled": self.driver.garbled}

    def switch(self, on: bool) -> None:
        """Switch the driver on or off."""
        self.driver.switch(on)

    def advance(self, until_ns: int) -> None:
        """Let the currents follow and the cells swim."""
        self._dish.advance(until_ns)

    def tick(self) -> None:
        """Do nothing: the driver replies at once."""

    def plug(self) -> None:
        """Plug the driver in."""
        assert self._loop is not None, "open() gives the loop"
        self.port.plug()
        self._loop.watch(self.port.fd, self.driver.readable)

    def plugged(self, on: bool) -> None:
        """Plug the driver in, or pull it out."""
        if on:
            self.plug()
        else:
            self.unplug()

    def unplug(self) -> None:
        """Pull the driver out; idempotent."""
        if self._loop is not None:
            self._loop.forget(self.port.fd)
        self.port.unplug()


def _limits(section: FieldSection) -> DriverLimits:
    """Return limits that are built into a driver which suits the spec."""
    milliamperes, slew = round(1000 * section.current_max_a), round(1000 * section.slew_max_a_s)
    return DriverLimits(milliamperes, slew, round(1000 * section.watchdog))
