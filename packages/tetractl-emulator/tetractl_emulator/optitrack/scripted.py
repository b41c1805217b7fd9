"""What a script may change of the emulated cameras of type `optitrack`: settings and faults.

`OptitrackSettings` holds for a whole run. `FAULTS`, at the end, is the table of faults: what each
sets while it lasts is the server's `Trouble` or its clock, one robot's `TrackedBody`, or the
`View` of all; and its rows in rehearsals. Lengths are in mm, angles in rad, times in s;
displacements are complex, x + iy.

When a fault ends, all is as it would be without it: after `clock_rate`, too, the server's clock
is right again, so it jumps back by what it has gained. Only a picture that crept stays where it
is, as when a tripod stops slipping. Faults of the clock, of the whole picture and of a body's
reported pose add up; of others that set the same attribute, the newest holds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated, Any, Literal

from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.experiment.base import Finite, Model, Name, NonNegative, Point, Positive
from tetractl.lab.cameras.optitrack.natnet import Version
from tetractl.lab.cameras.optitrack.section import Ipv4, VersionText
from tetractl_emulator.fault_rows import (
    CLOCK,
    FRAME_S,
    LATE,
    MOVED,
    NOTHING,
    PLACE,
    SIGHT,
    FaultRow,
    along,
    between,
    factor,
    first_robot,
    lost,
    off,
    one_of,
    part,
    signed,
)
from tetractl_emulator.faults import (
    NO_FIELDS,
    Fault,
    Share,
    Undo,
    Visible,
    adding,
    fault_kind,
    setting,
    settings,
    together,
)
from tetractl_emulator.optitrack.tracked_body import (
    BodyChange,
    PictureChange,
    TrackedBody,
    View,
    rolled,
    with_halved_quaternion,
    without_position,
)

CLOCK_HZ = 10_000_000
"""Ticks of the server's clock in a second."""
CLOCK_START = 0x1234_5678_9ABC
"""The server's clock when the host's is 0 [ticks]: an arbitrary value."""


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
    """What is wrong with the server now, with its frames or their sending; faults set the fields,
    and restore them when they end.
    """

    counter: int = 0
    """By how much the frame counter has been set back."""
    edit_mode: bool = False
    """Whether Motive is in edit mode."""
    damaged: float = 0.0
    """Fraction of the frames that are damaged."""
    version: Version | None = None
    """Protocol version of the frames, if it is another than the server reports."""
    outdated: int = 0
    """Number of frames to come whose exposure times are too early."""
    outdated_s: float = 0.0
    """By how much the exposure times of those frames are too early [s]."""
    swapped: tuple[int, int] | None = None
    """The indices of two bodies that exchange their ids."""
    silent: bool = False
    """Whether the server gives no answers and sends no frames."""
    no_frames: bool = False
    """Whether it sends no frames, but gives answers."""
    frozen: bool = False
    """Whether it sends the same frame again and again."""
    late_s: float = 0.0
    """Time by which frames are sent late [s]."""
    jitter_s: float = 0.0
    """Greatest random time by which frames are sent later still [s]."""
    doubled: bool = False
    """Whether each frame is sent twice."""
    hz: float = math.inf
    """Most frames that are sent in a second."""


@dataclass(frozen=True, eq=False, slots=True)
class ClockError:
    """An error of the server's clock from the host time `since_ns` on: it is set forward by
    `ahead_ns`, and advances by `rate` seconds per second.
    """

    since_ns: int
    ahead_ns: int = 0
    rate: float = 1.0

    def gained_ns(self, when_ns: int) -> int:
        """Return what the clock has gained by a time on the host's clock [ns]."""
        return self.ahead_ns + round((self.rate - 1.0) * max(0, when_ns - self.since_ns))


# Kinds of faults, by what they act on: `sets` are attributes and their values, or functions of the
# fault that give them; `fields` are what a script has to say of the fault. A name that the object
# does not have is an AttributeError when the fault begins: the tests begin one of each kind.

SENT = Visible.SENT
EXPOSED = Visible.EXPOSED


def _server_fault(
    name: str,
    about: str,
    visible: Visible,
    rows: Sequence[FaultRow],
    sets: Mapping[str, object],
    fields: Mapping[str, Any] = NO_FIELDS,
) -> type[Fault]:
    """Return a kind of fault of the server, which sets attributes of its `Trouble`."""
    begin = settings(lambda fault, device: device.trouble, **sets)
    return fault_kind(name, about, begin, visible, fields, rows)


def _body_fault(
    name: str,
    about: str,
    rows: Sequence[FaultRow],
    part: Callable[[TrackedBody], object],
    sets: Mapping[str, object],
    fields: Mapping[str, Any] = NO_FIELDS,
) -> type[Fault]:
    """Return a kind of fault of one robot's rigid body, which sets attributes of a part of it."""
    begin = settings(lambda fault, device: part(_body(fault, device)), **sets)
    return fault_kind(name, about, begin, EXPOSED, {"robot": Name, **fields}, rows)


def _pose_fault(
    name: str,
    about: str,
    rows: Sequence[FaultRow],
    change_of: Callable[[Any], BodyChange],
    fields: Mapping[str, Any] = NO_FIELDS,
) -> type[Fault]:
    """Return a kind of fault that changes each reported pose of one robot's rigid body, by the
    function `change_of(fault)`.
    """

    def begin(fault: Any, device: Any) -> Undo:
        return adding(_body(fault, device).changes, change_of(fault))

    return fault_kind(name, about, begin, EXPOSED, {"robot": Name, **fields}, rows)


def _body(fault: Any, device: Any) -> TrackedBody:
    return device.tracked_body(fault.robot)


def _displacement(fault: Any) -> complex:
    return complex(*fault.by)


def _repeat_poses(fault: Any, device: Any) -> Undo:
    bodies = device.tracked if fault.robot is None else [_body(fault, device)]
    return together([setting(body.tracking, repeats=True) for body in bodies])


def _swap_bodies(fault: Any, device: Any) -> Undo:
    places = (device.place_of(fault.robot), device.place_of(fault.other))
    return setting(device.trouble, swapped=places)


def _twin_ids(fault: Any, device: Any) -> Undo:
    twin = device.tracked_body(fault.other)
    return setting(_body(fault, device).asset, number=twin.asset.number)


def _set_clock(fault: Any, device: Any) -> Undo:
    error = ClockError(device.timeline.now_ns, ahead_ns=round(fault.by * SECOND))
    return adding(device.clock.errors, error)


def _run_clock(fault: Any, device: Any) -> Undo:
    return adding(device.clock.errors, ClockError(device.timeline.now_ns, rate=fault.rate))


def _change_picture(fault: Any, device: Any) -> Undo:
    """Change the picture at once, or let it creep from now on; what it has crept remains."""
    view: View = device.view
    change = PictureChange(_displacement(fault), fault.scale, fault.turn)
    if fault.creeps:
        return adding(view.creeping, change)
    view.apply(change)
    return lambda: view.take_back(change)


# parts of a `TrackedBody`
TRACKING = attrgetter("tracking")
DISPLACEMENT = attrgetter("displacement")

Frames = Annotated[int, Field(ge=1, le=1_000_000)]
Axes = Literal["floor", "robot"]

FAULTS = (
    # of the server
    _server_fault(
        "no_server",
        "The server sends nothing.",
        SENT,
        [FaultRow("server silent", f"{SIGHT}|{CLOCK}")],
        {"silent": True},
    ),
    _server_fault(
        "no_frames",
        "No frames are sent.",
        SENT,
        [FaultRow("frames lost", SIGHT)],
        {"no_frames": True},
    ),
    _server_fault(
        "freeze",
        "The same frame is sent repeatedly.",
        SENT,
        [FaultRow("frames frozen", SIGHT)],
        {"frozen": True},
    ),
    _server_fault(
        "counter_back",
        "The frame number goes back by this number.",
        EXPOSED,
        [FaultRow("counter back", "counter", {"frames": 30})],
        sets={"counter": attrgetter("frames")},
        fields={"frames": Frames},
    ),
    _server_fault(
        "edit_mode",
        "Motive is in edit mode.",
        EXPOSED,
        [FaultRow("edit mode", "edit mode")],
        {"edit_mode": True},
    ),
    _server_fault(
        "bad_datagrams",
        "A fraction of the frames is damaged.",
        SENT,
        [FaultRow("frames damaged", f"damaged|{SIGHT}|{PLACE}", {"share": part(0.005, 1.3)})],
        sets={"damaged": attrgetter("share")},
        fields={"share": Share},
    ),
    _server_fault(
        "other_version",
        "Frames have another protocol version than the server reports.",
        SENT,
        [FaultRow("other version", f"damaged|{SIGHT}", {"version": one_of("2.9", "3.0")})],
        sets={"version": lambda fault: Version.of(fault.version)},
        fields={"version": VersionText},
    ),
    _server_fault(
        "outdated",
        "This number of frames has exposure times that are too early by this time [s].",
        EXPOSED,
        [FaultRow("frames of the past", LATE, {"by": between(0.05, 30), "frames": 50})],
        sets={"outdated": attrgetter("frames"), "outdated_s": attrgetter("by")},
        fields={"by": Positive, "frames": (Frames, 1)},
    ),
    _server_fault(
        "late_frames",
        "Frames are late [s].",
        SENT,
        [FaultRow("frames late", LATE, {"by": between(0.003, 0.4)})],
        sets={"late_s": attrgetter("by")},
        fields={"by": Positive},
    ),
    _server_fault(
        "reordered",
        "Frames are late by a random time up to this one [s], so that some overtake others.",
        SENT,
        [FaultRow("frames reordered", LATE, {"by": between(0.002, 0.3)})],
        sets={"jitter_s": attrgetter("by")},
        fields={"by": Positive},
    ),
    _server_fault(
        "doubled_frames",
        "Each frame is sent twice.",
        SENT,
        [FaultRow("frames doubled", NOTHING, weight=0.5)],
        {"doubled": True},
    ),
    _server_fault(
        "slow_frames",
        "At most this number of frames is sent each second.",
        SENT,
        [FaultRow("frames slow", MOVED, {"rate": between(100, 1)})],
        sets={"hz": attrgetter("rate")},
        fields={"rate": Positive},
    ),
    # of the whole picture
    fault_kind(
        "picture",
        "The whole picture is displaced [mm], grown by a factor and turned [rad], by so much in "
        "each frame if it creeps; what it has crept remains.",
        _change_picture,
        EXPOSED,
        fields={
            "by": (Point, (0.0, 0.0)),
            "scale": (Positive, 1.0),
            "turn": (Finite, 0.0),
            "creeps": (bool, False),
        },
        rows=[
            FaultRow("origin jumps", MOVED, {"by": off(3, 300)}),
            FaultRow("scale jumps", MOVED, {"scale": factor(2e-3, 0.2)}),
            FaultRow("axes jump", MOVED, {"turn": signed(2e-3, 1)}),
            FaultRow("origin creeps", MOVED, {"by": off(2, 300, FRAME_S), "creeps": True}),
            FaultRow("scale creeps", MOVED, {"scale": factor(2e-3, 0.2, FRAME_S), "creeps": True}),
            FaultRow("axes creep", MOVED, {"turn": signed(0.02, 2, FRAME_S), "creeps": True}),
        ],
    ),
    # of one body
    _body_fault(
        "untracked",
        "A body is not tracked; its last pose is repeated.",
        [FaultRow("untracked", SIGHT)],
        TRACKING,
        sets={"tracked": False},
    ),
    _body_fault(
        "half_tracked",
        "A body is not tracked in this fraction of the frames.",
        [FaultRow("tracked in part", SIGHT, {"share": lost})],
        TRACKING,
        sets={"missing": attrgetter("share")},
        fields={"share": Share},
    ),
    _body_fault(
        "jump",
        "A body's pose jumps by this distance [mm].",
        [FaultRow("pose jumps", MOVED, {"by": off(5, 500)})],
        DISPLACEMENT,
        sets={"shift": _displacement},
        fields={"by": Point},
    ),
    _body_fault(
        "ghost",
        "A body's pose moves away from its robot: by this distance [mm] and angle [rad] in each "
        "frame, along the spec's axes or along and left of the robot's heading.",
        [
            FaultRow("ghost drives", MOVED, {"by": along(3, 600, 0.0), "axes": "robot"}),
            FaultRow("ghost slides", MOVED, {"by": along(3, 600, math.pi / 2), "axes": "robot"}),
            FaultRow("ghost drifts", MOVED, {"by": off(3, 600, FRAME_S)}),
            FaultRow("ghost turns", MOVED, {"by": [0, 0], "turn": signed(0.02, 4, FRAME_S)}),
        ],
        DISPLACEMENT,
        sets={
            "step": _displacement,
            "along_robot": lambda fault: fault.axes == "robot",
            "turn_step": attrgetter("turn"),
            "strayed": 0j,
            "strayed_turn": 0.0,
        },
        fields={"by": Point, "axes": (Axes, "floor"), "turn": (Finite, 0.0)},
    ),
    _body_fault(
        "slip",
        "A robot's marker plate slips by this distance along and left of its heading [mm], and "
        "turns by an angle [rad].",
        [FaultRow("plate slips", MOVED, {"by": off(2, 60), "turn": signed(0.02, 1.5)})],
        attrgetter("plate"),
        sets={"slip": _displacement, "turned": attrgetter("turn")},
        fields={"by": Point, "turn": (Finite, 0.0)},
    ),
    _body_fault(
        "lifted",
        "A body is seen at this height above the floor [mm].",
        [FaultRow("lifted", SIGHT, {"height": between(80, 2e3)})],
        DISPLACEMENT,
        sets={"height": attrgetter("height")},
        fields={"height": Finite},
    ),
    _pose_fault(
        "tipped",
        "A body is seen rolled about its own x axis by this angle [rad].",
        [FaultRow("tipped", SIGHT, {"angle": signed(0.05, 3.1)})],
        lambda fault: rolled(fault.angle),
        fields={"angle": Finite},
    ),
    _pose_fault(
        "nan",
        "A body's position is not a number.",
        [FaultRow("nan", SIGHT)],
        lambda fault: without_position,
    ),
    _pose_fault(
        "bad_quaternion",
        "A body's quaternion does not have norm 1.",
        [FaultRow("bad_quaternion", SIGHT)],
        lambda fault: with_halved_quaternion,
    ),
    # of several bodies
    fault_kind(
        "repeat",
        "The pose of a body, or of all bodies, is repeated in new frames.",
        _repeat_poses,
        EXPOSED,
        fields={"robot": (Name | None, None)},
        rows=[
            FaultRow("pose frozen", MOVED, {"robot": first_robot}),
            FaultRow("picture frozen", MOVED),
        ],
    ),
    fault_kind(
        "swap",
        "Two bodies swap identities.",
        _swap_bodies,
        EXPOSED,
        fields={"robot": Name, "other": Name},
        rows=[FaultRow("identities swapped", MOVED)],
    ),
    fault_kind(
        "twin_id",
        "A body has the id of another body.",
        _twin_ids,
        EXPOSED,
        fields={"robot": Name, "other": Name},
        rows=[FaultRow("twin ids", "2 rigid bodies")],
    ),
    # of the server's clock
    fault_kind(
        "clock_jump",
        "The server's clock is set forward by a time [s].",
        _set_clock,
        fields={"by": Finite},
        rows=[FaultRow("camera's clock jumps", LATE, {"by": signed(5e-4, 5)})],
    ),
    fault_kind(
        "clock_rate",
        "The server's clock advances by this time [s] each second.",
        _run_clock,
        fields={"rate": Positive},
        rows=[FaultRow("camera's clock drifts", LATE, {"rate": factor(2e-4, 0.5)})],
    ),
)
"""The faults of these cameras, as a script names them."""
