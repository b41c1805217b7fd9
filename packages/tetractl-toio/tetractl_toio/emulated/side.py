"""The emulated actuator of type `toio`: cubes, their connections and their faults."""

from collections.abc import Sequence
from random import Random
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from tetractl_emulator.faults import Fault, Share
from tetractl_emulator.m3pi.robot import EmulatedBattery, EmulatedRobot, EmulatedRobots
from tetractl_emulator.m3pi.wheeled_side import WHEELED_FAULTS, PortedSide, robots_of_day
from tetractl_emulator.rehearsal.participants import Rehearsal
from tetractl_emulator.sides import Stage

from tetractl.core.errors import UsageError
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, Name, Positive
from tetractl.experiment.lab_section import LabSection, entry
from tetractl.lab.actuators.twist.actuator import drivetrains
from tetractl.lab.udp_port import SCHEME
from tetractl_toio.emulated.cube import Connection, CubeProgram, ns
from tetractl_toio.messages import SPEED_MAX, WHEEL_MM_S
from tetractl_toio.section import ToioSection

NONE = ("baud", "bad_bytes", "overtaken_packets", "stopped_elsewhere")
"""Faults that Bluetooth cannot have: it checks packets and keeps their order, with one sender."""


class TrueCube(Model):
    """A cube's true properties that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    left_gain: Positive | None = None
    """True speed of the left wheel over its nominal speed."""
    right_gain: Positive | None = None
    """True speed of the right wheel over its nominal speed."""
    lag: Annotated[float, Field(gt=0, le=1)] = 0.04
    """Time constant of the wheels [s]."""
    battery_mv: int = Field(default=5100, ge=0, le=9000)
    """The battery's voltage without load [mV]; 5100 is full, 4400 empty."""


class CubesSettings(Model):
    """Properties of the connections and the cubes that differ from the spec."""

    loss: Share = 0.02
    """Share of the messages, either way, that are lost."""
    interval: Annotated[float, Field(ge=0.008, le=0.5)] = 0.03
    """Time between two events of a connection [s]; those of different cubes are spread over it."""
    robots: tuple[TrueCube, ...] = ()
    """The cubes whose true properties differ from the spec."""


class ConnectedCube(EmulatedRobot):
    """An emulated cube, its program and its connection."""

    program: CubeProgram
    connection: Connection

    def __init__(self, name: str, index: int, battery: EmulatedBattery) -> None:
        super().__init__(name, index, battery, self._start)

    def _start(self, index: int) -> CubeProgram:
        self.program = CubeProgram(index)
        return self.program


class EmulatedCubes(PortedSide):
    """Emulated cubes, each at a port of its own, which has its name."""

    Settings: ClassVar[type[Model]] = CubesSettings
    faults: ClassVar[Sequence[type[Fault]]] = tuple(
        one for one in WHEELED_FAULTS if one.__name__ not in NONE
    )

    @classmethod
    def rehearsal(cls, lab: LabSection, setup: Setup) -> Rehearsal:
        """Return what rehearsals draw of connections and cubes."""

        def world(random: Random, off: bool) -> dict[str, Any]:
            drawn = robots_of_day(random, setup.names, off, "{}_gain", lambda s: round(s, 4))
            return drawn | {"interval": round(random.uniform(0.01, 0.03), 3)}

        return Rehearsal(world=world)

    def __init__(self, stage: Stage, settings: CubesSettings) -> None:
        section, names = stage.lab.actuator, stage.setup.names
        assert isinstance(section, ToioSection), "the actuator's section has the type toio"
        own = [entry(section.robots, name) for name in names]
        if stage.wires.ports is None and not all(one.cube.startswith(SCHEME) for one in own):
            raise UsageError(
                "cubes cannot be emulated at a Bluetooth adapter",
                hint=f"name them {SCHEME}127.0.0.1:9801 and so on, in camera and actuator",
            )
        truths = {truth.name: truth for truth in settings.robots}
        trues = [truths.get(name) or TrueCube(name=name) for name in names]
        self.timeline = stage.timeline
        self.robots = [
            ConnectedCube(name, i, EmulatedBattery(float(true.battery_mv)))
            for i, (name, true) in enumerate(zip(names, trues, strict=True))
        ]
        gains = [
            (true.left_gain or one.left_gain, true.right_gain or one.right_gain)
            for true, one in zip(trues, own, strict=True)
        ]
        wheels = drivetrains(np.array(gains).T * WHEEL_MM_S, SPEED_MAX)
        radii, lags = np.array([o.radius_mm for o in own]), np.array([t.lag for t in trues])
        self.wheels = EmulatedRobots(self.robots, wheels, radii, lags, stage.timeline.now_ns)
        interval = ns(settings.interval)
        self.radios = []
        for i, (cube, one) in enumerate(zip(self.robots, own, strict=True)):
            port, phase = stage.wires.port(one.cube), ns(settings.interval * i / len(own))
            timing, seed = (interval, phase, settings.loss), stage.options.seed + i
            cube.connection = Connection(stage, port, cube, self.robots, *timing, seed)
            self.radios.append(cube.connection)
