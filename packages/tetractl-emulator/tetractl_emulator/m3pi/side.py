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

SERIES_1_VERSIONS = (0x1744, 0x10EC)
"""Hardware version (HV) and firmware version (VR) of an XBee module with 802.15.4."""
SERIES_2_VERSIONS = (0x1944, 0x21A7)
"""Hardware version (HV) and firmware version (VR) of an XBee module with Zigbee."""


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


def _begin_wrong_id(fault: Any, device: Any) -> Undo:
    """Begin the fault `wrong_id`: replace the robot's firmware with one for another index.

    Returns:
        A function that restores the index.
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
        begin=_begin_wrong_id,
    ),
    DRIVEN_ELSEWHERE,
    *WHEELED_FAULTS,
)


class EmulatedM3pi(WheeledSide):
    """An emulated XBee on a pseudo-terminal, and the robots in its radio range."""

    description = "radio"
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
        override_by_name = {override.name: override for override in settings.robots}
        true_robots = [
            override_by_name.get(name) or TrueRobot(name=name) for name in stage.setup.names
        ]
        self.robots = [
            EmulatedRobot(
                true_robot.name,
                section.index(true_robot.name),
                true_robot.battery_mv,
                acting=stage.acting,
            )
            for true_robot in true_robots
        ]
        self.wheels = _create_robots(stage, section, true_robots, self.robots)
        self.timeline = stage.timeline
        hardware, firmware = (
            SERIES_2_VERSIONS if settings.firmware == "zigbee" else SERIES_1_VERSIONS
        )
        self.radio = EmulatedRadio(
            stage.timeline,
            stage.wires.port(stage.options.port_link or section.port),
            settings.baud or section.baud,
            (hardware if settings.hardware is None else settings.hardware, firmware),
            self.robots,
            settings.loss,
            stage.options.seed,
            stage.note,
            stage.acting,
        )
        self.radios = [self.radio]


def _create_robots(
    stage: Stage,
    section: M3piSection,
    true_robots: Sequence[TrueRobot],
    robots: Sequence[EmulatedRobot],
) -> EmulatedRobots:
    """Create the moving robots, in the setup's order, with the true properties of their wheels.

    A property that the script does not state comes from the spec.
    """
    true_entries = []
    for true_robot in true_robots:
        names = ("left", "right", "swap", "radius_mm")
        overrides = {
            name: value for name, value in true_robot if name in names and value is not None
        }
        true_entries.append(entry(section.robots, true_robot.name).model_copy(update=overrides))
    radii = radii_mm(stage.setup, [true_entry.radius_mm for true_entry in true_entries])
    lags_s = np.array([true_robot.lag for true_robot in true_robots])
    return EmulatedRobots(robots, drivetrains(true_entries), radii, lags_s, stage.timeline.now_ns)
