"""The emulated actuator of type `toio`: cubes, their connections and their faults."""

from collections.abc import Sequence
from random import Random
from typing import Annotated, Any, ClassVar

from pydantic import Field
from tetractl_emulator.fault_rows import CAMERA_REASONS, RADIO_REASONS
from tetractl_emulator.faults import ActingFaults, Fault, Share, port_faults
from tetractl_emulator.m3pi.robot import EmulatedRobot
from tetractl_emulator.m3pi.wheeled_side import (
    WHEELED_FAULTS,
    PortedSide,
    WheelsSettings,
)
from tetractl_emulator.sides import Stage

from tetractl.core.errors import UsageError
from tetractl.core.setup import Setup
from tetractl.lab.udp_port import SCHEME
from tetractl.spec.base import Model
from tetractl.spec.lab_section import LabSection
from tetractl_toio.emulated.cube import Connection, CubeProgram, to_whole_ms_ns
from tetractl_toio.messages import SPEED_MAX, WHEEL_MM_S
from tetractl_toio.section import ToioSection

EXCLUDED_FAULTS = (
    *("baud", "bad_bytes", "overtaken_packets", "stopped_elsewhere"),  # Bluetooth has one sender
    *("unplug", "stuck_port"),
)
"""Faults that emulated cubes do not have.

Bluetooth checks packets and keeps their order. The faults of ports are added separately, with other
reasons.
"""


class CubesSettings(WheelsSettings):
    """Properties of the connections and the cubes that differ from the spec.

    A battery is full at 5100 mV, and empty at 4400 mV.
    """

    loss: Share = 0.02
    """Fraction of the messages that are lost, in both directions."""
    interval: Annotated[float, Field(ge=0.008, le=0.5)] = 0.03
    """Time between two events of a connection [s].

    The events of different cubes are spread over it.
    """


class ConnectedCube(EmulatedRobot):
    """An emulated cube with its program and its connection.

    Args:
        name: Name of the robot.
        index: Index of the robot in the setup.
        battery_mv: Voltage of its battery without load [mV].
        acting: The faults that act now.
    """

    program: CubeProgram
    connection: Connection

    def __init__(self, name: str, index: int, battery_mv: int, acting: ActingFaults) -> None:
        super().__init__(name, index, battery_mv, self._start, acting)

    def _start(self, index: int) -> CubeProgram:
        """Create the cube's program, as after switching it on."""
        self.program = CubeProgram(index)
        return self.program


class EmulatedCubes(PortedSide):
    """The emulated actuator of type `toio`: a port for each cube, with the name of the cube.

    Raises:
        UsageError: If a cube of the spec has no UDP address, because Bluetooth cannot be emulated.
    """

    robots: Sequence[ConnectedCube]
    Settings: ClassVar[type[Model]] = CubesSettings
    faults: ClassVar[Sequence[type[Fault]]] = (
        # a cube reports its pose over the same connection
        *port_faults("radio", f"{RADIO_REASONS}|{CAMERA_REASONS}", RADIO_REASONS),
        *(kind for kind in WHEELED_FAULTS if kind.__name__ not in EXCLUDED_FAULTS),
    )

    @classmethod
    def world_of_day(cls, random: Random, lab: LabSection, setup: Setup) -> dict[str, Any]:
        """Sample connections and cubes of a randomised test run; see `tetractl_emulator.sides`."""
        settings = super().world_of_day(random, lab, setup)
        return settings | {"interval": round(random.uniform(0.01, 0.03), 3)}

    def __init__(self, stage: Stage, settings: CubesSettings) -> None:
        section = stage.lab.actuator
        assert isinstance(section, ToioSection), "the actuator's section has the type toio"
        in_memory = stage.wires.ports is not None
        if not in_memory and not all(robot.cube.startswith(SCHEME) for robot in section.robots):
            raise UsageError(
                "cubes that are connected by Bluetooth cannot be emulated",
                hint=(
                    f"give the cubes the addresses {SCHEME}127.0.0.1:9801 and so on, in "
                    "camera and actuator"
                ),
            )
        super().__init__(stage, settings, (SPEED_MAX, WHEEL_MM_S))
        interval_ns = to_whole_ms_ns(settings.interval)
        self.radios = []
        for i, (cube, spec_entry) in enumerate(zip(self.robots, self.spec_entries, strict=True)):
            port = stage.wires.port(spec_entry.cube)
            phase_ns = to_whole_ms_ns(settings.interval * i / len(self.spec_entries))
            timing = (interval_ns, phase_ns, settings.loss)
            seed = stage.options.seed + i
            cube.connection = Connection(stage, port, cube, self.robots, *timing, seed)
            self.radios.append(cube.connection)

    def make_robot(
        self, row: int, name: str, battery_mv: int, acting: ActingFaults
    ) -> ConnectedCube:
        """Create the cube of a robot; see `PortedSide.make_robot`."""
        return ConnectedCube(name, row, battery_mv, acting)

    def switch(self, on: bool) -> None:
        """Do nothing: cubes stay switched on while they are carried, to keep their connections."""
