"""Begins and ends the faults of a script, and reports when each fault becomes visible.

A fault becomes visible with the first frame exposed during the fault, with the first frame sent
during it, or at once; see `Visible`. A table next to each device lists its faults. `fault_kind`
creates each of them, with its fields in a script and its variants in randomised test runs.

While a fault lasts, it is one of the lab's `ActingFaults`, which the devices query. A fault that
also acts when it begins has a function `begin(fault, device)`, which returns a function to end the
fault, or None.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from enum import Enum, auto
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, create_model

from tetractl.core.clock import SECOND
from tetractl.spec.base import Model, Name, NonNegative, Positive
from tetractl_emulator.fault_rows import NAME_FUNCTIONS, FaultRow
from tetractl_emulator.loop import Timeline

Undo = Callable[[], None]
"""Function that ends a fault."""
Begin = Callable[[Any, Any], Undo | None]
"""Function that begins a fault on a device, called as `begin(fault, device)`.

It returns a function that ends the fault, or None if nothing has to be undone.
"""
NO_FIELDS: Mapping[str, Any] = MappingProxyType({})
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Visible(Enum):
    """The event at which a fault becomes visible.

    EXPOSED: a frame that was exposed during the fault is sent. SENT: a frame is sent during the
    fault. AT_ONCE: the fault begins.
    """

    EXPOSED = auto()
    SENT = auto()
    AT_ONCE = auto()


class Fault(Model):
    """A scripted fault; `fault_kind` makes a subclass with further fields for each kind."""

    visible: ClassVar[Visible]
    # what is done as the fault begins; returns what is to be done when it ends
    begin: ClassVar[Callable[..., Undo | None]]
    # its variants on rehearsed days; none if it is in no rehearsal
    rows: ClassVar[Sequence[FaultRow]]
    fault: Any  # the name of its kind, as a Literal
    at: NonNegative = 0.0
    """Time of the fault after the event `since` [s]."""
    since: Literal["start", "client", "run", "stop"] = "run"
    """Event from which `at` counts: the `start` of the emulation, the first `client` of the
    cameras, the first command of a `run` that moves a robot, or the first `stop` of all robots
    after that, for example in a pause or at the end.
    """
    duration: Positive | None = Field(default=None, alias="for")
    """Duration of the fault [s]; by default the rest of the run."""

    @property
    def subject(self) -> str | None:
        """The name of the robot or cell that has the fault. None if the device has it."""
        fields = dict(self)
        return fields.get("robot", fields.get("cell"))

    def names(self) -> Iterator[str]:
        """Yield the robots that the fault names in its fields `robot` and `other`, in this order.

        Nothing is yielded if it names none.
        """
        fields = dict(self)
        yield from (fields[key] for key in ("robot", "other") if fields.get(key) is not None)


class ActingFaults:
    """The faults that act in a lab at present.

    Devices look up the faults that concern them, by the name of the kind and of the robot. While
    robots are `carried`, which is no fault, no camera shows them.
    """

    carried = False

    def __init__(self) -> None:
        self._faults: dict[str, list[Any]] = {}  # by kinds, in the order in which they began

    @property
    def any_yet(self) -> bool:
        """Whether any fault has begun in this lab so far, even if it has ended since."""
        return bool(self._faults)

    def add(self, fault: Fault) -> None:
        """Add a fault that begins to act now."""
        self._faults.setdefault(fault.fault, []).append(fault)

    def remove(self, fault: Fault) -> None:
        """Remove a fault that no longer acts. It must have been added before."""
        self._faults[fault.fault].remove(fault)

    def of_kind(self, name: str, robot: str | None = None) -> Sequence[Any]:
        """Return the acting faults of a kind, in the order in which they began.

        Args:
            name: Name of the kind.
            robot: Name of a robot, to return only its faults. None for the faults of all robots.
                Only for kinds with a field `robot`.
        """
        faults = self._faults.get(name, ())
        return [f for f in faults if f.robot == robot] if faults and robot else faults

    def newest(self, name: str, robot: str | None = None) -> Any:
        """Return the fault of a kind that began last, of one robot or, for None, of any.

        None if no such fault acts.
        """
        faults = self.of_kind(name, robot)
        return faults[-1] if faults else None

    def total_by(self, name: str, robot: str | None = None) -> float:
        """Return the sum of the fields `by` of the acting faults of a kind.

        Only those of one robot count if `robot` is not None. 0 if no such fault acts.
        """
        return sum(fault.by for fault in self.of_kind(name, robot))

    def largest_share(self, name: str, robot: str | None = None) -> float:
        """Return the maximum field `share` of the acting faults of a kind.

        Only those of one robot count if `robot` is not None. 0 if no such fault acts.
        """
        return max((fault.share for fault in self.of_kind(name, robot)), default=0.0)


def adding(running: list[Any], entry: object) -> Undo:
    """Add an entry to a list, and return a function that removes it again."""
    running.append(entry)
    return lambda: running.remove(entry)


def switching(act: Callable[[Any, Any], Callable[[bool], None]], on: bool = True) -> Begin:
    """Create a function `begin` for a fault that flips a switch while it lasts.

    Args:
        act: Returns the switch, given the fault and the device. The switch is a function of a bool.
        on: The value with which the switch is called when the fault begins. It is called with the
            opposite value when the fault ends.
    """

    def begin(fault: Fault, device: Any) -> Undo | None:
        switch = act(fault, device)
        switch(on)
        return lambda: switch(not on)

    return begin


def fault_kind(
    name: str,
    about: str,
    visible: Visible = Visible.AT_ONCE,
    fields: Mapping[str, Any] = NO_FIELDS,
    rows: Sequence[FaultRow] = (),
    begin: Begin = lambda fault, device: None,
) -> type[Fault]:
    """Create a kind of fault for a device's table.

    Args:
        name: Its name in scripts.
        about: What it does, for the documentation.
        visible: The event at which it becomes visible.
        fields: Its fields in scripts, by name: a type, or a type and a default.
        rows: Its variants in randomised test runs.
        begin: Begins the fault on a device, and returns a function to end it, or None.
    """
    columns: dict[str, Any] = {"fault": (Literal[name], ...)}
    named: dict[str, Any] = {}
    for key, field_type in fields.items():
        columns[key] = field_type if isinstance(field_type, tuple) else (field_type, ...)
        if key in NAME_FUNCTIONS and not isinstance(field_type, tuple):
            named[key] = NAME_FUNCTIONS[key]
    undocumented = {"use_attribute_docstrings": False}  # else pydantic looks for the class's source
    kind = create_model(name, __base__=Fault, __doc__=about, __cls_kwargs__=undocumented, **columns)
    kind.visible = visible
    kind.begin = begin
    kind.rows = [replace(row, fault=name, fields={**named, **row.fields}) for row in rows]
    return kind


def port_faults(what: str, unplugged: str, stuck: str) -> tuple[type[Fault], type[Fault]]:
    """Create two kinds of faults of an actuator's port: it is unplugged, or accepts no bytes.

    Args:
        what: The device, for the names of the variants.
        unplugged: Regular expression. If the reason of an abort matches it, the lab has recognised
            that the port is unplugged.
        stuck: The same for a port that accepts no more bytes.
    """
    return (
        fault_kind(
            "unplug",
            "The cable of the actuator's port is unplugged.",
            rows=[FaultRow(f"{what} unplugged", unplugged)],
            begin=switching(lambda f, d: d.plugged, False),
        ),
        fault_kind(
            "stuck_port",
            "The actuator's port accepts no more bytes.",
            rows=[FaultRow(f"{what} stuck", stuck)],
            begin=switching(lambda f, d: d.stall),
        ),
    )


MARK = fault_kind(
    "mark",
    "Not a fault: the emulation only reports that this named time has come.",
    fields={"name": Name},
)


class Injector:
    """Begins and ends the faults of a script at their times.

    Args:
        timeline: The emulation's timeline.
        faults: The faults of the script.
        device_of: Returns the device of a fault.
        report: Called with "start" and the fault when it becomes visible, and with "end" and the
            fault when it ends.
    """

    def __init__(
        self,
        timeline: Timeline,
        faults: Sequence[Fault],
        device_of: Callable[[Fault], Any],
        report: Callable[[str, Fault], None],
    ) -> None:
        self.acting = ActingFaults()
        self._timeline = timeline
        self.faults = faults
        self.device_of = device_of
        self._report = report
        self._newest = 0  # exposure
        self._pending: list[tuple[Fault, int]] = []  # and the first exposure during each
        self._since = set[str]()

    def happened(self, what: str) -> None:
        """Report an event: "start", "client", "run" or "stop"; see `Fault.since`.

        When an event happens for the first time, the faults whose times count from it are
        scheduled.
        """
        if what in self._since:
            return
        self._since.add(what)
        for fault in self.faults:
            if fault.since == what:
                start = self._timeline.now_ns + round(fault.at * SECOND)
                self._timeline.at(start, lambda fault=fault: self._begin(fault))

    def exposed(self, exposure: int) -> None:
        """Report that the exposure with this number is about to be taken. Numbers increase."""
        self._newest = exposure

    def sent(self, exposure: int) -> None:
        """Report that the frame of an exposure was sent, or withheld by a fault.

        Faults that have become visible by this frame are reported as started.
        """
        for fault, first in list(self._pending):
            if fault.visible is Visible.SENT or exposure >= first:
                self._pending.remove((fault, first))
                self._report("start", fault)

    def act(self, fault: Fault) -> Undo:
        """Begin a fault now, and return a function that ends it. Nothing is reported."""
        self.acting.add(fault)
        undo = fault.begin(self.device_of(fault))

        def end() -> None:
            self.acting.remove(fault)
            if undo is not None:
                undo()

        return end

    def _begin(self, fault: Fault) -> None:
        """Begin a fault, and schedule its end if it has a duration.

        A fault that is visible at once is reported now, before it begins. Any other is reported
        when a frame shows it.
        """
        if fault.visible is Visible.AT_ONCE:
            self._report("start", fault)  # before it: a killed process reports nothing
        end = self.act(fault)
        if fault.visible is not Visible.AT_ONCE:
            self._pending.append((fault, self._newest + 1))
        if fault.duration is not None:
            ends_ns = self._timeline.now_ns + round(fault.duration * SECOND)

            def finish() -> None:
                end()
                self._report("end", fault)

            self._timeline.at(ends_ns, finish)
