"""Settings and faults of the emulated cameras of type `optitrack`, for use in a script.

`OptitrackSettings` apply to a whole run. `FAULTS`, at the end, is the table of faults. The camera
and its rigid bodies look up which of them act. Lengths are in mm, angles in rad, times in s.

When a fault ends, everything is as if it had never occurred. For example, the server's clock is
right again after `clock_rate`, so it jumps back by the time that it has gained. The only exception
is an image that crept: it stays where it is, as when a tripod stops slipping. Faults that displace
or delay add up. Of other faults of the same kind, the strongest or the newest counts.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import Field

from tetractl.lab.cameras.optitrack.section import Ipv4, VersionText
from tetractl.spec.base import Finite, Model, Name, NonNegative, Point, Positive
from tetractl_emulator.fault_rows import (
    CAMERA_REASONS,
    CLOCK_REASONS,
    FRAME_S,
    LATE_REASONS,
    MOVED_REASONS,
    NO_REASON,
    PLACE_REASONS,
    FaultRow,
    along_line,
    factor_near_one,
    first_robot,
    fraction_between,
    lost_fraction,
    one_of,
    scaled_vector,
    signed_value,
    value_between,
    whole_number,
)
from tetractl_emulator.faults import Share, Undo, Visible, add_until_undone, fault_kind

CLOCK_HZ = 10_000_000
"""Frequency of the server's clock, in ticks per second [Hz]."""
CLOCK_START = 0x1234_5678_9ABC
"""The server's clock when the host's clock is 0 [ticks]. The value is arbitrary."""


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
    """Properties of the emulated OptiTrack server that a fault script may change."""

    version: VersionText = "4.1"
    """The camera server's protocol version, 2.5 or later.

    Frames of 2.5 have the layout of 2.6. Versions above 4.3 have the layout of 4.3 with longer
    descriptions of rigid bodies.
    """
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
    """Mean time from exposure to transmission [s].

    On average, one frame in 250 is delayed further, by up to nearly half a frame period.
    """
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
    streamed.
    """


SENT = Visible.SENT
EXPOSED = Visible.EXPOSED


def _begin_clock_rate(fault: Any, device: Any) -> Undo:
    """Begin the fault `clock_rate`: let the server's clock run faster or slower from now on.

    It returns a function that ends this, so the clock then jumps back.
    """
    since_ns = device.timeline.now_ns

    def gained_ns(when_ns: int) -> int:
        return round((fault.rate - 1.0) * max(0, when_ns - since_ns))

    return add_until_undone(device.clock_errors, gained_ns)


def _creeping_row(name: str, **fields: Any) -> FaultRow:
    """Create a variant of a fault that creeps. In 30 % of the test runs it begins at the start."""
    return FaultRow(name, MOVED_REASONS, fields, start_fraction=0.3)


Frames = Annotated[int, Field(ge=1, le=1_000_000)]
Axes = Literal["floor", "robot"]

FAULTS = (
    fault_kind(
        "no_server",
        "The server sends nothing.",
        SENT,
        rows=[FaultRow("server silent", f"{CAMERA_REASONS}|{CLOCK_REASONS}")],
    ),
    fault_kind(
        "no_frames",
        "The server sends no frames.",
        SENT,
        rows=[FaultRow("frames lost", CAMERA_REASONS)],
    ),
    fault_kind(
        "freeze",
        "The server sends the same frame repeatedly.",
        SENT,
        rows=[FaultRow("frames frozen", CAMERA_REASONS)],
    ),
    fault_kind(
        "counter_back",
        "The frame number goes back by this count.",
        EXPOSED,
        fields={"frames": Frames},
        rows=[FaultRow("counter back", "counter", {"frames": 30})],
    ),
    fault_kind(
        "edit_mode", "Motive is in edit mode.", EXPOSED, rows=[FaultRow("edit mode", "edit mode")]
    ),
    fault_kind(
        "bad_datagrams",
        "A fraction of the frames is damaged.",
        SENT,
        fields={"share": Share},
        rows=[
            FaultRow(
                "frames damaged",
                f"damaged|{CAMERA_REASONS}|{PLACE_REASONS}",
                {"share": fraction_between(0.005, 1.3)},
            )
        ],
    ),
    fault_kind(
        "other_version",
        "Frames use another protocol version than the one that the server reports.",
        SENT,
        fields={"version": VersionText},
        rows=[
            FaultRow(
                "other version", f"damaged|{CAMERA_REASONS}", {"version": one_of("2.9", "3.0")}
            )
        ],
    ),
    fault_kind(
        "outdated",
        "The exposure times stated in the frames are too early by this time [s].",
        EXPOSED,
        fields={"by": Positive},
        rows=[FaultRow("frames of the past", LATE_REASONS, {"by": value_between(0.05, 30)})],
    ),
    fault_kind(
        "late_frames",
        "Frames arrive late by this time [s].",
        SENT,
        fields={"by": Positive},
        rows=[FaultRow("frames late", LATE_REASONS, {"by": value_between(0.003, 0.4)})],
    ),
    fault_kind(
        "reordered",
        "Frames arrive late by a random time of up to this value [s], so that some overtake "
        "others.",
        SENT,
        fields={"by": Positive},
        rows=[FaultRow("frames reordered", LATE_REASONS, {"by": value_between(0.002, 0.3)})],
    ),
    fault_kind(
        "doubled_frames",
        "Each frame is sent twice.",
        SENT,
        rows=[FaultRow("frames doubled", NO_REASON, weight=0.5)],
    ),
    fault_kind(
        "slow_frames",
        "The server sends at most this number of frames per second.",
        SENT,
        fields={"rate": Positive},
        rows=[FaultRow("frames slow", MOVED_REASONS, {"rate": value_between(100, 1)})],
    ),
    fault_kind(
        "picture",
        "All poses are displaced [mm], scaled by a factor and turned [rad]. If `creeps` is "
        "true, this is added in each frame, and the displacement remains after the fault.",
        EXPOSED,
        fields={
            "by": (Point, (0.0, 0.0)),
            "scale": (Positive, 1.0),
            "turn": (Finite, 0.0),
            "creeps": (bool, False),
        },
        rows=[
            FaultRow("origin jumps", MOVED_REASONS, {"by": scaled_vector(3, 300)}),
            FaultRow("scale jumps", MOVED_REASONS, {"scale": factor_near_one(2e-3, 0.2)}),
            FaultRow("axes jump", MOVED_REASONS, {"turn": signed_value(2e-3, 1)}),
            _creeping_row("origin creeps", by=scaled_vector(2, 300, FRAME_S), creeps=True),
            _creeping_row("scale creeps", scale=factor_near_one(2e-3, 0.2, FRAME_S), creeps=True),
            _creeping_row("axes creep", turn=signed_value(0.02, 2, FRAME_S), creeps=True),
        ],
    ),
    fault_kind(
        "untracked",
        "A body is not tracked; the frames repeat its last pose.",
        EXPOSED,
        fields={"robot": Name},
        rows=[FaultRow("untracked", CAMERA_REASONS)],
    ),
    fault_kind(
        "half_tracked",
        "A body is not tracked in this fraction of the frames, or is tracked in only one of "
        "this number of frames.",
        EXPOSED,
        fields={"robot": Name, "share": (Share, 0.0), "every": (Frames, 1)},
        rows=[
            FaultRow("tracked in part", CAMERA_REASONS, {"share": lost_fraction}),
            FaultRow(
                "tracked at times",
                CAMERA_REASONS,
                {"every": whole_number(24, 34), "for": value_between(6, 16)},
                weight=2.0,
            ),
        ],
    ),
    fault_kind(
        "jump",
        "A body's pose jumps by this distance [mm].",
        EXPOSED,
        fields={"robot": Name, "by": Point},
        rows=[FaultRow("pose jumps", MOVED_REASONS, {"by": scaled_vector(5, 500)})],
    ),
    fault_kind(
        "ghost",
        "A body's pose drifts away from its robot: by this distance [mm] and angle [rad] in "
        "each frame. The distance is along the spec's axes, or along and to the left of the "
        "robot's heading.",
        EXPOSED,
        fields={"robot": Name, "by": Point, "axes": (Axes, "floor"), "turn": (Finite, 0.0)},
        rows=[
            _creeping_row("ghost drives", by=along_line(20, 300, 0.0), axes="robot"),
            _creeping_row("ghost slides", by=along_line(20, 300, math.pi / 2), axes="robot"),
            _creeping_row("ghost drifts", by=scaled_vector(20, 300, FRAME_S)),
            _creeping_row("ghost turns", by=[0, 0], turn=signed_value(0.02, 4, FRAME_S)),
        ],
    ),
    fault_kind(
        "slip",
        "A robot's marker plate slips along and to the left of its heading by this distance "
        "[mm], and turns by this angle [rad].",
        EXPOSED,
        fields={"robot": Name, "by": Point, "turn": (Finite, 0.0)},
        rows=[
            FaultRow(
                "plate slips",
                MOVED_REASONS,
                {"by": scaled_vector(2, 60), "turn": signed_value(0.02, 1.5)},
            )
        ],
    ),
    fault_kind(
        "lifted",
        "The camera sees a body at this height above the floor [mm].",
        EXPOSED,
        fields={"robot": Name, "height": Finite},
        rows=[FaultRow("lifted", CAMERA_REASONS, {"height": value_between(80, 2e3)})],
    ),
    fault_kind(
        "tipped",
        "The camera sees a body rolled about its own x axis by this angle [rad].",
        EXPOSED,
        fields={"robot": Name, "angle": Finite},
        rows=[FaultRow("tipped", CAMERA_REASONS, {"angle": signed_value(0.05, 3.1)})],
    ),
    fault_kind(
        "nan",
        "A body's position is not a number.",
        EXPOSED,
        fields={"robot": Name},
        rows=[FaultRow("nan", CAMERA_REASONS)],
    ),
    fault_kind(
        "bad_quaternion",
        "A body's quaternion does not have norm 1.",
        EXPOSED,
        fields={"robot": Name},
        rows=[FaultRow("bad_quaternion", CAMERA_REASONS)],
    ),
    fault_kind(
        "repeat",
        "New frames repeat the old pose of one body, or of all bodies.",
        EXPOSED,
        fields={"robot": (Name | None, None)},
        rows=[
            FaultRow("pose frozen", MOVED_REASONS, {"robot": first_robot}),
            FaultRow("picture frozen", MOVED_REASONS),
        ],
    ),
    fault_kind(
        "swap",
        "Two bodies swap identities.",
        EXPOSED,
        fields={"robot": Name, "other": Name},
        rows=[FaultRow("identities swapped", MOVED_REASONS)],
    ),
    fault_kind(
        "twin_id",
        "A body has the id of another body.",
        EXPOSED,
        fields={"robot": Name, "other": Name},
        rows=[FaultRow("twin ids", "2 rigid bodies")],
    ),
    fault_kind(
        "clock_jump",
        "The server's clock is set forward by this time [s].",
        fields={"by": Finite},
        rows=[FaultRow("camera's clock jumps", LATE_REASONS, {"by": signed_value(5e-4, 5)})],
    ),
    fault_kind(
        "clock_rate",
        "The server's clock gains this time [s] every second.",
        fields={"rate": Positive},
        rows=[
            FaultRow("camera's clock drifts", LATE_REASONS, {"rate": factor_near_one(2e-4, 0.5)})
        ],
        begin=_begin_clock_rate,
    ),
)
"""The faults of these cameras, as a script names them."""
