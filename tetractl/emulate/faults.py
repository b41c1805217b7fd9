"""Faults of a script: makes them happen, takes them back, and notes when each became visible.

A fault is visible when its first effect leaves on a wire: with the first frame exposed under it,
with the first frame sent under it, or at once. The faults themselves are beside the device that
has them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, ClassVar, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.emulate.loop import Timeline
from tetractl.experiment.base import Model, Name, NonNegative, Positive

Undo = Callable[[], None]


class Visible(Enum):
    """From when on a fault can be noticed."""

    EXPOSED = auto()
    SENT = auto()
    AT_ONCE = auto()


class Fault(Model):
    """One thing that goes wrong; further fields are those of its kind."""

    visible: ClassVar[Visible] = Visible.AT_ONCE
    fault: Any  # each fault's own name, as a Literal
    at: NonNegative = 0.0
    """When, after `since` [s]."""
    since: Literal["start", "client", "run"] = "run"
    """`start` of the emulation, the first `client` of the cameras, or the first command of a `run`
    that moves a robot."""
    duration: Positive | None = Field(default=None, alias="for")
    """How long [s]; for good by default."""

    def begin(self, device: Any) -> Undo:
        """Make it happen to the device that it belongs to; return what takes it back."""
        raise NotImplementedError

    def names(self) -> Iterator[str]:
        """Yield the robots it names."""
        for key in ("robot", "other"):
            if (name := getattr(self, key, None)) is not None:
                yield name


class Mark(Fault):
    """Nothing goes wrong: it is only reported, for a test to act on."""

    fault: Literal["mark"]
    name: Name
    """What the mark is called."""

    def begin(self, device: Any) -> Undo:
        """Do nothing."""
        return lambda: None


class Unplug(Fault):
    """The actuator's port is pulled out."""

    fault: Literal["unplug"]

    def begin(self, device: Any) -> Undo:
        """Take the port away."""
        device.unplug()
        return device.plug


class StuckPort(Fault):
    """The actuator's port takes no bytes."""

    fault: Literal["stuck_port"]

    def begin(self, device: Any) -> Undo:
        """Stall the port."""
        device.port.stall(True)
        return lambda: device.port.stall(False)


def setting(target: object, **values: object) -> Undo:
    """Set attributes; the undo sets them back."""
    before = {name: getattr(target, name) for name in values}
    for name, value in values.items():
        setattr(target, name, value)

    def undo() -> None:
        for name, value in before.items():
            setattr(target, name, value)

    return undo


@dataclass(slots=True)
class _Pending:
    fault: Fault
    exposure: int | None = None  # the first one under the fault


@dataclass(slots=True)
class Injector:
    """Plans the faults of a script; `device_of` returns what a fault happens to.

    `report(phase, fault)` is called at the start, once visible, and at the end of each.
    """

    timeline: Timeline
    faults: tuple[Fault, ...]
    device_of: Callable[[Fault], Any]
    report: Callable[[str, Fault], None]
    _pending: list[_Pending] = field(default_factory=list)
    _since: set[str] = field(default_factory=set)

    def happened(self, what: str) -> None:
        """Plan the faults that count from `what`: start, client or run. Only the first counts."""
        if what in self._since:
            return
        self._since.add(what)
        for fault in self.faults:
            if fault.since == what:
                start = self.timeline.now_ns + round(fault.at * SECOND)
                self.timeline.at(start, lambda fault=fault: self._begin(fault))

    def exposed(self, exposure: int) -> None:
        """Note an exposure, just before it."""
        for pending in self._pending:
            if pending.exposure is None:
                pending.exposure = exposure

    def sent(self, exposure: int) -> None:
        """Note that a frame left, or would have."""
        for pending in list(self._pending):
            first = pending.exposure
            at_sending = pending.fault.visible is Visible.SENT
            if at_sending or (first is not None and exposure >= first):
                self._pending.remove(pending)
                self.report("start", pending.fault)

    def _begin(self, fault: Fault) -> None:
        undo = fault.begin(self.device_of(fault))
        if fault.visible is Visible.AT_ONCE:
            self.report("start", fault)
        else:
            self._pending.append(_Pending(fault))
        if fault.duration is not None:
            end = self.timeline.now_ns + round(fault.duration * SECOND)

            def finish() -> None:
                undo()
                self.report("end", fault)

            self.timeline.at(end, finish)
