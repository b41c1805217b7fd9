"""The emulated actuator of type `twist`: its settings and faults, ports, and robots."""

from collections.abc import Sequence
from functools import partial
from random import Random
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, Name, Positive
from tetractl.experiment.lab_section import LabSection, entry
from tetractl.lab.actuators.twist.actuator import drivetrains
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import radii_mm
from tetractl.lab.udp_port import SCHEME
from tetractl_emulator.faults import Fault, Share
from tetractl_emulator.firmware import TwistCore
from tetractl_emulator.m3pi.robot import EmulatedBattery, EmulatedRobot, EmulatedRobots
from tetractl_emulator.m3pi.wheeled_side import WHEELED_FAULTS, PortedSide, robots_of_day
from tetractl_emulator.rehearsal.participants import Rehearsal
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio


class TrueTwistRobot(Model):
    """A robot's true properties that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    left_gain: Positive | None = None
    """True speed of the left wheel over the speed that it was sent."""
    right_gain: Positive | None = None
    """True speed of the right wheel over the speed that it was sent."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of the wheels [s]."""
    battery_mv: int = Field(default=5100, ge=0, le=9000)
    """The battery's voltage without load [mV]."""


class TwistSettings(Model):
    """Properties of the radio and the robots that differ from the spec."""

    loss: Share = 0.0
    """Probability that a robot does not receive a line."""
    robots: tuple[TrueTwistRobot, ...] = ()
    """The robots whose true properties differ from the spec."""


class EmulatedTwist(PortedSide):
    """Robots that run the firmware's core, on the ports of the spec."""

    Settings: ClassVar[type[Model]] = TwistSettings
    faults: ClassVar[Sequence[type[Fault]]] = WHEELED_FAULTS

    @classmethod
    def rehearsal(cls, lab: LabSection, setup: Setup) -> Rehearsal:
        """Return what rehearsals draw of radio and robots."""

        def world(random: Random, off: bool) -> dict[str, Any]:
            return robots_of_day(random, setup.names, off, "{}_gain", lambda share: round(share, 4))

        return Rehearsal(world=world)

    def __init__(self, stage: Stage, settings: TwistSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, TwistSection), "the actuator's section has the type twist"
        truths = {truth.name: truth for truth in settings.robots}
        names = stage.setup.names
        trues = [truths.get(name) or TrueTwistRobot(name=name) for name in names]
        own = [entry(section.robots, name) for name in names]
        radii = radii_mm(stage.setup, [robot.radius_mm for robot in own])
        self.timeline = stage.timeline
        self.robots = [
            EmulatedRobot(
                name,
                section.index(name),
                EmulatedBattery(float(true.battery_mv)),
                partial(TwistCore, radius_mm=round(radius)),
            )
            for name, true, radius in zip(names, trues, radii.tolist(), strict=True)
        ]
        gains = [
            (true.left_gain or one.left_gain, true.right_gain or one.right_gain)
            for true, one in zip(trues, own, strict=True)
        ]
        wheels = drivetrains(np.array(gains).T, section.speed_max_mm_s)
        lags = np.array([true.lag for true in trues])
        self.wheels = EmulatedRobots(self.robots, wheels, radii, lags, stage.timeline.now_ns)
        serial = not section.port.startswith(SCHEME)
        others = {section.port: stage.options.link} if serial and stage.options.link else {}
        self.radios = [
            LineRadio(
                stage,
                stage.wires.port(others.get(port, port)),
                section.baud,
                [robot for robot in self.robots if section.port_of(robot.name) == port],
                [section.index(name) for name in names],
                settings.loss,
                stage.options.seed + i,
            )
            for i, port in enumerate(section.ports())
        ]
