"""Makes the faults of a script happen, takes them back, and notes when each became visible.

A fault is visible when its first effect leaves on a wire: with the first frame exposed under it,
with the first frame sent under it, or at once.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING

from tetractl.lab.cameras.optitrack.messages import Version
from tetractl.lab.emulate.robot import Firmware
from tetractl.lab.emulate.script import Fault

if TYPE_CHECKING:
    from tetractl.lab.emulate.lab import EmulatedLab

Undo = Callable[[], None]
SECOND = 1_000_000_000


class Seen(Enum):
    """From when on a fault can be noticed."""

    EXPOSED = auto()
    SENT = auto()
    AT_ONCE = auto()


@dataclass(slots=True)
class _Pending:
    fault: Fault
    seen: Seen
    exposure: int | None = None  # the first one under the fault


@dataclass(slots=True)
class Injector:
    """Plans the faults of a script; `tell(event, fault)` hears of each."""

    lab: "EmulatedLab"
    faults: tuple[Fault, ...]
    tell: Callable[[str, Fault], None]
    _pending: list[_Pending] = field(default_factory=list)
    _since: set[str] = field(default_factory=set)

    def happened(self, what: str) -> None:
        """Plan the faults that count from `what`: start, client or run. Only the first counts."""
        if what in self._since:
            return
        self._since.add(what)
        now = self.lab.timeline.now_ns
        for fault in self.faults:
            if fault.since == what:
                start = now + round(fault.at * SECOND)
                self.lab.timeline.at(start, lambda fault=fault: self._begin(fault))

    def exposed(self, exposure: int) -> None:
        """Take note of an exposure, just before it."""
        for pending in self._pending:
            if pending.exposure is None:
                pending.exposure = exposure

    def sent(self, exposure: int) -> None:
        """Take note that a frame left, or would have."""
        for pending in list(self._pending):
            first = pending.exposure
            if pending.seen is Seen.SENT or (first is not None and exposure >= first):
                self._pending.remove(pending)
                self.tell("start", pending.fault)

    def _begin(self, fault: Fault) -> None:
        seen, act = ACTS[fault.fault]
        undo = act(self.lab, fault)
        if seen is Seen.AT_ONCE:
            self.tell("start", fault)
        else:
            self._pending.append(_Pending(fault, seen))
        if fault.duration is not None:
            end = self.lab.timeline.now_ns + round(fault.duration * SECOND)

            def finish() -> None:
                undo()
                self.tell("end", fault)

            self.lab.timeline.at(end, finish)


def _setting(target: object, **values: object) -> Undo:
    """Set attributes; the undo sets them back."""
    before = {name: getattr(target, name) for name in values}
    for name, value in values.items():
        setattr(target, name, value)

    def undo() -> None:
        for name, value in before.items():
            setattr(target, name, value)

    return undo


def _trouble(**values: object) -> Callable[["EmulatedLab", Fault], Undo]:
    return lambda lab, fault: _setting(lab.motive.trouble, **values)


def _version(lab: "EmulatedLab", fault: Fault) -> Undo:
    assert fault.version is not None
    major, minor = fault.version.split(".")
    return _setting(lab.motive.trouble, version=Version(int(major), int(minor)))


def _swap(lab: "EmulatedLab", fault: Fault) -> Undo:
    places = {lab.place_of(fault.robot), lab.place_of(fault.other)}
    return _setting(lab, swapped=places)


def _wheel_stuck(lab: "EmulatedLab", fault: Fault) -> Undo:
    stuck = fault.wheel in ("left", "both"), fault.wheel in ("right", "both")
    return _setting(lab.robot(fault.robot), stuck=stuck)


def _wrong_id(lab: "EmulatedLab", fault: Fault) -> Undo:
    assert fault.id is not None
    number = fault.id

    def boot() -> Firmware:
        return Firmware(number)

    return _setting(lab.robot(fault.robot), boot=boot, program=boot())


def _low_battery(lab: "EmulatedLab", fault: Fault) -> Undo:
    assert fault.millivolts is not None
    return _setting(lab.robot(fault.robot).battery, open_mv=float(fault.millivolts), sag_mv=0.0)


def _unplug(lab: "EmulatedLab", fault: Fault) -> Undo:
    lab.unplug()
    return lab.plug


def _stuck_port(lab: "EmulatedLab", fault: Fault) -> Undo:
    lab.port.stall(True)
    return lambda: lab.port.stall(False)


def _off(lab: "EmulatedLab", fault: Fault) -> Undo:
    robot = lab.robot(fault.robot)
    robot.switch(False)
    return lambda: robot.switch(True)


Act = Callable[["EmulatedLab", Fault], Undo]
ACTS: dict[str, tuple[Seen, Act]] = {
    "no_server": (Seen.SENT, _trouble(silent=True)),
    "no_frames": (Seen.SENT, _trouble(no_frames=True)),
    "freeze": (Seen.SENT, _trouble(frozen=True)),
    "counter_back": (
        Seen.EXPOSED,
        lambda lab, fault: _setting(lab.motive.trouble, counter=fault.frames),
    ),
    "edit_mode": (Seen.EXPOSED, _trouble(edit_mode=True)),
    "bad_datagrams": (
        Seen.SENT,
        lambda lab, fault: _setting(lab.motive.trouble, damaged=fault.share),
    ),
    "other_version": (Seen.SENT, _version),
    "untracked": (
        Seen.EXPOSED,
        lambda lab, fault: _setting(lab.sight(fault.robot), tracked=False),
    ),
    "jump": (Seen.EXPOSED, lambda lab, fault: _setting(lab.sight(fault.robot), shift=fault.by)),
    "swap": (Seen.EXPOSED, _swap),
    "nan": (Seen.EXPOSED, lambda lab, fault: _setting(lab.sight(fault.robot), nan=True)),
    "bad_quaternion": (
        Seen.EXPOSED,
        lambda lab, fault: _setting(lab.sight(fault.robot), norm=0.5),
    ),
    "veer": (
        Seen.AT_ONCE,
        lambda lab, fault: _setting(lab.robot(fault.robot), veer=fault.counts),
    ),
    "wheel_stuck": (Seen.AT_ONCE, _wheel_stuck),
    "unplug": (Seen.AT_ONCE, _unplug),
    "stuck_port": (Seen.AT_ONCE, _stuck_port),
    "loss": (Seen.AT_ONCE, lambda lab, fault: _setting(lab.radio, loss=fault.share)),
    "off": (Seen.AT_ONCE, _off),
    "wrong_id": (Seen.AT_ONCE, _wrong_id),
    "low_battery": (Seen.AT_ONCE, _low_battery),
    "mark": (Seen.AT_ONCE, lambda lab, fault: lambda: None),
}
"""What each fault does and from when it can be noticed."""
