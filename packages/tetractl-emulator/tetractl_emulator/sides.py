"""What an emulated camera and an emulated actuator must be able to do.

The actuator moves bodies as a program asks, and the camera shows them to it. The class that
emulates one of the two is called a *side* of the lab.

To emulate another camera or actuator, implement the interface and name the class in the entry
points `tetractl.emulated_cameras` or `tetractl.emulated_actuators`; those of this package are named
in `tetractl_emulator.registries`. A side takes part in rehearsals by the `rows` of its faults; it
may have a class method `world_of_day(random, lab, setup)`, which draws its section of `emulation`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

from tetractl.core.setup import Setup
from tetractl.spec.base import Model
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.faults import ActingFaults, Fault
from tetractl_emulator.loop import Loop, Timeline
from tetractl_emulator.wires import Wires

Facts = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the emulation.

    Attributes:
        address: Address at which devices listen. None for the spec's.
        command_port: UDP port for commands. 0 for any free port, None for the spec's.
        data_port: UDP port for frames. 0 for any free port, None for the spec's.
        link: Name of the serial port. None for the spec's.
        record: File for the true events. None for no file.
        replace_after: Robots that have stood still for this time after a run [s] are switched off,
            put back on their starts and switched on. None leaves them where they are.
        seed: Determines everything random.
        chosen: Whether trials choose their cells. The emulation's settings then give the cells in
            the dish.
        dish: Seed of these cells. None for `seed`.
    """

    address: str | None = "127.0.0.1"
    command_port: int | None = None
    data_port: int | None = None
    link: Path | None = None
    record: Path | None = None
    replace_after: float | None = None
    seed: int = 1
    chosen: bool = False
    dish: int | None = None


@dataclass(frozen=True, slots=True)
class Stage:
    """The data and functions that the lab's emulated devices share.

    Attributes:
        lab: The section of the lab in the spec.
        setup: The constants of the experiment.
        timeline: The timeline of the emulation.
        options: Options of the emulation.
        note: Adds an event with its facts to the record. None if no record is kept.
        exposed: A camera calls it at each exposure, with the numbers of exposure and frame.
        sent: A camera calls it with the number of an exposure when its frame is sent, or would be
            sent without a fault.
        client: A camera calls it with the address of each new client.
        wires: Opens the ends of connections.
        acting: The faults that act now.
    """

    lab: LabSection
    setup: Setup
    timeline: Timeline
    options: Options
    note: Callable[..., None] | None
    exposed: Callable[[int, int], None]
    sent: Callable[[int], None]
    client: Callable[[str], None]
    wires: Wires = field(default_factory=Wires)
    acting: ActingFaults = field(default_factory=ActingFaults)

    @property
    def mm(self) -> float:
        """Millimetres per length unit of the spec."""
        return self.setup.metres * 1000


class Body(Protocol):
    """The true state of a robot: x, y [mm] and heading [rad] in the spec's axes."""

    name: str
    x: float
    y: float
    heading: float

    @property
    def standing(self) -> bool:
        """Whether the robot is at rest, or moves more slowly than a camera could detect."""
        ...

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the robot at a pose, standing still.

        Args:
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        ...


class EmulatedSide(Protocol):
    """One device of an emulated lab.

    `Settings` is the model of the device's section in a script's `emulation`; `faults` are the
    faults that the device can have.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def open(self, loop: Loop) -> Facts:
        """Open ports and names; return facts for the clients, such as the device's address."""
        ...

    def close(self) -> Facts:
        """Release ports and names; return counts to be recorded. May be called twice."""
        ...


class EmulatedCamera(EmulatedSide, Protocol):
    """Shows `bodies`, in order, to its clients; constructed with (stage, settings, bodies).

    `shown_ns` is when each robot was exposed in the newest frame sent in which it is tracked [ns];
    empty if that is not known.
    """

    shown_ns: Sequence[int]

    @property
    def join(self) -> Any:
        """What our camera is given to reach this one over wires in memory."""
        ...


class EmulatedActuator(EmulatedSide, Protocol):
    """An emulated actuator, which moves its `bodies`. It is constructed with (stage, settings)."""

    @property
    def bodies(self) -> Sequence[Body]:
        """The robots at their true poses."""
        ...

    @property
    def driven(self) -> bool:
        """Whether any robot is being driven."""
        ...

    @property
    def truth(self) -> Mapping[str, Any]:
        """Facts of the present true state, to be recorded at each exposure."""
        ...

    def switch(self, on: bool) -> None:
        """Switch the robots off, for example to carry them, or on.

        Switching them on restarts their programs.
        """
        ...

    def advance(self, until_ns: int) -> None:
        """Advance the robots to `until_ns`."""
        ...

    def tick(self) -> None:
        """Do periodic work, such as sending answers; called every few milliseconds."""
        ...
