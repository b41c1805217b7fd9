"""The emulated actuator of type `twist`: robots that run the compiled firmware, and their ports."""

from collections.abc import Sequence
from functools import partial
from typing import ClassVar

from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.udp_port import SCHEME
from tetractl_emulator.faults import ActingFaults, Fault
from tetractl_emulator.firmware import TwistCore
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import (
    DRIVEN_ELSEWHERE,
    WHEELED_FAULTS,
    PortedSide,
    WheelsSettings,
)
from tetractl_emulator.sides import Stage
from tetractl_emulator.twist.radio import LineRadio


class EmulatedTwist(PortedSide):
    """Emulated robots that run the compiled core of the firmware, on the ports of the spec."""

    faults: ClassVar[Sequence[type[Fault]]] = (DRIVEN_ELSEWHERE, *WHEELED_FAULTS)

    def __init__(self, stage: Stage, settings: WheelsSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, TwistSection), "the actuator's section has the type twist"
        self._section = section
        super().__init__(stage, settings, (section.speed_max_mm_s, 1.0))
        is_serial = not section.port.startswith(SCHEME)
        link_by_port = (
            {section.port: stage.options.port_link} if is_serial and stage.options.port_link else {}
        )
        indices = [section.index(name) for name in stage.setup.names]
        self.radios = []
        for i, port in enumerate(section.ports()):
            robots_on_port = [robot for robot in self.robots if section.port_of(robot.name) == port]
            device_port = stage.wires.port(link_by_port.get(port, port))
            seed = stage.options.seed + i
            radio = LineRadio(
                stage, device_port, section.baud, robots_on_port, indices, settings.loss, seed
            )
            self.radios.append(radio)

    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> EmulatedRobot:
        """Create a robot with the compiled core of the firmware; see `PortedSide.make_robot`."""
        core = partial(TwistCore, radius_mm=round(float(self.radii[row])))
        return EmulatedRobot(name, self._section.index(name), battery_mv, core, acting)
