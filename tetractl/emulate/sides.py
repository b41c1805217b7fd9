"""The parts of an emulated lab: bodies that an actuator's side moves and a camera's side shows.

A further camera or actuator is emulated by a class like these and a line at the end.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

from tetractl.core.setup import Setup
from tetractl.emulate.faults import Fault
from tetractl.emulate.loop import Loop, Timeline
from tetractl.experiment.base import Model
from tetractl.experiment.lab_section import LabSection

Facts = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Options:
    """Addresses of the emulation. Port 0 takes any free one; None that of the spec.

    `record` is a file for the true events. `replace_after` [s]: robots that have stood still
    that long after a run are switched off and on and put back on their starts. `chosen`: the spec
    leaves it to the trial to choose its robots, so the dish has cells of its own.
    """

    address: str = "127.0.0.1"
    command_port: int | None = None
    data_port: int | None = None
    link: Path | None = None
    record: Path | None = None
    replace_after: float | None = None
    seed: int = 1
    chosen: bool = False


@dataclass(frozen=True, slots=True)
class Stage:
    """Shared by both sides; `setup` and `lab` are the spec's.

    `note(event, **facts)` adds to the record. A camera's side calls `exposed(exposure, frame)` at
    each exposure, `sent(exposure)` after its frame has left or, if none is sent, would have,
    and `client(address)` for each new client.
    """

    lab: LabSection
    setup: Setup
    timeline: Timeline
    options: Options
    note: Callable[..., None]
    exposed: Callable[[int, int], None]
    sent: Callable[[int], None]
    client: Callable[[str], None]

    @property
    def mm(self) -> float:
        """Millimetres in a length unit of the spec."""
        return self.setup.metres * 1000


class Body(Protocol):
    """A robot as it truly is: x, y [mm] and heading [rad] in the spec's axes."""

    name: str
    x: float
    y: float
    heading: float

    @property
    def standing(self) -> bool:
        """Whether it is at rest, as far as can be seen."""
        ...

    def place(self, x: float, y: float, heading: float) -> None:
        """Put it somewhere, at rest."""
        ...


class EmulatedSide(Protocol):
    """One device of an emulated lab.

    `Settings` is its part of a script's `emulation`, `faults` are those it can have.
    """

    Settings: ClassVar[type[Model]]
    faults: ClassVar[Sequence[type[Fault]]]

    def open(self, loop: Loop) -> Facts:
        """Take ports and names; return where the device is, for its clients."""
        ...

    def close(self) -> Facts:
        """Release ports and names; idempotent. Return counts for the record."""
        ...


class EmulatedCamera(EmulatedSide, Protocol):
    """Shows `bodies`, in their order, to its clients; made as (stage, settings, bodies)."""

    def hide(self, hidden: bool) -> None:
        """Let no body be tracked, as while all are carried, or show them again."""
        ...


class EmulatedActuator(EmulatedSide, Protocol):
    """Moves its `bodies`, in the order of the setup's robots; made as (stage, settings)."""

    @property
    def bodies(self) -> Sequence[Body]:
        """The robots at their true poses."""
        ...

    @property
    def driven(self) -> bool:
        """Whether any robot is made to move now."""
        ...

    @property
    def truth(self) -> Mapping[str, Any]:
        """The true state at present, for the record of each exposure."""
        ...

    def switch(self, on: bool) -> None:
        """Switch the robots off, as while they are carried, or on, which restarts them."""
        ...

    def advance(self, until_ns: int) -> None:
        """Move the robots on to `until_ns`."""
        ...

    def tick(self) -> None:
        """Do what is due every few milliseconds, such as sending answers."""
        ...
