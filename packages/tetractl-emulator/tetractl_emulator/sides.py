"""The interfaces of emulated cameras and actuators.

The emulated actuator moves robots as a program commands, and the emulated camera shows the robots
to the program. Each of the two emulated devices is called a *side* of the lab.

To emulate another camera or actuator, implement the interface, and name the class in the entry
points `tetractl.emulated_cameras` or `tetractl.emulated_actuators`. The classes of this package are
named in `tetractl_emulator.registries`.

A side takes part in randomised test runs (`tetractl lab rehearse`) with the `rows` of its faults.
It can have a class method `world_of_day(random, lab, setup)`, which samples its part of a script's
section `emulation`: a mapping of field names to values.
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
"""Facts about an event or a device, by name."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of an emulated lab.

    Attributes:
        address: Address at which the camera serves. None for the spec's address.
        command_port: UDP port for commands to the camera. 0 for any free port, None for the spec's.
        data_port: UDP port for the camera's frames. 0 for any free port, None for the spec's.
        port_link: Path to create for the actuator's serial port. None for the spec's.
        record: File for the true events, as JSON lines. None for no file.
        replace_after: After robots have stood still for this time after a run [s], they are
            switched off, put back on their starts and switched on. None to leave them where they
            are.
        seed: Seed of the emulation's random numbers.
        trials_choose_robots: Whether trials choose their robots among the cells in the dish. The
            emulation's settings then determine these cells.
        dish_seed: Seed of the cells in the dish. None for `seed`.
    """

    address: str | None = "127.0.0.1"
    command_port: int | None = None
    data_port: int | None = None
    port_link: Path | None = None
    record: Path | None = None
    replace_after: float | None = None
    seed: int = 1
    trials_choose_robots: bool = False
    dish_seed: int | None = None


@dataclass(frozen=True, slots=True)
class Stage:
    """The data and functions that the two emulated devices of a lab share.

    Attributes:
        lab: The lab's section of the spec.
        setup: The constants of the experiment.
        timeline: The emulation's timeline.
        options: Options of the emulation.
        note: Adds an event to the record, called as `note(event, **facts)`. None if there is no
            record.
        exposed: A camera calls it at each exposure, with the numbers of the exposure and the frame.
        sent: A camera calls it with an exposure's number when the frame is sent, or would be sent
            without a fault.
        client: A camera calls it with the address of each new client.
        wires: Creates the connections.
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
        """Size of a length unit of the spec [mm]."""
        return self.setup.metres * 1000


class Body(Protocol):
    """The true pose of a robot: x, y [mm] and heading [rad] in the spec's axes."""

    name: str
    x: float
    y: float
    heading: float

    @property
    def standing(self) -> bool:
        """Whether the robot stands still, or moves more slowly than a camera could detect."""
        ...

    def place(self, x: float, y: float, heading: float) -> None:
        """Put the robot at a pose, at standstill.

        Args:
            x: x [mm].
            y: y [mm].
            heading: Heading [rad].
        """
        ...


class EmulatedSide(Protocol):
    """An emulated device of a lab: its camera or its actuator.

    Attributes:
        Settings: Model of the device's settings in a script's section `emulation`.
        faults: The kinds of faults that the device can have.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def open(self, loop: Loop) -> Facts:
        """Open the device's ports.

        Args:
            loop: The event loop, which can watch the ports.

        Returns:
            Facts for clients, such as the device's address, by name.
        """
        ...

    def close(self) -> Facts:
        """Release the device's ports. Can be called repeatedly.

        Returns:
            Counts for the record, by name.
        """
        ...


class EmulatedCamera(EmulatedSide, Protocol):
    """An emulated camera. Its class is called with (stage, settings, bodies).

    Attributes:
        shown_ns: For each robot, the exposure time of the newest frame sent in which it is tracked
            [ns]. Empty if this is not known.
    """

    shown_ns: Sequence[int]

    @property
    def join(self) -> Any:
        """The object with which tetractl's camera connects to this emulated camera in memory.

        The object is the last argument of tetractl's camera.
        """
        ...


class EmulatedActuator(EmulatedSide, Protocol):
    """An emulated actuator. Its class is called with (stage, settings)."""

    @property
    def bodies(self) -> Sequence[Body]:
        """The robots at their true poses, in the order of the setup."""
        ...

    @property
    def driven(self) -> bool:
        """Whether the actuator drives any robot at present."""
        ...

    @property
    def truth(self) -> Mapping[str, Any]:
        """Facts about the present true state, by name. They are recorded at each exposure."""
        ...

    def switch(self, on: bool) -> None:
        """Switch all robots off or on.

        They are switched off, for example, while they are carried. Switching them on restarts their
        programs.
        """
        ...

    def advance(self, until_ns: int) -> None:
        """Advance the robots to the time `until_ns` [ns]."""
        ...

    def tick(self) -> None:
        """Do periodic work, such as sending answers. Called every few milliseconds."""
        ...
