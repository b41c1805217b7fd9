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
"""Function that ends a fault on a device."""
Begin = Callable[[Any, Any], Undo | None]
"""Function that begins a fault on a device, called as `begin(fault, device)`.

It returns a function that ends the fault, or None if nothing has to be undone.
"""
NO_FIELDS: Mapping[str, Any] = MappingProxyType({})
"""Default for the fields of a kind of fault: none."""
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""Type of a fault's field `share`: a fraction from 0 to 1."""


class Visible(Enum):
    """The event at which a fault becomes visible to our program."""

    EXPOSED = auto()
    """A frame that was exposed during the fault is sent."""
    SENT = auto()
    """A frame is sent during the fault."""
    AT_ONCE = auto()
    """The fault begins."""


class Fault(Model):
    """A fault in a script; `fault_kind` creates a subclass with further fields for each kind.

    Attributes:
        visible: The event at which the fault becomes visible.
        begin: Begins the fault, and returns a function that ends it. The result is None if nothing
            has to be undone.
        rows: The variants of the fault in randomised test runs. Empty if it is in no such run.
    """

    visible: ClassVar[Visible]
    begin: ClassVar[Callable[..., Undo | None]]
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
        """The name of the robot or cell that has the fault. None for a fault of a whole device."""
        fields = dict(self)
        return fields.get("robot", fields.get("cell"))

    def names(self) -> Iterator[str]:
        """Yield the names of the robots in the fault's fields `robot` and `other`, in this order.

        Nothing is yielded if the fault has no such fields.
        """
        fields = dict(self)
        yield from (fields[key] for key in ("robot", "other") if fields.get(key) is not None)


class ActingFaults:
    """The faults that act in a lab at present.

    Devices look up the faults that concern them, by the name of the kind and of the robot.

    Attributes:
        robots_are_carried: Whether a person carries the robots at present. No camera then shows
            them. This is not a fault.
    """

    robots_are_carried = False

    def __init__(self) -> None:
        self._faults: dict[str, list[Any]] = {}  # by kind, in the order in which they began

    @property
    def has_had_any(self) -> bool:
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
        return [fault for fault in faults if fault.robot == robot] if faults and robot else faults

    def newest(self, name: str, robot: str | None = None) -> Any:
        """Return the acting fault of a kind that began last.

        Args:
            name: Name of the kind.
            robot: Name of a robot, to consider only its faults. None to consider all faults.

        Returns:
            The fault. None if no such fault acts.
        """
        faults = self.of_kind(name, robot)
        return faults[-1] if faults else None

    def total_by(self, name: str, robot: str | None = None) -> float:
        """Return the sum of the fields `by` of all acting faults of a kind.

        Args:
            name: Name of the kind.
            robot: Name of a robot, to consider only its faults. None to consider all faults.

        Returns:
            The sum. 0 if no such fault acts.
        """
        return sum(fault.by for fault in self.of_kind(name, robot))

    def largest_share(self, name: str, robot: str | None = None) -> float:
        """Return the maximum of the fields `share` of all acting faults of a kind.

        Args:
            name: Name of the kind.
            robot: Name of a robot, to consider only its faults. None to consider all faults.

        Returns:
            The maximum. 0 if no such fault acts.
        """
        return max((fault.share for fault in self.of_kind(name, robot)), default=0.0)


def add_until_undone(entries: list[Any], entry: object) -> Undo:
    """Add an entry to a list, and return a function that removes it again."""
    entries.append(entry)
    return lambda: entries.remove(entry)


def begin_by_switching(
    switch_of: Callable[[Any, Any], Callable[[bool], None]], value_at_begin: bool = True
) -> Begin:
    """Create the function `begin` of a fault that flips a switch of its device while it lasts.

    Args:
        switch_of: Returns the switch, given the fault and the device. The switch is a function
            that is called with a bool.
        value_at_begin: The value for the switch when the fault begins. The switch gets the opposite
            value when the fault ends.
    """

    def begin(fault: Fault, device: Any) -> Undo | None:
        switch = switch_of(fault, device)
        switch(value_at_begin)
        return lambda: switch(not value_at_begin)

    return begin


def fault_kind(
    name: str,
    about: str,
    visible: Visible = Visible.AT_ONCE,
    fields: Mapping[str, Any] = NO_FIELDS,
    rows: Sequence[FaultRow] = (),
    begin: Begin = lambda fault, device: None,
) -> type[Fault]:
    """Create a kind of fault for a device's table of faults.

    Args:
        name: Name of the kind in scripts.
        about: Description of what the fault does, for the documentation.
        visible: The event at which the fault becomes visible.
        fields: The fault's fields in scripts, by name: a type, or a tuple of a type and a default.
        rows: Variants of the fault in randomised test runs.
        begin: Begins the fault on a device, and returns a function that ends it, or None.

    Returns:
        A subclass of `Fault`.
    """
    model_fields: dict[str, Any] = {"fault": (Literal[name], ...)}
    name_functions: dict[str, Any] = {}
    for key, field_type in fields.items():
        model_fields[key] = field_type if isinstance(field_type, tuple) else (field_type, ...)
        if key in NAME_FUNCTIONS and not isinstance(field_type, tuple):
            name_functions[key] = NAME_FUNCTIONS[key]
    undocumented = {"use_attribute_docstrings": False}  # else pydantic looks for the class's source
    kind = create_model(
        name, __base__=Fault, __doc__=about, __cls_kwargs__=undocumented, **model_fields
    )
    kind.visible = visible
    kind.begin = begin
    kind.rows = [replace(row, fault=name, fields={**name_functions, **row.fields}) for row in rows]
    return kind


def port_faults(
    device_name: str, unplugged_reasons: str, stuck_reasons: str
) -> tuple[type[Fault], type[Fault]]:
    """Create two kinds of faults of an actuator's port: it is unplugged, or accepts no bytes.

    Args:
        device_name: Name of the device on the port, for the names of the variants.
        unplugged_reasons: Regular expression. If the reason of an abort matches it, the lab has
            recognised that the port is unplugged.
        stuck_reasons: Regular expression. If the reason of an abort matches it, the lab has
            recognised that the port accepts no more bytes.
    """
    return (
        fault_kind(
            "unplug",
            "The cable of the actuator's port is unplugged.",
            rows=[FaultRow(f"{device_name} unplugged", unplugged_reasons)],
            begin=begin_by_switching(lambda f, d: d.set_plugged, False),
        ),
        fault_kind(
            "stuck_port",
            "The actuator's port accepts no more bytes.",
            rows=[FaultRow(f"{device_name} stuck", stuck_reasons)],
            begin=begin_by_switching(lambda f, d: d.set_stalled),
        ),
    )


MARK = fault_kind(
    "mark",
    "Not a fault: the emulation only reports that this named time has come.",
    fields={"name": Name},
)
"""Kind of a named time in a script, which the emulation only reports."""


class Injector:
    """Begins and ends the faults of a script at their times.

    Args:
        timeline: The emulation's timeline.
        faults: The faults of the script.
        device_of: Returns the device of a fault.
        report: Called with "start" and the fault when it becomes visible, and with "end" and the
            fault when it ends.

    Attributes:
        acting: The faults that act at present.
        faults: The faults of the script.
        device_of: Returns the device of a fault.
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
        self._newest_exposure = 0
        # faults that have begun but are not visible yet, each with its first exposure
        self._unreported: list[tuple[Fault, int]] = []
        self._past_events = set[str]()

    def note_event(self, event: str) -> None:
        """Schedule the faults whose times count from an event that has just happened.

        Only the first event of a kind counts.

        Args:
            event: Kind of the event: "start", "client", "run" or "stop"; see `Fault.since`.
        """
        if event in self._past_events:
            return
        self._past_events.add(event)
        for fault in self.faults:
            if fault.since == event:
                begin_ns = self._timeline.now_ns + round(fault.at * SECOND)
                self._timeline.at(begin_ns, lambda fault=fault: self._begin_and_report(fault))

    def note_exposure(self, exposure: int) -> None:
        """Note that a camera is about to take the exposure with this number. Numbers increase."""
        self._newest_exposure = exposure

    def note_frame_sent(self, exposure: int) -> None:
        """Report the faults that became visible with the frame of an exposure.

        To be called with the number of each exposure when its frame was sent, or when a fault has
        withheld the frame.
        """
        for fault, first_exposure in list(self._unreported):
            if fault.visible is Visible.SENT or exposure >= first_exposure:
                self._unreported.remove((fault, first_exposure))
                self._report("start", fault)

    def act(self, fault: Fault) -> Undo:
        """Begin a fault now without a report, and return a function that ends the fault."""
        self.acting.add(fault)
        undo = fault.begin(self.device_of(fault))

        def end_fault() -> None:
            self.acting.remove(fault)
            if undo is not None:
                undo()

        return end_fault

    def _begin_and_report(self, fault: Fault) -> None:
        """Begin a fault, report its start, and schedule its end if it has a duration.

        A fault that is visible at once is reported before it begins. Any other fault is reported
        when a frame shows it.
        """
        if fault.visible is Visible.AT_ONCE:
            self._report("start", fault)  # before it begins: a killed process reports nothing
        end_fault = self.act(fault)
        if fault.visible is not Visible.AT_ONCE:
            self._unreported.append((fault, self._newest_exposure + 1))
        if fault.duration is not None:
            ends_ns = self._timeline.now_ns + round(fault.duration * SECOND)

            def finish() -> None:
                end_fault()
                self._report("end", fault)

            self._timeline.at(ends_ns, finish)
