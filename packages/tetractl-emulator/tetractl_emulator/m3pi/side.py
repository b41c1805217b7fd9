"""The emulated actuator of type `m3pi-xbee`: robots, their radio, its settings and its faults."""

from collections.abc import Sequence
from functools import partial
from random import Random
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.lab.actuators.m3pi.actuator import drivetrains
from tetractl.lab.actuators.m3pi.section import M3piSection, WheelSection
from tetractl.lab.actuators.wheel_commands import radii_mm
from tetractl.spec.base import Model, Name, Positive
from tetractl.spec.lab_section import LabSection, entry
from tetractl_emulator.faults import Fault, Share, Undo, fault_kind
from tetractl_emulator.m3pi.emulated_radio import EmulatedRadio
from tetractl_emulator.m3pi.robot import BATTERY_MV, EmulatedRobot, EmulatedRobots
from tetractl_emulator.m3pi.wheeled_side import (
    DRIVEN_ELSEWHERE,
    WHEELED_FAULTS,
    Count,
    WheeledSide,
    robots_of_day,
)
from tetractl_emulator.sides import Stage

SERIES_1 = (0x1744, 0x10EC)  # HV and VR of a module with 802.15.4
SERIES_2 = (0x1944, 0x21A7)  # HV and VR of one with Zigbee


class TrueRobot(Model):
    """The true properties of one emulated robot, if they differ from the values in the spec."""

    name: Name
    """Name of a robot of the spec."""
    left: WheelSection | None = None
    """Gain, dead zone and direction of the left wheel; the spec's by default."""
    right: WheelSection | None = None
    """Gain, dead zone and direction of the right wheel; the spec's by default."""
    swap: bool | None = None
    """Whether the left wheel is connected to the right motor's output."""
    radius_mm: Positive | None = None
    """Distance r from a wheel to the robot's centre [mm]."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of the wheels [s]."""
    battery_mv: int = Field(default=BATTERY_MV, ge=0, le=9000)
    """The battery's voltage without load [mV]."""


class M3piSettings(Model):
    """Properties of the radio and the robots that differ from the spec."""

    firmware: Literal["802.15.4", "zigbee"] = "802.15.4"
    """The firmware of the radio's module."""
    hardware: int | None = Field(default=None, ge=0, le=0xFFFF)
    """The module's hardware version (HV); by default a Series 1, or a Series 2 with zigbee."""
    baud: Literal[9600, 19200, 38400, 57600, 115200] | None = None
    """The module's baud rate; the spec's by default."""
    loss: Share = 0.0
    """Probability that a robot does not receive a transmission."""
    robots: tuple[TrueRobot, ...] = ()
    """The robots whose true properties differ from the spec."""


def _renumber(fault: Any, device: Any) -> Undo:
    """Begin the fault `wrong_id`: replace the robot's firmware with one for another index.

    It returns a function that restores the index.
    """
    robot = device.robot(fault.robot)
    undo = partial(robot.renumber, robot.index)
    robot.renumber(fault.id)
    return undo


FAULTS = (
    fault_kind(
        "veer",
        "A robot's motors run at these counts whenever they should run at any count other than 0.",
        fields={"robot": Name, "counts": tuple[Count, Count]},
    ),
    fault_kind(
        "wrong_id",
        "A robot's firmware was built with this broadcast number.",
        fields={"robot": Name, "id": Annotated[int, Field(ge=0, le=31)]},
        begin=_renumber,
    ),
    DRIVEN_ELSEWHERE,
    *WHEELED_FAULTS,
)


class EmulatedM3pi(WheeledSide):
    """An emulated XBee on a pseudo-terminal, and the robots in its radio range."""

    what = "radio"
    Settings: ClassVar[type[Model]] = M3piSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample the radio and robots of a randomised test run; see `tetractl_emulator.sides`."""

        def gain(fraction: float) -> dict[str, float]:
            return {"gain_mm": round(1000 / 127 * fraction, 4)}

        return robots_of_day(random, setup.names, "{}", gain)

    def __init__(self, stage: Stage, settings: M3piSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, M3piSection), "the actuator's section has the type m3pi-xbee"
        truths = {truth.name: truth for truth in settings.robots}
        trues = [truths.get(name) or TrueRobot(name=name) for name in stage.setup.names]
        self.robots = [
            EmulatedRobot(
                true.name,
                section.index(true.name),
                true.battery_mv,
                acting=stage.acting,
            )
            for true in trues
        ]
        self.wheels = _wheels(stage, section, trues, self.robots)
        self.timeline = stage.timeline
        hardware, firmware = SERIES_2 if settings.firmware == "zigbee" else SERIES_1
        self.radio = EmulatedRadio(
            stage.timeline,
            stage.wires.port(stage.options.link or section.port),
            settings.baud or section.baud,
            (hardware if settings.hardware is None else settings.hardware, firmware),
            self.robots,
            settings.loss,
            stage.options.seed,
            stage.note,
            stage.acting,
        )
        self.radios = [self.radio]


def _wheels(
    stage: Stage,
    section: M3piSection,
    trues: Sequence[TrueRobot],
    robots: Sequence[EmulatedRobot],
) -> EmulatedRobots:
    """Create the moving robots, in the setup's order, with the true properties of their wheels.

    A property that the script does not state comes from the spec.
    """
    parts = []
    for true in trues:
        names = ("left", "right", "swap", "radius_mm")
        wheels = {name: value for name, value in true if name in names and value is not None}
        parts.append(entry(section.robots, true.name).model_copy(update=wheels))
    radii = radii_mm(stage.setup, [part.radius_mm for part in parts])
    lags = np.array([true.lag for true in trues])
    return EmulatedRobots(robots, drivetrains(parts), radii, lags, stage.timeline.now_ns)
