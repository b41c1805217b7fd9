"""The emulated actuator of type `twist`: ports, and robots with the firmware's core."""

from collections.abc import Sequence
from functools import partial
from random import Random
from typing import Any, ClassVar

from tetractl.core.setup import Setup
from tetractl.experiment.base import Model
from tetractl.experiment.lab_section import LabSection, entry
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import radii_mm
from tetractl.lab.udp_port import SCHEME
from tetractl_emulator.faults import Fault
from tetractl_emulator.firmware import TwistCore
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import (
    WHEELED_FAULTS,
    PortedSide,
    WheelsSettings,
    gains_of,
    gains_of_day,
)
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio


class EmulatedTwist(PortedSide):
    """Robots that run the firmware's core, on the ports of the spec."""

    Settings: ClassVar[type[Model]] = WheelsSettings
    faults: ClassVar[Sequence[type[Fault]]] = WHEELED_FAULTS

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Draw radio and robots of a rehearsed day."""
        section = lab.actuator
        assert isinstance(section, TwistSection), "the actuator's section has the type twist"
        return gains_of_day(random, setup, section.robots)

    def __init__(self, stage: Stage, settings: WheelsSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, TwistSection), "the actuator's section has the type twist"
        names = stage.setup.names
        trues = settings.trues(names)
        robots = [entry(section.robots, name) for name in names]
        radii = radii_mm(stage.setup, [robot.radius_mm for robot in robots])
        self.robots = [
            EmulatedRobot(
                name,
                section.index(name),
                true.battery_mv,
                partial(TwistCore, radius_mm=round(radius)),
                stage.acting,
            )
            for name, true, radius in zip(names, trues, radii.tolist(), strict=True)
        ]
        gains = gains_of(section.robots, names)
        self.roll(stage, trues, gains, radii, (section.speed_max_mm_s, 1.0))
        serial = not section.port.startswith(SCHEME)
        others = {section.port: stage.options.link} if serial and stage.options.link else {}
        indices = [section.index(name) for name in names]
        self.radios = []
        for i, port in enumerate(section.ports()):
            on_port = [robot for robot in self.robots if section.port_of(robot.name) == port]
            wire = stage.wires.port(others.get(port, port))
            seed = stage.options.seed + i
            radio = LineRadio(stage, wire, section.baud, on_port, indices, settings.loss, seed)
            self.radios.append(radio)
