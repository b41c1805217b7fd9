"""What a script may change of the emulated cameras of type `optitrack`: settings and faults."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated, Any, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive
from tetractl.lab.cameras.optitrack.natnet import Version
from tetractl.lab.cameras.optitrack.section import Ipv4, VersionText
from tetractl_emulator.faults import Fault, Share, Undo, Visible, fault, setting, settings, together
from tetractl_emulator.optitrack.tracked_body import Change, TrackedBody, halved, nowhere, rolled

CLOCK_HZ = 10_000_000


class TrueBody(Model):
    """True properties of a robot's rigid body that differ from the spec."""

    name: Name
    """Name of a robot of the spec."""
    heading_offset: Finite | None = None
    """Heading of the robot minus heading of its rigid body [rad]."""
    body: str | None = Field(default=None, min_length=1, max_length=64)
    """Name of the body in Motive."""
    streamed: bool = True
    """Whether the body is in the frames; it is always in the list of names."""


class OptitrackSettings(Model):
    """Properties of the cameras that differ from the spec."""

    version: VersionText = "4.1"
    """The camera server's protocol version, 2.5 or later; frames of 2.5 have the layout of 2.6.
    Versions above 4.3 have the layout of 4.3 with longer descriptions of rigid bodies."""
    keeps_version: bool = False
    """Whether the server streams in its own version to clients that request another version."""
    frames_from: Ipv4 | None = None
    """Address from which frames are sent, such as a second network card; by default the server's.
    """
    answers_models: bool = True
    """Whether the server reports the names of its rigid bodies."""
    models_changed: bool = False
    """Whether every frame reports that the rigid bodies have changed."""
    rate: float = Field(default=120.0, ge=1, le=500)
    """Camera frames per second [Hz]."""
    latency: float = Field(default=0.0054, ge=0, le=1)
    """Mean time from exposure to transmission [s]; on average, one frame in 250 is delayed further,
    by up to nearly half a frame period."""
    unit_mm: Positive = 1000.0
    """Unit of length that the server reports [mm]; positions are always in metres."""
    noise_mm: NonNegative = 0.0
    """Standard deviation of a body's position along each axis of the floor [mm]."""
    noise_rad: NonNegative = 0.0
    """Standard deviation of a body's heading [rad]."""
    knows_up_axis: bool = True
    """Whether the server answers `UpAxis`."""
    robots: tuple[TrueBody, ...] = ()
    """Robots whose rigid bodies have another name or heading offset than in the spec, or are not
    streamed."""


@dataclass(eq=False, slots=True, weakref_slot=True)
class Trouble:
    """The present faults: the server is silent (no answers, no frames), sends no frames, repeats
    the same frame (`frozen`), has set its frame counter back by `counter`, is in edit mode, damages
    the fraction `damaged` of its frames, packs frames in another `version`, or sends `outdated`
    frames whose exposure times are `outdated_s` [s] too early. It sends frames `late_s` late, up to
    `jitter_s` later still at random, each once more if `doubled`, at most `hz` of them a second.
    """

    silent: bool = False
    no_frames: bool = False
    frozen: bool = False
    counter: int = 0
    edit_mode: bool = False
    damaged: float = 0.0
    version: Version | None = None
    outdated: int = 0
    outdated_s: float = 0.0
    late_s: float = 0.0
    jitter_s: float = 0.0
    doubled: bool = False
    hz: float = math.inf


@dataclass(eq=False, slots=True, weakref_slot=True)
class ServerClock:
    """The server's clock. Up to the host time `since_ns` it is `ahead_ns` ahead of the host's
    clock; from then on it advances by `rate` seconds per second.
    """

    ahead_ns: int = 0
    rate: float = 1.0
    since_ns: int = 0

    def ticks(self, when_ns: int) -> int:
        """Return the time on the server's clock [ticks] at a time on the host's clock [ns]."""
        gained = round((self.rate - 1.0) * max(0, when_ns - self.since_ns))
        start = 0x1234_5678_9ABC  # of the server's clock, which is arbitrary [ticks]
        return start + (when_ns + self.ahead_ns + gained) * CLOCK_HZ // SECOND


def _body(device: Any, fault: Any) -> TrackedBody:
    return device.tracked_body(fault.robot)


def _trouble(
    name: str, about: str, visible: Visible, fields: Mapping[str, Any] = {}, **values: object
) -> type[Fault]:
    """Return a kind of fault of the server, which sets attributes of its `Trouble`."""
    return fault(name, about, settings(lambda d, f: d.trouble, **values), visible, **fields)


def _of_body(
    name: str, about: str, fields: Mapping[str, Any] = {}, **values: object
) -> type[Fault]:
    """Return a kind of fault of one robot's rigid body, which sets attributes of the body."""
    return fault(name, about, settings(_body, **values), EXPOSED, robot=Name, **fields)


def _changed(name: str, about: str, change: Callable[[Any], Change], **fields: Any) -> type[Fault]:
    """Return a kind of fault of one robot's rigid body, also changed by `change(fault)`."""

    def begin(fault: Any, device: Any) -> Undo:
        changes, own = _body(device, fault).changes, change(fault)
        changes.append(own)
        return lambda: changes.remove(own)

    return fault(name, about, begin, EXPOSED, robot=Name, **fields)


def _repeat(fault: Any, device: Any) -> Undo:
    chosen = [b for b in device.tracked if fault.robot in (None, b.robot.name)]
    return together([setting(body, repeats=True) for body in chosen])


def _swap(fault: Any, device: Any) -> Undo:
    return setting(device, swapped={device.place_of(fault.robot), device.place_of(fault.other)})


def _set_clock(fault: Any, device: Any) -> Undo:
    clock: ServerClock = device.clock
    return setting(clock, ahead_ns=clock.ahead_ns + round(fault.by * SECOND))


def _run_clock(fault: Any, device: Any) -> Undo:
    return setting(device.clock, rate=fault.rate, since_ns=device.timeline.now_ns)


def _picture(fault: Any, device: Any) -> Undo:
    way, view = complex(*fault.by), device.view
    if fault.creeps:
        return setting(view, creeps=(way, fault.scale, fault.turn))
    shift, grown, turned = view.shift + way, view.grown * fault.scale, view.turned + fault.turn
    return setting(view, shift=shift, grown=grown, turned=turned)


def _twin(fault: Any, device: Any) -> Undo:
    return setting(_body(device, fault), id=device.tracked_body(fault.other).id)


SENT, EXPOSED = Visible.SENT, Visible.EXPOSED
Frames = Annotated[int, Field(ge=1, le=1_000_000)]
Axes = Literal["floor", "robot"]
FAULTS = (
    _trouble("no_server", "The server sends nothing.", SENT, silent=True),
    _trouble("no_frames", "No frames are sent.", SENT, no_frames=True),
    _trouble("freeze", "The same frame is sent repeatedly.", SENT, frozen=True),
    _trouble(
        "counter_back",
        "The frame number goes back by this number.",
        EXPOSED,
        {"frames": Frames},
        counter=attrgetter("frames"),
    ),
    _trouble("edit_mode", "Motive is in edit mode.", EXPOSED, edit_mode=True),
    _trouble(
        "bad_datagrams",
        "A fraction of the frames is damaged.",
        SENT,
        {"share": Share},
        damaged=attrgetter("share"),
    ),
    _trouble(
        "other_version",
        "Frames have another protocol version than the server reports.",
        SENT,
        {"version": VersionText},
        version=lambda f: Version.of(f.version),
    ),
    _trouble(
        "outdated",
        "This number of frames has exposure times that are too early by this time [s].",
        EXPOSED,
        {"by": Positive, "frames": (Frames, 1)},
        outdated=attrgetter("frames"),
        outdated_s=attrgetter("by"),
    ),
    _trouble(
        "late_frames", "Frames are late [s].", SENT, {"by": Positive}, late_s=attrgetter("by")
    ),
    _trouble(
        "reordered",
        "Frames are late by a random time up to this one [s], so that some overtake others.",
        SENT,
        {"by": Positive},
        jitter_s=attrgetter("by"),
    ),
    _trouble("doubled_frames", "Each frame is sent twice.", SENT, doubled=True),
    _trouble(
        "slow_frames",
        "At most this number of frames is sent each second.",
        SENT,
        {"rate": Positive},
        hz=attrgetter("rate"),
    ),
    fault(
        "picture",
        "The whole picture is displaced [mm], grown by a factor and turned [rad], by so much in "
        "each frame if it creeps.",
        _picture,
        EXPOSED,
        by=(Point, (0.0, 0.0)),
        scale=(Positive, 1.0),
        turn=(Finite, 0.0),
        creeps=(bool, False),
    ),
    _of_body("untracked", "A body is not tracked; its last pose is repeated.", tracked=False),
    _of_body(
        "half_tracked",
        "A body is not tracked in this fraction of the frames.",
        {"share": Share},
        missing=attrgetter("share"),
    ),
    _of_body(
        "jump",
        "A body's pose jumps by this distance [mm].",
        {"by": Point},
        shift=lambda f: complex(*f.by),
    ),
    _of_body(
        "ghost",
        "A body's pose moves away from its robot: by this distance [mm] and angle [rad] in each "
        "frame, along the spec's axes or along and left of the robot's heading.",
        {"by": Point, "axes": (Axes, "floor"), "turn": (Finite, 0.0)},
        step=lambda f: complex(*f.by),
        own=lambda f: f.axes == "robot",
        turn=attrgetter("turn"),
        shift=0j,
        turned=0.0,
    ),
    _of_body(
        "slip",
        "A robot's marker plate slips by this distance along and left of its heading [mm], and "
        "turns by an angle [rad].",
        {"by": Point, "turn": (Finite, 0.0)},
        plate=lambda f: complex(*f.by),
        plate_turned=attrgetter("turn"),
    ),
    _of_body(
        "lifted",
        "A body is seen at this height above the floor [mm].",
        {"height": Finite},
        height=attrgetter("height"),
    ),
    _changed(
        "tipped",
        "A body is seen rolled about its own x axis by this angle [rad].",
        lambda f: rolled(f.angle),
        angle=Finite,
    ),
    _changed("nan", "A body's position is not a number.", lambda f: nowhere),
    _changed("bad_quaternion", "A body's quaternion does not have norm 1.", lambda f: halved),
    fault(
        "repeat",
        "The pose of a body, or of all bodies, is repeated in new frames.",
        _repeat,
        EXPOSED,
        robot=(Name | None, None),
    ),
    fault("swap", "Two bodies swap identities.", _swap, EXPOSED, robot=Name, other=Name),
    fault("twin_id", "A body has the id of another body.", _twin, EXPOSED, robot=Name, other=Name),
    fault("clock_jump", "The server's clock is set forward by a time [s].", _set_clock, by=Finite),
    fault(
        "clock_rate",
        "The server's clock advances by this time [s] each second.",
        _run_clock,
        rate=Positive,
    ),
)
