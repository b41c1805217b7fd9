"""Triggers and undoes the faults of a script, and records when each became visible.

A fault becomes visible with the first frame exposed during the fault, with the first frame sent
during it, or at once; see `Visible`. A table next to each device lists its faults; `fault` makes
each row.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Annotated, Any, ClassVar, Literal
from weakref import WeakKeyDictionary

from pydantic import Field, create_model

from tetractl.core.clock import SECOND
from tetractl.experiment.base import Model, Name, NonNegative, Positive
from tetractl_emulator.loop import Timeline

Undo = Callable[[], None]
Begin = Callable[[Any, Any], Undo]  # arguments: device and fault
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Visible(Enum):
    """The event at which a fault becomes visible: a frame exposed during the fault is sent, a frame
    is sent during the fault, or the fault starts.
    """

    EXPOSED = auto()
    SENT = auto()
    AT_ONCE = auto()


class Fault(Model):
    """A scripted fault; the function `fault` makes a subclass with further fields for each kind."""

    visible: ClassVar[Visible]
    # starts the fault on a device and returns the function that ends it
    begin: ClassVar[Callable[..., Undo]]
    fault: Any  # the name of its kind, as a Literal
    at: NonNegative = 0.0
    """Time of the fault after the event `since` [s]."""
    since: Literal["start", "client", "run", "stop"] = "run"
    """Event from which `at` counts: the `start` of the emulation, the first `client` of the
    cameras, the first command of a `run` that moves a robot, or the first `stop` of all robots
    after it, as in a pause or at the end.
    """
    duration: Positive | None = Field(default=None, alias="for")
    """Duration of the fault [s]; by default the rest of the run."""

    def names(self) -> Iterator[str]:
        """Yield the names of robots in the fault's fields."""
        own = dict(self)
        yield from (own[key] for key in ("robot", "other") if own.get(key) is not None)


@dataclass(eq=False, slots=True)
class _Set:
    before: dict[str, Any]  # the attributes' values before they were set


_SET: WeakKeyDictionary[Any, list[_Set]] = WeakKeyDictionary()
"""What faults that go on have set of an object, in the order in which they began."""


def setting(target: object, **values: object) -> Undo:
    """Set attributes of `target`, an object that is compared by identity; return the function that
    restores the attributes' values. What another fault has set since remains until that one ends.
    """
    own = _Set({name: getattr(target, name) for name in values})
    _SET.setdefault(target, []).append(own)
    for name, value in values.items():
        setattr(target, name, value)

    def undo() -> None:
        running = _SET[target]
        later = running[running.index(own) + 1 :]
        running.remove(own)
        for name, value in own.before.items():
            if since := next((one for one in later if name in one.before), None):
                since.before[name] = value
            else:
                setattr(target, name, value)

    return undo


def together(undos: Sequence[Undo]) -> Undo:
    """Return the function that ends several faults at once."""

    def undo() -> None:
        for each in undos:
            each()

    return undo


def settings(target: Callable[[Any, Any], object], **values: object) -> Begin:
    """Return a function that starts a fault: it sets attributes of `target(device, fault)` to
    `values`. A value may be a function of the fault.
    """

    def begin(fault: Fault, device: Any) -> Undo:
        now = {name: v(fault) if callable(v) else v for name, v in values.items()}
        return setting(target(device, fault), **now)

    return begin


def switching(act: Callable[[Any, Any], Callable[[bool], None]], on: bool = True) -> Begin:
    """Return a function that starts a fault: it gets a switch, `act(device, fault)`, and calls it
    with `on`. The fault ends when the switch is called with `not on`.
    """

    def begin(fault: Fault, device: Any) -> Undo:
        switch = act(device, fault)
        switch(on)
        return lambda: switch(not on)

    return begin


def fault(
    name: str, about: str, begin: Begin, visible: Visible = Visible.AT_ONCE, /, **keys: Any
) -> type[Fault]:
    """Return a kind of fault: a row of a device's table.

    `keys` are the fields that the kind has in a script in addition to those of `Fault`: each a
    type, or a pair of type and default.
    """
    fields: dict[str, Any] = {"fault": (Literal[name], ...)}
    for key, kind in keys.items():
        fields[key] = kind if isinstance(kind, tuple) else (kind, ...)
    made = create_model(name, __base__=Fault, __doc__=about, **fields)
    made.visible, made.begin = visible, begin
    return made


UNPLUG = fault(
    "unplug", "The actuator's port is unplugged.", switching(lambda d, f: d.plugged, False)
)
STUCK_PORT = fault(
    "stuck_port", "The actuator's port takes no bytes.", switching(lambda d, f: d.port.stall)
)
MARK = fault(
    "mark", "Not a fault: only reports a named time.", lambda f, d: lambda: None, name=Name
)


@dataclass(slots=True)
class _Pending:
    fault: Fault
    exposure: int | None = None  # the first exposure during the fault


@dataclass(slots=True)
class Injector:
    """Schedules the faults of a script; `device_of` returns the device of a fault.

    `report(phase, fault)` is called with the phase "start" when a fault becomes visible, and with
    the phase "end" when it ends.
    """

    timeline: Timeline
    faults: tuple[Fault, ...]
    device_of: Callable[[Fault], Any]
    report: Callable[[str, Fault], None]
    _pending: list[_Pending] = field(default_factory=list)
    _since: set[str] = field(default_factory=set)

    def happened(self, what: str) -> None:
        """Record an event (start, client, run or stop); when it first happens, schedule the faults
        whose times count from it.
        """
        if what in self._since:
            return
        self._since.add(what)
        for fault in self.faults:
            if fault.since == what:
                start = self.timeline.now_ns + round(fault.at * SECOND)
                self.timeline.at(start, lambda fault=fault: self._begin(fault))

    def exposed(self, exposure: int) -> None:
        """Record that the exposure with this number is about to be taken."""
        for pending in self._pending:
            if pending.exposure is None:
                pending.exposure = exposure

    def sent(self, exposure: int) -> None:
        """Record that the frame of the exposure with this number was sent, or withheld by a
        fault.
        """
        for pending in list(self._pending):
            first = pending.exposure
            at_sending = pending.fault.visible is Visible.SENT
            if at_sending or (first is not None and exposure >= first):
                self._pending.remove(pending)
                self.report("start", pending.fault)

    def _begin(self, fault: Fault) -> None:
        if fault.visible is Visible.AT_ONCE:
            self.report("start", fault)  # before it: a killed process reports nothing
        undo = fault.begin(self.device_of(fault))
        if fault.visible is not Visible.AT_ONCE:
            self._pending.append(_Pending(fault))
        if fault.duration is not None:
            end = self.timeline.now_ns + round(fault.duration * SECOND)

            def finish() -> None:
                undo()
                self.report("end", fault)

            self.timeline.at(end, finish)
