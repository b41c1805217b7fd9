"""The base of emulated robots of another make: two wheels, a port each, a line for each command.

A side of your own derives from `OwnLines` and reads a line.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, ClassVar

from tetractl.core.setup import Setup
from tetractl.experiment.base import Model
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.actuators.wheel_commands import Status, radii_mm
from tetractl.model.wheels import Counts
from tetractl_emulator.faults import Fault
from tetractl_emulator.m3pi.robot import EmulatedBattery, EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import (
    WHEELED_FAULTS,
    PortedSide,
    TrueWheels,
    WheelsSettings,
    gains_of_day,
)
from tetractl_emulator.rehearsal.participants import Rehearsal
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio

RUN, STOP, BAUD = 1, 2, 57600  # flags of a command in the record; baud rate of a serial port
Read = Callable[[bytes], Counts]


class OwnProgram:
    """A robot's program: the speeds of the newest line, until its watchdog ends them."""

    def __init__(self, read: Read, watchdog_s: float) -> None:
        self._read, self._watchdog_ms = read, round(watchdog_s * 1000)
        self._speeds: Counts = (0, 0)
        self._heard_ms = 0

    def push(self, data: bytes, now_ms: int) -> None:
        """Take a line; one that cannot be read changes nothing."""
        with suppress(ValueError):
            self._speeds, self._heard_ms = self._read(data), now_ms

    def wheels(self, now_ms: int) -> Counts:
        """Return the speeds that act now [mm/s]."""
        return self._speeds if now_ms - self._heard_ms < self._watchdog_ms else (0, 0)

    def status(self, now_ms: int) -> Status:
        """Return whether it drives, or stands because no line came."""
        if now_ms - self._heard_ms >= self._watchdog_ms:
            return Status.SILENT
        return Status.RUNNING if any(self._speeds) else Status(0)

    def take_reply(self, now_ms: int) -> bytes:
        """Return nothing: it does not answer."""
        return b""

    def set_battery(self, battery_mv: int) -> None:
        """Do nothing: it does not measure its battery."""


class OwnRadio(LineRadio):
    """The connection to the robot in a row of the setup, whose lines `read` reads."""

    def __init__(self, stage: Stage, port: str, side: "OwnLines", row: int, loss: float) -> None:
        robots, seed = side.robots[row : row + 1], stage.options.seed + row
        super().__init__(stage, stage.wires.port(port), BAUD, robots, [row], loss, seed)
        self._side, self._row = side, row

    def stop_elsewhere(self, sequence: int) -> None:
        """Do nothing: a robot has no emergency stop that another sender could press."""

    def _command(self, sealed: bytes) -> dict[str, Any]:
        speeds = self._side.read(sealed, self._row)
        drives = [row == self._row and any(speeds) for row in range(len(self._side.robots))]
        return {"flags": RUN if any(speeds) else STOP, "motors": [*speeds], "drives": drives}


class OwnLines(PortedSide):
    """Robots at `ports`, one each; `watchdog_s` after its last line a robot stops by itself."""

    Settings: ClassVar[type[Model]] = WheelsSettings
    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        one for one in WHEELED_FAULTS if one.__name__ not in ("stopped_elsewhere", "low_battery")
    )
    watchdog_s: ClassVar[float] = 0.25

    @classmethod
    def rehearsal(cls, lab: LabSection, setup: Setup) -> Rehearsal:
        """Return what rehearsals draw of radio and robots."""
        return gains_of_day(setup)

    def __init__(
        self, stage: Stage, settings: WheelsSettings, ports: Sequence[str], speed_max: float
    ) -> None:
        names = stage.setup.names
        trues, self.radii = settings.trues(names), radii_mm(stage.setup, [None] * len(names))
        self.robots = [self._robot(row, true) for row, true in enumerate(trues)]
        self.roll(stage, trues, [(1.0, 1.0)] * len(names), self.radii, (speed_max, 1.0))
        self.radios = [
            OwnRadio(stage, port, self, row, settings.loss) for row, port in enumerate(ports)
        ]

    @abstractmethod
    def read(self, line: bytes, row: int) -> Counts:
        """Return the wheel speeds left, right [mm/s] that a line asks of the robot in a row of the
        setup; ValueError if it cannot be read."""

    def _robot(self, row: int, true: TrueWheels) -> EmulatedRobot:
        def program(index: int) -> OwnProgram:
            return OwnProgram(lambda line: self.read(line, index), self.watchdog_s)

        return EmulatedRobot(true.name, row, EmulatedBattery(float(true.battery_mv)), program)
