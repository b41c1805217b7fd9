"""The emulated actuator of type `field`: a coil driver on a serial port, coils, and cells.

The driver runs the compiled core of the real firmware. The coil currents follow the core's set
points with a first-order lag, whose time constant is L/R of the coils. Cells swim in the field of
these currents, by `model.swimmers`.
"""

import math
from collections.abc import Callable, Sequence
from random import Random
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field
from tetractl_microscope.coils.driver import DriverStatus, decode_command
from tetractl_microscope.coils.section import FieldSection, Pair

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import UsageError
from tetractl.core.setup import Setup
from tetractl.model.swimmers import compute_walls_um
from tetractl.spec.base import Finite, Model, Name, NonNegative, Positive
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.fault_rows import (
    DRIVER_REASONS,
    NO_REASON,
    SEEN_REASONS,
    FaultRow,
    one_minus,
    one_of,
    signed_value,
    value_between,
    whole_number,
)
from tetractl_emulator.faults import (
    ActingFaults,
    Fault,
    Share,
    begin_by_switching,
    fault_kind,
    port_faults,
)
from tetractl_emulator.loop import Timeline
from tetractl_emulator.pictures.dish.live_dish import CellBody, CoilField, Dish, cells_of, culture
from tetractl_emulator.pictures.driver_core import DriverCore, DriverLimits
from tetractl_emulator.port import PluggedDevices, PseudoPort, SerialDevice
from tetractl_emulator.sides import Stage

USUAL_TEMPERATURE_DC = 250
"""The coils' temperature without a fault [tenths of a degree Celsius]."""


class CurrentDriver(SerialDevice):
    """An emulated current driver that has just been switched on.

    Args:
        timeline: The emulation's timeline.
        port: The driver's port. The caller plugs it in.
        limits: The limits built into the driver.
        baud: Speed of the port [bits/s].
        lag_s: Time constant of the currents [s].
        note: Records an event, called as `note(event, **facts)`. None if there is no record.
        supply_mv: Voltage of the supply without a fault [mV].
        acting: The faults that act now. None if no fault can act.

    Attributes:
        currents: The true currents in the x and y coils [A].
        supply_mv: Voltage of the supply without a fault [mV].
        powered: Whether the driver is switched on.
    """

    def __init__(
        self,
        timeline: Timeline,
        port: PseudoPort,
        limits: DriverLimits,
        baud: int = 115_200,
        lag_s: float = 0.004,  # 20 mH over 5 ohm
        note: Callable[..., None] | None = lambda event, **facts: None,
        supply_mv: int = 12_000,
        acting: ActingFaults | None = None,
    ) -> None:
        super().__init__(timeline, port, baud, note, acting)
        self.currents: Pair = (0.0, 0.0)
        self.supply_mv = supply_mv
        self.powered = True
        self._due_ns = 0
        self._limits = limits
        self._decay = math.exp(-MILLISECOND / SECOND / lag_s)
        self._now_ns = timeline.now_ns
        self._core = DriverCore(limits, self._now_ms)

    @property
    def status(self) -> DriverStatus:
        """The status flags that the driver reports now; SILENT if it is switched off."""
        return self._core.status(self._now_ms) if self.powered else DriverStatus.SILENT

    @property
    def running(self) -> bool:
        """Whether the driver is running, so that its coils make a magnetic field.

        It is False if the driver is switched off.
        """
        return DriverStatus.RUNNING in self.status

    def receive(self, data: bytes) -> None:
        """Process bytes from the line, and reply to polls, as a real driver does.

        During the fault `late_driver`, the bytes are processed late. Later bytes wait for earlier
        ones.
        """
        late_ns = round(self.acting.total_by("late_driver") * SECOND)
        if not late_ns and self._due_ns <= self._timeline.now_ns:
            self._receive(data)
            return
        self._due_ns = max(self._due_ns, self._timeline.now_ns + late_ns)  # in their order
        self._timeline.at(self._due_ns, lambda: self._receive(data))

    def _receive(self, data: bytes) -> None:
        """Pass bytes to the firmware's core, and send its replies.

        Bytes are lost if the driver is switched off. During the fault `mute`, replies are lost.
        """
        if not self.powered:
            return
        for byte in data * (2 if self.acting.of_kind("doubled_commands") else 1):
            self._core.push(bytes([byte]), self._now_ms)
            reply = self._core.take_reply(self._now_ms)
            if reply and not self.acting.of_kind("mute"):
                self._send_to_program(reply)

    def advance(self, until_ns: int) -> None:
        """Advance the currents in steps of 1 ms, up to the time `until_ns` [ns].

        A remainder of less than 1 ms is left for the next call.
        """
        while self._now_ns + MILLISECOND <= until_ns:
            self._now_ns += MILLISECOND
            self._step()

    def switch(self, on: bool) -> None:
        """Switch the driver on or off. Switching it on clears an emergency stop or overheating.

        The currents decay after it is switched off.
        """
        self.powered = on
        if on:
            self._core = DriverCore(self._limits, self._now_ms)

    def _decode_command(self, frame: bytes) -> dict[str, Any]:
        """Decode a command for the record: its sequence number, flags and currents [mA].

        WireError is raised if it is damaged.
        """
        command = decode_command(frame)
        flags = int(command.flags)
        currents = [command.x_ma, command.y_ma]
        return {"sequence": command.sequence, "flags": flags, "currents_ma": currents}

    def _step(self) -> None:
        """Advance the currents by 1 ms, and pass the measured values to the core.

        If the driver is switched off, the currents decay to 0.
        """
        set_points = self._core.currents_ua(self._now_ms) if self.powered else (0, 0)
        x, y = (
            set_point / 1e6 + self._decay * (current - set_point / 1e6)
            for set_point, current in zip(set_points, self.currents, strict=True)
        )
        self.currents = x, y
        supply_fault = self.acting.newest("low_supply")
        heat_fault = self.acting.newest("hot")
        supply_mv = self.supply_mv if supply_fault is None else supply_fault.millivolts
        temperature_dc = (
            USUAL_TEMPERATURE_DC if heat_fault is None else round(10 * heat_fault.celsius)
        )
        self._core.measured(round(1000 * x), round(1000 * y), supply_mv, temperature_dc)

    @property
    def _now_ms(self) -> int:
        """The present time for the firmware [ms], modulo 2^32."""
        return self._now_ns // MILLISECOND & 0xFFFFFFFF


class FieldSettings(Model):
    """Properties of the driver and the cells that differ from the spec.

    `cells` and `strangers` are used if a trial chooses its cells.
    """

    heading_noise: NonNegative = 0.05
    """Random walk of every cell's heading [rad/sqrt(s)]."""
    cells: int = Field(default=6, ge=1, le=60)
    """Number of cells with a magnet in the dish, each drawn at random."""
    strangers: int = Field(default=2, ge=0, le=60)
    """Number of cells without a magnet."""
    supply_mv: int = Field(default=12_000, ge=0, le=60_000)
    """The driver's supply voltage [mV]."""


def _cell_index(fault: Any, device: Any) -> int:
    """Return the index of the cell that a fault names.

    Raises:
        UsageError: If there is no such cell.
    """
    names = [body.name for body in device.bodies]
    if fault.cell not in names:
        raise UsageError(
            f"the fault script names the cell {fault.cell}, but no cell has this name",
            f"the cells are {', '.join(names)}",
        )
    return names.index(fault.cell)


def _begin_dive(fault: Any, device: Any) -> None:
    """Begin the fault `dives`: move a cell by `by_um` [um] out of the focal plane.

    Nothing undoes it when the fault ends, because the cell returns by itself within seconds.
    """
    device.dish.cells.depth[_cell_index(fault, device)] += fault.by_um


def _resting_switch(fault: Any, device: Any) -> Callable[[bool], None]:
    """Return the switch with which the cell of a fault `rests` stops or resumes swimming.

    It stops with True, and resumes with False.
    """
    row = _cell_index(fault, device)
    return lambda resting: device.dish.cells.set_resting(row, resting)


FIELD_REASONS = (
    f"{DRIVER_REASONS}|{SEEN_REASONS}"  # cells that are not steered swim where they want
)
FAULTS = (
    *port_faults("driver", DRIVER_REASONS, DRIVER_REASONS),
    fault_kind(
        "off",
        "The current driver is switched off.",
        rows=[
            FaultRow("driver off", FIELD_REASONS),
            FaultRow("driver resets", FIELD_REASONS, {"for": value_between(0.01, 1)}),
        ],
        begin=begin_by_switching(lambda f, d: d.driver.switch, False),
    ),
    fault_kind(
        "low_supply",
        "The supply of the current driver has this voltage [mV].",
        fields={"millivolts": Annotated[int, Field(ge=0, le=60_000)]},
        rows=[FaultRow("supply low", FIELD_REASONS, {"millivolts": whole_number(12_000, 5_000)})],
    ),
    fault_kind(
        "hot",
        "The coils have this temperature [degrees Celsius].",
        fields={"celsius": Annotated[float, Field(ge=0, le=200)]},
        rows=[FaultRow("coils hot", f"°C|{FIELD_REASONS}", {"celsius": value_between(30, 150)})],
    ),
    fault_kind(
        "divides",
        "A cell divides into two.",
        fields={"cell": Name},
        rows=[FaultRow("cell divides", SEEN_REASONS, at_once=True)],
        begin=lambda f, d: d.dish.divide(_cell_index(f, d)),
    ),
    fault_kind(
        "rests",
        "A cell stops swimming.",
        fields={"cell": Name},
        rows=[FaultRow("cell rests", SEEN_REASONS)],
        begin=begin_by_switching(_resting_switch),
    ),
    fault_kind(
        "dives",
        "A cell leaves the focal plane by this height [um], and returns within seconds.",
        fields={"cell": Name, "by_um": (Finite, 300.0)},
        rows=[FaultRow("cell dives", SEEN_REASONS, {"by_um": signed_value(20, 600)}, at_once=True)],
        begin=_begin_dive,
    ),
    fault_kind(
        "late_driver",
        "The current driver receives everything late by this time [s].",
        fields={"by": Positive},
        rows=[FaultRow("driver late", FIELD_REASONS, {"by": value_between(0.005, 1)})],
    ),
    fault_kind(
        "doubled_commands",
        "The current driver receives each command twice.",
        rows=[FaultRow("commands doubled", NO_REASON, weight=0.5)],
    ),
    fault_kind(
        "bad_bytes",
        "This fraction of the bytes on the wire to and from the current driver is changed.",
        fields={"share": Share},
        rows=[FaultRow("bad bytes", FIELD_REASONS, {"share": value_between(2e-4, 0.5)})],
    ),
    fault_kind(
        "weak_coils",
        "A coil pair makes this fraction of its field. A negative fraction reverses the field.",
        fields={"axis": Literal["x", "y"], "share": Annotated[float, Field(ge=-1, le=1)]},
        rows=[
            FaultRow(
                "coils weak",
                SEEN_REASONS,
                {"axis": one_of("x", "y"), "share": one_minus(0.02, 2, -1.0)},
            )
        ],
    ),
    fault_kind(
        "turned_coils",
        "The coils are turned by this angle [rad].",
        fields={"by": Finite},
        rows=[FaultRow("coils turned", SEEN_REASONS, {"by": signed_value(0.02, 3.1)})],
    ),
    fault_kind(
        "mute",
        "The current driver receives commands but does not reply.",
        rows=[FaultRow("driver silent", DRIVER_REASONS)],
    ),
)


class EmulatedField(PluggedDevices):
    """An emulated current driver on a pseudo-terminal, and the cells between its coils."""

    description = "current driver"
    Settings: ClassVar[type[Model]] = FieldSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS
    choosable: ClassVar[Sequence[str]] = tuple(f"cell {i + 1}" for i in range(6))
    """Names of the cells with a magnet in the dish of a randomised test run.

    Trials choose their robots among them.
    """

    def __init__(self, stage: Stage, settings: FieldSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, FieldSection), "the actuator's section has the type field"
        setup = stage.setup
        start_ns = stage.timeline.now_ns
        self.driver = CurrentDriver(
            stage.timeline,
            stage.wires.port(stage.options.port_link or section.port),
            _driver_limits(section),
            section.baud,
            note=stage.note,
            supply_mv=settings.supply_mv,
            acting=stage.acting,
        )
        seed = stage.options.seed
        heading_walk = settings.heading_noise
        names = setup.names
        walls = None
        if stage.options.trials_choose_robots:
            walls = compute_walls_um(setup)
            dish_seed = seed if stage.options.dish_seed is None else stage.options.dish_seed
            cells, names = culture(settings.cells, settings.strangers, heading_walk, dish_seed)
        else:
            cells = cells_of(setup, heading_walk, seed)
        field = CoilField(section.coils, section.reference_mt(setup), stage.acting)
        self.dish = Dish(self.driver, field, cells, start_ns, seed, walls)
        self._bodies = [CellBody(name, self.dish, row) for row, name in enumerate(names)]

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample the cells of a randomised test run; see `tetractl_emulator.sides`."""
        heading_walk = round(random.uniform(0.02, 0.1), 4)
        return {
            "heading_noise": heading_walk,
            "cells": len(cls.choosable),
            "strangers": random.randint(0, 3),
        }

    @property
    def serial_devices(self) -> Sequence[CurrentDriver]:
        """The driver, which is the only device on a port."""
        return (self.driver,)

    @property
    def bodies(self) -> Sequence[CellBody]:
        """The cells at their true poses, in the order of the setup."""
        return self._bodies

    @property
    def driven(self) -> bool:
        """Whether the driver is running, so that its coils make a magnetic field."""
        return self.driver.running

    @property
    def truth(self) -> dict[str, Any]:
        """The true field, the currents and the newly born cells, for the record.

        The keys are "field_mt" [mT] and "currents_a" [A], each with the values for x and y, and
        "born", with x, y [mm] and heading [rad] of each cell that was born since the start.
        """
        pairs_by_name = {"field_mt": self.dish.field_mt, "currents_a": self.driver.currents}
        record = {name: _round_values(values) for name, values in pairs_by_name.items()}
        born_rows = range(len(self._bodies), len(self.dish.cells))
        daughters = [CellBody("", self.dish, row) for row in born_rows]
        return record | {
            "born": [[daughter.x, daughter.y, daughter.heading] for daughter in daughters]
        }

    def switch(self, on: bool) -> None:
        """Switch the power of the coil driver on or off."""
        self.driver.switch(on)

    def advance(self, until_ns: int) -> None:
        """Advance the currents and the cells to the time `until_ns` [ns]."""
        self.dish.advance(until_ns)

    def tick(self) -> None:
        """Do nothing, because the driver replies at once."""


def _round_values(values: Sequence[float]) -> list[float]:
    """Round values to 5 decimals."""
    return [round(value, 5) for value in values]


def _driver_limits(section: FieldSection) -> DriverLimits:
    """Return the limits that are built into the driver. They come from the spec."""
    current_max_ma = round(1000 * section.current_max_a)
    slew_ma_s = round(1000 * section.slew_max_a_s)
    return DriverLimits(current_max_ma, slew_ma_s, round(1000 * section.watchdog))
