"""The emulated actuator of type `m3pi-xbee`: its settings and faults, a radio, and robots."""

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.experiment.base import Finite, Model, Name, Point, Positive
from tetractl.lab.actuators.m3pi.actuator import drivetrains
from tetractl.lab.actuators.m3pi.section import M3piSection, WheelSection
from tetractl.lab.actuators.wheel_commands import radii_mm
from tetractl_emulator.faults import (
    STUCK_PORT,
    UNPLUG,
    Fault,
    Share,
    Undo,
    fault,
    settings,
    switching,
)
from tetractl_emulator.firmware import RobotCore
from tetractl_emulator.m3pi.emulated_radio import EmulatedRadio
from tetractl_emulator.m3pi.robot import EmulatedBattery, EmulatedRobot, EmulatedRobots
from tetractl_emulator.port import PluggedDevice
from tetractl_emulator.sides import Stage

Count = Annotated[int, Field(ge=-127, le=127)]
PUSH_NS, PUSH_PARTS = SECOND // 5, 40  # how long a push takes, and in how many steps
SERIES_1, SERIES_2 = (0x1744, 0x10EC), (0x1944, 0x21A7)  # HV, VR: 802.15.4, Zigbee


class TrueRobot(Model):
    """A robot's true properties that differ from the spec."""

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
    battery_mv: int = Field(default=5100, ge=0, le=9000)
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


def _robot_of(device: Any, fault: Any) -> EmulatedRobot:
    return device.robot(fault.robot)


Wheel = Literal["left", "right", "both"]


def _weak(fault: Any) -> tuple[float, float]:
    left, right = (fault.wheel in (side, "both") for side in ("left", "right"))
    return fault.share if left else 1.0, fault.share if right else 1.0


STUCK = {"left": (True, False), "right": (False, True), "both": (True, True)}
FAULTS = (
    fault(
        "veer",
        "A robot's motors get these counts in place of every count other than 0.",
        settings(_robot_of, veer=attrgetter("counts")),
        robot=Name,
        counts=tuple[Count, Count],
    ),
    fault(
        "wheel_stuck",
        "One or both wheels no longer turn.",
        settings(_robot_of, stuck=lambda f: STUCK[f.wheel]),
        robot=Name,
        wheel=Wheel,
    ),
    UNPLUG,
    STUCK_PORT,
    fault(
        "loss",
        "Robots do not receive this fraction of the transmissions.",
        settings(lambda d, f: d.radio, loss=attrgetter("share")),
        share=Share,
    ),
    fault(
        "deaf",
        "A robot does not receive this fraction of the transmissions.",
        settings(_robot_of, deaf=attrgetter("share")),
        robot=Name,
        share=Share,
    ),
    fault(
        "late_radio",
        "Transmissions arrive late [s].",
        settings(lambda d, f: d.radio, late_ns=lambda f: round(f.by * SECOND)),
        by=Positive,
    ),
    fault(
        "doubled_packets",
        "Robots receive each transmission twice.",
        settings(lambda d, f: d.radio, doubled=True),
    ),
    fault(
        "radio_resets",
        "The radio's module restarts: it takes and gives no bytes until it is up again.",
        switching(lambda d, f: d.radio.restart),
    ),
    fault(
        "baud",
        "The radio's module has another baud rate.",
        settings(lambda d, f: d.radio, speed=attrgetter("baud")),
        baud=Literal[9600, 19200, 38400, 115200],
    ),
    fault(
        "bad_bytes",
        "This fraction of the bytes on the wire to the radio is changed, both ways.",
        settings(lambda d, f: d.radio, noise=attrgetter("share")),
        share=Share,
    ),
    fault(
        "weak_wheel",
        "A wheel turns at this share of its speed.",
        settings(_robot_of, weak=_weak),
        robot=Name,
        wheel=Wheel,
        share=Share,
    ),
    fault(
        "pushed",
        "Somebody moves a robot on the floor: by this distance [mm] and angle [rad], within 0.2 s, "
        "or at once if it is put elsewhere.",
        lambda f, d: d.push(f),
        robot=Name,
        by=Point,
        turn=(Finite, 0.0),
        at_once=(bool, False),
    ),
    fault(
        "off",
        "A robot is switched off.",
        switching(lambda d, f: _robot_of(d, f).switch, False),
        robot=Name,
    ),
    fault(
        "wrong_id",
        "A robot's firmware was built with this broadcast number.",
        settings(_robot_of, index=attrgetter("id"), core=lambda f: RobotCore(f.id)),
        robot=Name,
        id=Annotated[int, Field(ge=0, le=31)],
    ),
    fault(
        "low_battery",
        "A robot's battery has this voltage [mV].",
        settings(
            lambda d, f: _robot_of(d, f).battery, open_mv=lambda f: float(f.millivolts), sag_mv=0.0
        ),
        robot=Name,
        millivolts=Annotated[int, Field(ge=0, le=9000)],
    ),
)


class EmulatedM3pi(PluggedDevice):
    """An XBee on a pseudo-terminal, and the robots in its radio range."""

    what = "radio"
    Settings: ClassVar[type[Model]] = M3piSettings
    faults: ClassVar[Sequence[type[Fault]]] = FAULTS

    def __init__(self, stage: Stage, settings: M3piSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, M3piSection), "the actuator's section has the type m3pi-xbee"
        truths = {truth.name: truth for truth in settings.robots}
        trues = [truths.get(name) or TrueRobot(name=name) for name in stage.setup.names]
        self.robots = [
            EmulatedRobot(
                true.name, section.index(true.name), EmulatedBattery(float(true.battery_mv))
            )
            for true in trues
        ]
        self._wheels = _wheels(stage, section, trues, self.robots)
        self._timeline = stage.timeline
        self.port = stage.wires.port(stage.options.link or Path(section.port))
        hardware, firmware = SERIES_2 if settings.firmware == "zigbee" else SERIES_1
        self.radio = self.wired = EmulatedRadio(
            stage.timeline,
            self.port,
            settings.baud or section.baud,
            (hardware if settings.hardware is None else settings.hardware, firmware),
            self.robots,
            settings.loss,
            stage.options.seed,
            stage.note,
        )

    @property
    def bodies(self) -> Sequence[EmulatedRobot]:
        """The robots, in the order of the setup."""
        return self.robots

    @property
    def driven(self) -> bool:
        """Whether any motor is driven."""
        return any(any(robot.counts()) for robot in self.robots)

    @property
    def truth(self) -> dict[str, Any]:
        """The speeds of all wheels [mm/s], to be recorded as {"wheels": [[left, right], ...]}."""
        return {"wheels": [[round(wheel, 2) for wheel in robot.wheels] for robot in self.robots]}

    def switch(self, on: bool) -> None:
        """Switch every robot on or off."""
        for robot in self.robots:
            robot.switch(on)

    def advance(self, until_ns: int) -> None:
        """Advance the robots to `until_ns`."""
        self._wheels.advance(until_ns)

    def tick(self) -> None:
        """Send the robots' pending answers."""
        self.radio.poll_answers()

    def push(self, fault: Any) -> Undo:
        """Move a robot as a fault says."""
        row, parts = self.robot(fault.robot).row, 1 if fault.at_once else PUSH_PARTS
        x, y, turn = (value / parts for value in (*fault.by, fault.turn))
        for part in range(parts):
            at = self._timeline.now_ns + part * PUSH_NS // PUSH_PARTS
            self._timeline.at(at, lambda: self._wheels.shift(row, x, y, turn))
        return lambda: None

    def robot(self, name: str) -> EmulatedRobot:
        """Return the robot with this name."""
        return next(robot for robot in self.robots if robot.name == name)


def _wheels(
    stage: Stage,
    section: M3piSection,
    trues: Sequence[TrueRobot],
    robots: Sequence[EmulatedRobot],
) -> EmulatedRobots:
    """Return the robots on wheels as they truly are."""
    parts = [
        section.robot(true.name).model_copy(
            update={
                name: value
                for name, value in true
                if name in ("left", "right", "swap", "radius_mm") and value is not None
            }
        )
        for true in trues
    ]
    radii = radii_mm(stage.setup, [part.radius_mm for part in parts])
    lags = np.array([true.lag for true in trues])
    return EmulatedRobots(robots, drivetrains(parts), radii, lags, stage.timeline.now_ns)
